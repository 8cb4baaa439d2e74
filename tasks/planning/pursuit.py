"""Following a planned path without cutting its corners."""

import numpy as np

from extremal.estimator.errors import InvalidInput
from extremal.scenes.curves import Array


def next_velocity(position: Array, waypoints: Array, speed: float, dt: float) -> Array:
    """Velocity (3,) [m/s] for the next `dt`, to follow a polyline from where it comes nearest to the position.

    Aims at the path's point one step ahead. A chord of an arc cuts inside it by its sagitta, so the aim is moved
    out by four sagittae, which makes the step the arc's tangent: it never cuts inside. Slows down to stop on
    the last waypoint.

    Args:
        position: (3,) [m].
        waypoints: (n, 3) [m], n >= 2.
        speed: [m/s], positive; the result is at most as long.
        dt: [s], positive.

    Raises:
        InvalidInput: a value is out of range or of the wrong shape.
    """
    p, x = np.asarray(waypoints, float), np.asarray(position, float)
    if p.ndim != 2 or p.shape[1] != 3 or len(p) < 2 or x.shape != (3,):
        raise InvalidInput(f"position is {x.shape}, waypoints {p.shape}; accepted: (3,) and (n, 3), n >= 2")
    if not (speed > 0 and dt > 0 and np.all(np.isfinite(x)) and np.all(np.isfinite(p))):
        raise InvalidInput(f"speed is {speed!r}, dt {dt!r}; accepted: positive, with finite positions")
    edges = np.diff(p, axis=0)
    lengths = np.linalg.norm(edges, axis=1)
    s = np.append(0.0, np.cumsum(lengths))
    along = np.clip(np.sum((x - p[:-1]) * edges, axis=1) / np.maximum(lengths**2, 1e-24), 0, 1)
    gaps = np.linalg.norm(p[:-1] + along[:, None] * edges - x, axis=1)
    i = int(np.argmin(gaps))
    here, step = s[i] + along[i] * lengths[i], speed * dt
    at = np.minimum(here + step * np.array([0.0, 0.5, 1.0]), s[-1])
    begin, middle, end = np.stack([np.interp(at, s, c) for c in p.T], axis=1)
    aim = end + 4 * (middle - (begin + end) / 2) if at[2] < s[-1] else end
    v = (aim - x) / dt
    return v * min(1.0, speed / max(float(np.linalg.norm(v)), 1e-12))
