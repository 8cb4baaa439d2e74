"""Estimates of fixed problems, to be the same to nine digits whatever the versions of numpy, scipy and MuJoCo; the committed ones.

python tests/support/reference_estimates.py --write      after a change that is meant to change them
"""

import json
import sys
from pathlib import Path

import gymnasium as gym
import numpy as np

from extremal.estimator import adjust, osculating_circle
from extremal.estimator.camera import Array
from extremal.scripts import general_study, joint_study, spatial_study
from extremal.scripts.synthetic import observe

FILE = Path(__file__).parents[1] / "data" / "estimates.json"
RTOL, ATOL = 1e-9, 1e-12  # a picometre: radii of what is fixed are noise around 0
LOOKS = 12  # of the environment


def circles() -> dict[str, Array]:
    """Circles of 15 views, touched by noisy rays to points that slip: to first order limbs of some curvature."""
    rng = np.random.default_rng(1)
    place = np.linspace(-0.2, 0.2, 15)[:, None]
    centres = place * [1.0, 0.1, 0.0] + [0.0, 0.0, -0.6]
    points = rng.uniform(-0.05, 0.05, (40, 1, 3)) + 0.05 * rng.uniform(0.5, 1, (40, 1, 1)) * place
    rays = points + 1e-5 * rng.standard_normal((40, 15, 3)) - centres
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    found = osculating_circle(centres, rays, 1e-4)
    return {"radius": found.radius, "sigma": found.sigma_radius, "centre": found.centre}


def planar() -> dict[str, Array]:
    """The joint adjustment of a circle and points, of 15 views."""
    case = joint_study.CASES[1]
    seen = observe(case.scene, case.errors, case.sigma, np.random.default_rng(2))
    (shape,) = adjust(seen.prior, seen.features).shapes
    return {"radius": shape.radius, "sigma": shape.sigma_radius, "theta": shape.theta}


def spatial() -> dict[str, Array]:
    """The same in space, with wrong poses, hand-eye transform and focal length."""
    rng = np.random.default_rng(3)
    scene = spatial_study.random_scene(15, 20, 50, rng)
    seen = observe(scene, spatial_study.pose_errors(scene, True), 1.25e-4, rng)
    found = adjust(seen.prior, seen.features)
    out = {"pose": found.T_world_camera.as_matrix(), "pose_sigma": _sigma(found.pose_covariance)}
    out["focal"] = np.array([found.focal, found.focal_sigma])
    for name, shape in zip(("sections", "points"), found.shapes, strict=True):
        out |= {f"{name}_theta": shape.theta, f"{name}_sigma": _sigma(shape.covariance)}
    return out


def second_order() -> dict[str, Array]:
    """Principal curvatures of an ellipsoid from noisy edgels of a curved path."""
    shape = general_study.trial(general_study.random_ellipsoid, 10, np.random.default_rng(4)).shape
    return {
        "position": shape.position,
        "curvatures": shape.principal_curvatures,
        "sigma": _sigma(shape.covariance),
    }


def environment() -> dict[str, Array]:
    """What is believed of the features of an episode on Navigate."""
    env = gym.make("extremal.tasks:extremal/Navigate-v0")
    env.reset(seed=5)
    for _ in range(LOOKS):
        env.step(np.array([0.3, 0, 0, 0, 0, 0], np.float32))
    seen = env.unwrapped.features  # pyright: ignore[reportAttributeAccessIssue]
    env.close()
    return {"position": seen.position, "radius": seen.radius, "sigma": seen.sigma_radius}


def _sigma(covariance: Array) -> Array:
    return np.sqrt(np.einsum("...ii->...i", covariance))


PROBLEMS = {f.__name__: f for f in (circles, planar, spatial, second_order, environment)}


def references() -> dict[str, dict[str, Array]]:
    """The committed estimates."""
    content = json.loads(FILE.read_text())
    return {p: {k: np.array(v, float) for k, v in found.items()} for p, found in content.items()}


def write() -> None:
    found = {p: {k: v.tolist() for k, v in solve().items()} for p, solve in PROBLEMS.items()}
    FILE.write_text(json.dumps(found) + "\n")


if __name__ == "__main__" and sys.argv[1:] == ["--write"]:
    write()
