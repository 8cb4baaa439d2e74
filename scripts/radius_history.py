"""R with its error bars over looks: how what is known of single points grows while the camera moves."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from extremal.estimator import ExtremalError, LiveShape, SequentialShape, View
from extremal.estimator.camera import Array

COLOURS = {
    True: ("#1f77b4", "#17becf", "#6f7fd9"),
    False: ("#ff7f0e", "#d95f02", "#e6a700"),
}  # extremal, fixed
EACH = 3  # points of either kind
START = 5  # views that start tracks


@dataclass(frozen=True, eq=False)
class RadiusHistory:
    """What was known of one point after each of k looks.

    Attributes:
        looks: (k,) number of views so far. radius, sigma: (k,) [m], sigma infinite where R was unknown.
        position: (3,) [m] and extremal: its label, in the end.
        true_radius: [m], or None where it is not known.
    """

    looks: Array
    radius: Array
    sigma: Array
    position: Array
    extremal: bool
    true_radius: float | None = None


def radius_histories(views: Sequence[View]) -> list[RadiusHistory]:
    """Histories of the points that are known best in the end: three extremal ones, by R / sigma, and three fixed ones, by sigma,
    each of another image contour. None where no tracks start: nothing is in sight, or there are too few views."""
    shapes = _live_shapes(views)
    if not shapes:
        return []
    looks, last = np.array([n for n, _ in shapes], float), shapes[-1][1]
    found = []
    for extremal in (True, False):
        able = np.flatnonzero((last.extremal == extremal) & np.isfinite(last.sigma_radius))
        sigma = last.sigma_radius[able]
        able = able[np.argsort(sigma / np.abs(last.radius[able]) if extremal else sigma, kind="stable")]
        _, best = np.unique(last.contour[able], return_index=True)
        for i in able[np.sort(best)][:EACH]:
            radius = np.array([shape.radius[i] for _, shape in shapes])
            sigmas = np.array([shape.sigma_radius[i] for _, shape in shapes])
            found.append(RadiusHistory(looks, radius, sigmas, last.position[i], extremal))
    return found


def _live_shapes(views: Sequence[View]) -> list[tuple[int, LiveShape]]:
    """Number of views and shape after each of them, from the first that starts tracks."""
    live, found = SequentialShape(start=min(START, max(3, len(views)))), []
    try:
        for i, view in enumerate(views, start=1):
            live.update(view)
            if live.started:
                live.bootstrap()
                found.append((i, live.shape()))
    except ExtremalError:
        return []
    return found


def draw_histories(axes: Axes, histories: Sequence[RadiusHistory]) -> None:
    """Draw R [mm], as positive where extremal, with 95 % bars over the looks; dotted lines are the truth."""
    reach, used = 5.0, {True: 0, False: 0}
    for k, history in enumerate(histories):
        known = np.isfinite(history.sigma)
        if not known.any():
            continue
        sign = float(np.sign(history.radius[known][-1])) if history.extremal else 1.0
        radius, bar = 1e3 * sign * history.radius[known], 1.96e3 * history.sigma[known]
        colour = COLOURS[history.extremal][used[history.extremal] % EACH]
        label = None if used[history.extremal] else ("fixed", "extremal")[history.extremal]
        used[history.extremal] += 1
        at = history.looks[known] + 0.1 * (
            k - (len(histories) - 1) / 2
        )  # spread, so that bars can be told apart
        looks = {"markersize": 4, "linewidth": 0.7, "elinewidth": 1.0}
        axes.errorbar(at, radius, bar, fmt=".-", color=colour, label=label, **looks)
        if history.true_radius is not None:
            axes.axhline(1e3 * sign * history.true_radius, color=colour, linewidth=0.9, linestyle=":")
        reach = max(reach, float(np.abs(radius[-1]) + bar[-1]))
    axes.set(xlabel="views so far", ylabel="R [mm], bars: 95 %", ylim=(-0.75 * reach, 1.75 * reach))
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.grid(alpha=0.25)
    if any(used.values()):
        axes.legend(loc="upper right", fontsize=9)
