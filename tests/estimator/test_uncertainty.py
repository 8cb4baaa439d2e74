"""How errors of camera poses reach radii of curvature: finite differences and Monte Carlo."""

import numpy as np
import pytest
from jacobian import assert_jacobian
from scipy.spatial.transform import RigidTransform, Rotation

from extremal.estimator import Camera, OsculatingCircle, View, osculating_circle
from extremal.estimator.camera import Array
from extremal.estimator.uncertainty import pose_angle_sigma, pose_gradient, relative_radius

CAMERA = Camera(width=8, height=8)
TRAVEL = np.array([1.0, 0.0, 0.0])


class Sections:
    """Epipolar sections of spheres, seen exactly from V cameras on a line along x; radius 0: points."""

    def __init__(self, views: int, centres: Array, radii: Array, turn: float = 0.3) -> None:
        rng = np.random.default_rng(views)
        self.origins = np.linspace(-0.15, 0.15, views)[:, None] * TRAVEL
        self.rotations = Rotation.from_rotvec(turn * rng.normal(size=(views, 3)))
        self.radii = radii
        across = centres - (centres @ TRAVEL)[:, None] * TRAVEL
        across /= np.linalg.norm(
            across, axis=1, keepdims=True
        )  # each plane through the line and a sphere's centre
        self.planes = np.cross(TRAVEL, across)
        rays = np.empty((len(centres), views, 3))
        for i, (centre, radius) in enumerate(zip(centres, np.abs(radii), strict=True)):
            towards = centre - self.origins
            tilt = np.sign(radii[i]) * np.arcsin(radius / np.linalg.norm(towards, axis=1))
            towards /= np.linalg.norm(towards, axis=1, keepdims=True)
            ahead = np.cross(towards, self.planes[i])
            ahead *= np.sign(ahead @ TRAVEL)[:, None]
            rays[i] = np.cos(tilt)[:, None] * towards + np.sin(tilt)[:, None] * ahead
        self.camera_rays = np.einsum("vji,nvj->nvi", self.rotations.as_matrix(), rays)

    def views(self, covariance: Array) -> list[View]:
        image = np.zeros((8, 8), np.uint8)
        poses = (
            RigidTransform.from_components(o, r) for o, r in zip(self.origins, self.rotations, strict=True)
        )
        return [View(CAMERA, pose, image, covariance) for pose in poses]

    def circles(self, errors: Array, angles: Array | float = 0.0, sigma: float = 1e-4) -> OsculatingCircle:
        """Circles (..., n) with pose errors (..., V, 6) in the camera frames, and errors (..., n, V) [rad] of the rays."""
        rotations = self.rotations.as_matrix()
        small = (
            Rotation.from_rotvec(errors[..., 3:].reshape(-1, 3)).as_matrix().reshape(*errors.shape[:-1], 3, 3)
        )
        origins = self.origins + np.einsum("vij,...vj->...vi", rotations, errors[..., :3])
        rays = np.einsum("vij,...vjk,nvk->...nvi", rotations, small, self.camera_rays)
        sideways = np.cross(rays, self.planes[:, None])
        rays = rays + np.asarray(angles)[..., None] * sideways
        return osculating_circle(origins[..., None, :, :], rays, sigma, self.planes)

    def tilted(self, circles: OsculatingCircle, seed: int = 1) -> Array:
        """Unit normals (n, V, 3), of either sign, of planes through the rays, tilted up to 1 rad against the epipolar planes."""
        rng = np.random.default_rng(seed)
        angles = rng.uniform(-1, 1, circles.normals.shape[:2])[..., None]
        normals = np.cos(angles) * circles.normals + np.sin(angles) * circles.plane_normals[:, None]
        return normals * rng.choice([-1, 1], angles.shape)

    def traces(self, tangent_planes: Array, errors: Array) -> tuple[Array, Array]:
        """Where planes (n, V, 3) that move with their cameras (..., V, 6) cut epipolar planes that stay: starts and rays."""
        rotations = self.rotations.as_matrix()
        turns = Rotation.from_rotvec(errors[..., 3:].reshape(-1, 3)).as_matrix()
        turns = turns.reshape(*errors.shape[:-1], 3, 3)
        seen = np.einsum("vji,nvj->nvi", rotations, tangent_planes)
        normals = np.einsum("vij,...vjk,nvk->...nvi", rotations, turns, seen)
        origins = self.origins + np.einsum("vij,...vj->...vi", rotations, errors[..., :3])
        # all epipolar planes contain the x axis: where does a plane n . (r - v) = 0 meet it?
        met = np.einsum("...nvk,...vk->...nv", normals, origins) / (normals @ TRAVEL)
        rays = np.cross(normals, self.planes[:, None])
        forward = np.einsum("vij,nvj->nvi", rotations, self.camera_rays)
        rays *= np.sign(np.sum(rays * forward, axis=-1, keepdims=True))
        return met[..., None] * TRAVEL, rays / np.linalg.norm(rays, axis=-1, keepdims=True)

    def retraced(self, tangent_planes: Array, errors: Array) -> OsculatingCircle:
        """Circles (..., n) of `traces`."""
        return osculating_circle(*self.traces(tangent_planes, errors), 1e-4, self.planes)


def sections(views: int) -> Sections:
    centres = np.array([[0.03, 0.05, 0.5], [-0.05, -0.04, 0.55], [0.0, 0.02, 0.6], [0.02, -0.03, 0.45]])
    return Sections(views, centres, np.array([0.04, -0.03, 0.0, 0.01]))


def test_the_sections_are_exact() -> None:
    scene = sections(5)
    circles = scene.circles(np.zeros((5, 6)))
    assert np.all(circles.valid)
    np.testing.assert_allclose(circles.radius, scene.radii, atol=1e-10)


@pytest.mark.parametrize("views", [3, 7])
def test_pose_gradient_against_finite_differences(views: int) -> None:
    scene = sections(views)

    def radius(errors: Array) -> Array:
        return scene.circles(errors.reshape(views, 6)).radius

    gradient = pose_gradient(scene.circles(np.zeros((views, 6))), scene.views(np.zeros((6, 6))))
    assert gradient.shape == (4, views, 6)
    assert_jacobian(radius, gradient.reshape(4, -1), np.zeros(6 * views), rtol=1e-6, step=1e-5)


@pytest.mark.parametrize("views", [3, 7])
def test_pose_gradient_of_tilted_contours_against_finite_differences(views: int) -> None:
    scene = sections(views)
    exact = scene.circles(np.zeros((views, 6)))
    planes = scene.tilted(exact)

    def radius(errors: Array) -> Array:
        return scene.retraced(planes, errors.reshape(views, 6)).radius

    np.testing.assert_allclose(radius(np.zeros(6 * views)), scene.radii, atol=1e-9)
    gradient = pose_gradient(exact, scene.views(np.zeros((6, 6))), planes)
    assert_jacobian(radius, gradient.reshape(4, -1), np.zeros(6 * views), rtol=1e-6, step=1e-5)


def test_pose_gradient_of_upright_contours_is_the_default() -> None:
    scene = sections(5)
    exact = scene.circles(np.zeros((5, 6)))
    views = scene.views(np.zeros((6, 6)))
    expected = pose_gradient(exact, views)
    for sign in (1, -1):
        np.testing.assert_allclose(pose_gradient(exact, views, sign * exact.normals), expected)


def test_contours_along_their_epipolar_planes_have_large_but_finite_gradients() -> None:
    scene = sections(5)
    exact = scene.circles(np.zeros((5, 6)))
    along = np.broadcast_to(exact.plane_normals[:, None], exact.normals.shape)
    views = scene.views(np.eye(6))
    gradient = pose_gradient(exact, views, along)
    assert np.all(np.isfinite(gradient)) and np.all(np.isfinite(pose_angle_sigma(exact, views, along)))
    assert np.abs(gradient).max() > 100 * np.abs(pose_gradient(exact, views)).max()


def test_covariance_of_tilted_contours_by_monte_carlo() -> None:
    """Radii of a limb and a fixed point, absolute and relative, in errors of the poses in all six directions."""
    rng, views, trials = np.random.default_rng(8), 9, 4000
    scene = Sections(views, np.array([[0.03, 0.05, 0.5], [0.06, 0.05, 0.52]]), np.array([0.03, 0.0]))
    covariance = np.diag([3e-4] * 3 + [3e-4] * 3) ** 2
    exact = scene.circles(np.zeros((views, 6)))
    planes = scene.tilted(exact)
    errors = rng.normal(size=(trials, views, 6)) * np.sqrt(np.diag(covariance))
    radius = scene.retraced(planes, errors).radius
    gradient = pose_gradient(exact, scene.views(covariance), planes)
    expected = np.einsum("nvi,ij,mvj->nm", gradient, covariance, gradient)
    whitened = np.linalg.solve(np.linalg.cholesky(expected), (radius - scene.radii).T)
    # standard error of a variance from n samples: sqrt(2 / n)
    bound = 5 * np.sqrt(2 / trials) + 0.02
    np.testing.assert_allclose(whitened @ whitened.T / trials, np.eye(2), atol=bound)
    relative, sigma = relative_radius(
        exact, np.zeros(2), gradient, scene.views(covariance), np.array([0]), np.array([1])
    )
    error = radius[:, 0] - radius[:, 1] - relative[0]
    assert np.mean(error**2) / sigma[0] ** 2 == pytest.approx(1, abs=bound)
    upright = pose_gradient(exact, scene.views(covariance))
    assert np.all(np.einsum("nvi,ij,nvj->n", upright, covariance, upright) < np.diag(expected))


def test_angles_of_tilted_contours_by_monte_carlo() -> None:
    scene, rng, trials = sections(4), np.random.default_rng(9), 4000
    covariance = np.diag([1e-3, 2e-3, 3e-3, 1e-3, 2e-3, 3e-3]) ** 2 / 4
    exact = scene.circles(np.zeros((4, 6)))
    planes = scene.tilted(exact)
    sigma = pose_angle_sigma(exact, scene.views(covariance), planes)
    starts, rays = scene.traces(planes, rng.normal(size=(trials, 4, 6)) * np.sqrt(np.diag(covariance)))
    # how far each trace passes by the exact contact point
    off = np.sum((starts - exact.points) * np.cross(rays, scene.planes[:, None]), axis=-1) / exact.distances
    ratio = np.mean(off**2, axis=0) / sigma**2
    assert np.abs(ratio - 1).max() < 5 * np.sqrt(2 / trials) + 0.02


def test_pose_gradient_of_common_errors() -> None:
    """No shift of all cameras changes a radius."""
    scene = Sections(5, np.array([[0.03, 0.05, 0.5]]), np.array([0.04]), turn=0.0)
    gradient = pose_gradient(scene.circles(np.zeros((5, 6))), scene.views(np.zeros((6, 6))))
    together = gradient[0, :, :3].sum(axis=0)
    np.testing.assert_allclose(together, 0, atol=1e-9 * np.abs(gradient).max())


def test_pose_angle_sigma_by_monte_carlo() -> None:
    scene, trials = sections(4), 4000
    rng = np.random.default_rng(5)
    covariance = np.diag([1e-3, 2e-3, 3e-3, 1e-3, 2e-3, 3e-3]) ** 2
    exact = scene.circles(np.zeros((4, 6)))
    sigma = pose_angle_sigma(exact, scene.views(covariance))
    errors = rng.normal(size=(trials, 4, 6)) * np.sqrt(np.diag(covariance))
    rotations = scene.rotations.as_matrix()
    small = Rotation.from_rotvec(errors[..., 3:].reshape(-1, 3)).as_matrix().reshape(trials, 4, 3, 3)
    origins = scene.origins + np.einsum("vij,tvj->tvi", rotations, errors[..., :3])
    rays = np.einsum("vij,tvjk,nvk->tnvi", rotations, small, scene.camera_rays)
    # how far each ray passes by the exact contact point, in the epipolar plane
    off = np.sum((origins[:, None] - exact.points) * exact.normals, axis=-1)
    angle = off / exact.distances + np.sum(rays * exact.normals, axis=-1)
    ratio = np.mean(angle**2, axis=0) / sigma**2
    assert np.abs(ratio - 1).max() < 5 * np.sqrt(2 / trials) + 0.02


@pytest.mark.parametrize("distance", [0.0, 0.01])
def test_relative_radius_by_monte_carlo(distance: float) -> None:
    """Pose errors are common to a limb and a nearby fixed point, and cancel but for what lies between them."""
    rng = np.random.default_rng(6)
    views, trials, image_sigma = 9, 6000, 2e-5
    centres = np.array([[0.03, 0.05, 0.5], [0.06, 0.05, 0.5 + distance]])
    scene = Sections(views, centres, np.array([0.03, 0.0]))
    covariance = np.diag([3e-4] * 3 + [3e-4] * 3) ** 2
    errors = rng.normal(size=(trials, views, 6)) * np.sqrt(np.diag(covariance))
    angles = image_sigma * rng.normal(size=(trials, 2, views))
    radius = scene.circles(errors, angles).radius
    exact = scene.circles(np.zeros((views, 6)))
    gradient = pose_gradient(exact, scene.views(covariance))
    image_variance = np.sum((exact.radius_gradient * image_sigma * exact.distances) ** 2, axis=1)
    relative, sigma = relative_radius(
        exact, image_variance, gradient, scene.views(covariance), np.array([0]), np.array([1])
    )
    assert relative[0] == pytest.approx(0.03, abs=1e-9)
    error = radius[:, 0] - radius[:, 1] - relative[0]
    # standard error of a variance from n samples: sqrt(2 / n)
    assert np.mean(error**2) / sigma[0] ** 2 == pytest.approx(1, abs=5 * np.sqrt(2 / trials) + 0.02)
    assert sigma[0] ** 2 < 0.1 * np.sum(np.var(radius, axis=0))
    absolute = image_variance + np.einsum("nvi,ij,nvj->n", gradient, covariance, gradient)
    ratio = np.var(radius, axis=0) / absolute
    assert np.abs(ratio - 1).max() < 5 * np.sqrt(2 / trials) + 0.02


def test_relative_radius_of_a_point_to_itself_has_the_image_error_alone() -> None:
    scene = sections(5)
    covariance = np.eye(6) * 1e-6
    exact = scene.circles(np.zeros((5, 6)))
    gradient = pose_gradient(exact, scene.views(covariance))
    every = np.arange(4)
    relative, sigma = relative_radius(
        exact, np.full(4, 4e-6), gradient, scene.views(covariance), every, every
    )
    np.testing.assert_array_equal(relative, 0)
    np.testing.assert_allclose(sigma, np.sqrt(8e-6))
