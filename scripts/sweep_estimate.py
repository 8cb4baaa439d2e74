"""A trial without images: a circle seen from a line of cameras, from exact tangent planes with errors put on them.

An upright cylinder stands at the origin, fixed points around it. The cameras fixate the origin; each of their poses is off, and so
is every edge. Estimated by a circle of all views with poses as believed, and by the joint adjustment of poses and shape.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from extremal.estimator.adjustment import adjust
from extremal.estimator.camera import Array
from extremal.estimator.circle import osculating_circle
from extremal.estimator.errors import InvalidInput, NotConverged
from extremal.estimator.poses import PosePrior
from extremal.scripts.sweep_trials import Value
from extremal.scripts.synthetic import Observation, TangentScene, observe
from extremal.sim.motion import fixating

WITHHELD = ()
FILES = ()
NORMAL, TRAVEL = np.array([0.0, 0.0, 1.0]), np.array([0.0, 1.0, 0.0])
SPREAD = (
    0.1,
    0.12,
    0.05,
)  # [m] of the fixed points, to either side: in depth, along the cameras' line, upwards


@dataclass(frozen=True)
class Settings:
    """Attributes: radius of the circle; distance from the path's centre, length of the path [m]; number of views; standard
    deviations of edges [px] and of each pose's position [m] and rotation [rad], about each axis; focal length [px]; number of
    fixed points around."""

    radius: float = 0.04
    distance: float = 0.6
    baseline: float = 0.4
    views: int = 15
    edge_error: float = 0.1
    position_error: float = 1e-3
    rotation_error: float = 1e-3
    focal: float = 800.0
    fixed_points: int = 12

    ACCEPTED: ClassVar[Mapping[str, tuple[float, float]]] = {
        "radius": (1e-3, 1.0),
        "distance": (0.05, 100.0),
        "baseline": (1e-3, 100.0),
        "views": (3, 1000),
        "edge_error": (1e-4, 100.0),
        "position_error": (1e-7, 1.0),
        "rotation_error": (1e-7, 1.0),
        "focal": (10.0, 1e5),
        "fixed_points": (0, 1000),
    }

    def __post_init__(self) -> None:
        for name, (low, high) in self.ACCEPTED.items():
            if not low <= getattr(self, name) <= high:
                raise InvalidInput(f"{name} is {getattr(self, name):g}; accepted: {low:g} to {high:g}")
        if self.distance < 2 * self.radius:
            raise InvalidInput(
                f"distance is {self.distance:g}; accepted: at least twice the radius, {2 * self.radius:g}"
            )


def run(settings: Settings, seed: int) -> Mapping[str, Value]:
    """|R error| and sigma [m], and whether the joint estimate's error is within 1.96 sigma."""
    rng = np.random.default_rng(seed)
    scene = _scene(settings, rng)
    spread = np.repeat([settings.position_error, settings.rotation_error], 3)
    errors = PosePrior(scene.T_world_camera, np.tile(np.diag(spread), (settings.views, 1, 1)))
    sigma = settings.edge_error / settings.focal
    seen = observe(scene, errors, sigma, rng)
    absolute = _circle_radius(seen, sigma) - settings.radius
    found = adjust(seen.prior, seen.features)
    if not found.converged:
        raise NotConverged("the joint adjustment did not settle")
    shape = found.shapes[0]
    error, sigma_radius = float(shape.radius[0]) - settings.radius, float(shape.sigma_radius[0])
    return {
        "joint_error_m": abs(error),
        "joint_sigma_m": sigma_radius,
        "joint_covered": abs(error) < 1.96 * sigma_radius,
        "absolute_error_m": abs(absolute),
    }


def _scene(settings: Settings, rng: np.random.Generator) -> TangentScene:
    along = settings.baseline * np.linspace(-0.5, 0.5, settings.views)
    cameras = along[:, None] * TRAVEL - (settings.distance, 0.0, 0.0)
    return TangentScene(
        fixating(cameras, np.zeros(3)),
        np.zeros((1, 3)),
        np.array([settings.radius]),
        np.zeros(1),
        NORMAL[None],
        rng.uniform(-1, 1, (settings.fixed_points, 3)) * SPREAD,
    )


def _circle_radius(seen: Observation, sigma: float) -> float:
    """R of the circle through all views, with poses as they are believed [m]."""
    poses, normals = seen.prior.T_world_camera, seen.features[0].normals[:1, 0]
    rays = np.cross(NORMAL, _in_world(normals, poses.rotation.as_matrix()))
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    rays *= -np.sign(rays[..., :1] * poses.translation[:, :1])
    return float(osculating_circle(poses.translation, rays, sigma, NORMAL).radius[0])


def _in_world(normals: Array, rotations: Array) -> Array:
    return np.einsum("nvk,vjk->nvj", normals, rotations)
