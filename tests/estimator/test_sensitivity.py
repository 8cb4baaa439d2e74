"""First-order sensitivity against re-estimation of perturbed measurements: finite differences and Monte Carlo."""

import numpy as np
import pytest
from jacobian import assert_jacobian
from scipy.spatial.transform import RigidTransform, Rotation

from extremal.estimator import Camera, InvalidInput, OsculatingCircle, View, osculating_circle
from extremal.estimator.camera import Array
from extremal.estimator.sensitivity import Sensitivity, sensitivity
from extremal.estimator.uncertainty import pose_gradient

TRAVEL = np.array([1.0, 0.0, 0.0])
SPHERES = np.array([[0.03, 0.05, 0.5], [-0.05, -0.04, 0.55], [0.0, 0.02, 0.6], [0.02, -0.03, 0.45]])
RADII = np.array([0.04, 0.03, 0.02, 0.05])
TILTS = np.array([0.0, 0.5, -0.8, 0.3])  # [rad] between surface normals and epipolar planes
DISTORTED = Camera(
    width=8, height=8, fx=790, fy=810, cx=300, cy=250, distortion=(-0.3, 0.1, 1e-3, -2e-3, 0.02)
)


class Spheres:
    """Spheres seen exactly from V cameras along x; their epipolar planes pass by their centres.

    Re-estimates from erroneous image positions, poses and intrinsics: tangent planes, intersected with those planes.
    """

    def __init__(self, views: int, camera: Camera) -> None:
        rng = np.random.default_rng(views)
        self.camera, self.count = camera, views
        self.origins = np.linspace(-0.15, 0.15, views)[:, None] * TRAVEL
        self.rotations = Rotation.from_rotvec(0.1 * rng.normal(size=(views, 3))).as_matrix()
        outwards = SPHERES - (SPHERES @ TRAVEL)[:, None] * TRAVEL
        away = RADII * np.sin(TILTS)  # of the sphere's centre from the plane
        slant = np.arcsin(away / np.linalg.norm(outwards, axis=1))
        across = np.array(
            [Rotation.from_rotvec(a * TRAVEL).apply(o) for a, o in zip(slant, outwards, strict=True)]
        )
        across /= np.linalg.norm(across, axis=1, keepdims=True)
        self.planes = np.cross(TRAVEL, across)
        self.sections = RADII * np.cos(TILTS)
        centres = SPHERES - np.sum(SPHERES * self.planes, axis=1, keepdims=True) * self.planes
        towards = centres[:, None] - self.origins
        far = np.linalg.norm(towards, axis=2, keepdims=True)
        towards /= far
        ahead = np.cross(self.planes[:, None], towards)
        ahead *= np.sign(ahead @ TRAVEL)[..., None]
        sine = self.sections[:, None, None] / far
        rays = np.sqrt(1 - sine**2) * towards + sine * ahead
        self.points = self.origins + far * np.sqrt(1 - sine**2) * rays
        self.normals = (self.points - SPHERES[:, None]) / RADII[:, None, None]
        self.camera_normals = np.einsum("vji,nvj->nvi", self.rotations, self.normals)
        self.pixels = np.stack([view.project(self.points[:, i]) for i, view in enumerate(self.views)], axis=1)

    @property
    def views(self) -> list[View]:
        image = np.zeros((8, 8), np.uint8)
        rotations = [Rotation.from_matrix(r) for r in self.rotations]
        poses = (RigidTransform.from_components(o, r) for o, r in zip(self.origins, rotations, strict=True))
        return [View(self.camera, pose, image) for pose in poses]

    def sensitivity(self) -> Sensitivity:
        return sensitivity(self.circles(*self.split(np.zeros(8 * self.count + 4))), self.views, self.normals)

    def split(self, errors: Array) -> tuple[Array, Array, Array]:
        """Errors (..., 8 V + 4) as those of image positions, the same of all points, poses and intrinsics."""
        v = self.count
        lead = errors.shape[:-1]
        image = errors[..., : 2 * v].reshape(*lead, 1, v, 2)
        return image, errors[..., 2 * v : 8 * v].reshape(*lead, v, 6), errors[..., 8 * v :]

    def circles(self, image: Array, pose: Array, intrinsics: Array) -> OsculatingCircle:
        """Circles (..., n) estimated with errors (..., n, V, 2), (..., V, 6) and (..., 4)."""
        camera = self.camera
        focal, centre = np.array([camera.fx, camera.fy]), np.array([camera.cx, camera.cy])
        wrong_focal, wrong_centre = focal + intrinsics[..., :2], centre + intrinsics[..., 2:]
        distorted = (self.pixels + image - wrong_centre[..., None, None, :]) / wrong_focal[..., None, None, :]
        xy = camera.normalise(distorted * focal + centre)
        normals = np.broadcast_to(self.camera_normals, (*xy.shape[:-1], 3)).copy()
        normals[..., 2] = -np.sum(normals[..., :2] * xy, axis=-1)  # the image tangent stays as it is
        turns = Rotation.from_rotvec(pose[..., 3:].reshape(-1, 3)).as_matrix().reshape(*pose.shape[:-1], 3, 3)
        origins = self.origins + np.einsum("vij,...vj->...vi", self.rotations, pose[..., :3])
        normals = np.einsum("vij,...vjk,...nvk->...nvi", self.rotations, turns, normals)
        # where the tangent plane n.(r - v) = 0 meets the epipolar plane m.r = 0: next to v, along the travel
        m = self.planes[:, None]
        off = np.sum(origins[..., None, :, :] * m, axis=-1, keepdims=True) * m
        shift = np.sum(normals * off, axis=-1, keepdims=True) / (normals @ TRAVEL)[..., None]
        starts = origins[..., None, :, :] - off + shift * TRAVEL
        rays = np.cross(normals, m)
        rays *= np.sign(np.sum(rays * (self.points - self.origins), axis=-1, keepdims=True))
        rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
        return osculating_circle(starts, rays, 1e-4, self.planes)


@pytest.mark.parametrize("views", [3, 7])
def test_the_spheres_are_exact(views: int) -> None:
    scene = Spheres(views, DISTORTED)
    circles = scene.circles(*scene.split(np.zeros(8 * views + 4)))
    assert np.all(circles.valid)
    np.testing.assert_allclose(circles.radius, scene.sections, atol=1e-8)
    np.testing.assert_allclose(
        np.sum(scene.normals * circles.normals, axis=-1), np.cos(TILTS)[:, None] * np.ones(views)
    )


@pytest.mark.parametrize("views", [3, 7])
@pytest.mark.parametrize("camera", [Camera(width=8, height=8), DISTORTED])
def test_jacobian_against_finite_differences(views: int, camera: Camera) -> None:
    scene = Spheres(views, camera)
    found = scene.sensitivity()
    analytic = np.concatenate([found.image.reshape(len(RADII), -1), found.shared], axis=1)
    step = np.array([2e-3] * 2 * views + [1e-6] * 6 * views + [2e-3] * 4)
    assert_jacobian(
        lambda w: scene.circles(*scene.split(w)).radius, analytic, np.zeros(8 * views + 4), 2e-6, step
    )


def test_upright_surfaces_are_the_default() -> None:
    scene = Spheres(5, DISTORTED)
    circles = scene.circles(*scene.split(np.zeros(44)))
    found = sensitivity(circles, scene.views)
    np.testing.assert_allclose(found.pose, pose_gradient(circles, scene.views), rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(found.image[0], scene.sensitivity().image[0], rtol=1e-6, atol=1e-12)


def test_change_is_the_first_order_of_reestimation() -> None:
    scene, rng = Spheres(4, DISTORTED), np.random.default_rng(3)
    image = rng.normal(0, 1e-3, (len(RADII), 4, 2))
    pose, intrinsics = rng.normal(0, 1e-6, (4, 6)), rng.normal(0, 1e-3, 4)
    change = scene.sensitivity().change(image, pose, intrinsics)
    actual = scene.circles(image, pose, intrinsics).radius - scene.sections
    np.testing.assert_allclose(change, actual, rtol=2e-3, atol=2e-3 * np.abs(actual).max())


def test_covariance_by_monte_carlo() -> None:
    """Errors of all kinds, correlated within a point's image positions and within poses and intrinsics."""
    scene, rng, trials, views = Spheres(4, Camera(width=8, height=8)), np.random.default_rng(4), 4000, 4
    scale = np.array([2e-5, 2e-5, 2e-5, 4e-5, 4e-5, 4e-5] * views + [0.3] * 4)
    shared_root = scale[:, None] * rng.normal(size=(28, 28)) / np.sqrt(28)
    image_root = 0.02 * rng.normal(size=(len(RADII), 8, 8)) / np.sqrt(8)
    shared = rng.normal(size=(trials, 28)) @ shared_root.T
    image = np.einsum("nij,tnj->tni", image_root, rng.normal(size=(trials, len(RADII), 8)))
    radius = scene.circles(
        image.reshape(trials, -1, views, 2), shared[:, :24].reshape(trials, views, 6), shared[:, 24:]
    ).radius
    image_covariance = image_root @ np.swapaxes(image_root, 1, 2)
    expected = scene.sensitivity().covariance(image_covariance, shared_root @ shared_root.T)
    whitened = np.linalg.solve(np.linalg.cholesky(expected), (radius - scene.sections).T)
    # the standard error of a variance of n samples is sqrt(2 / n), that of a correlation sqrt(1 / n)
    np.testing.assert_allclose(
        whitened @ whitened.T / trials, np.eye(len(RADII)), atol=5 * np.sqrt(2 / trials)
    )


def test_shared_errors_cancel_between_a_point_and_itself() -> None:
    found = Spheres(3, DISTORTED).sensitivity()
    twice = Sensitivity(
        *(np.stack([a[1], a[1]]) for a in (found.image, found.pose, found.intrinsics, found.valid))
    )
    image = 0.1**2 * np.eye(6)
    covariance = twice.covariance(image, 1e-6 * np.eye(22))
    relative = covariance[0, 0] + covariance[1, 1] - 2 * covariance[0, 1]
    assert relative == pytest.approx(2 * np.sum((0.1 * found.image[1]) ** 2), rel=1e-6)


def test_points_without_a_radius_have_infinite_variance() -> None:
    scene = Spheres(3, DISTORTED)
    exact = scene.circles(*scene.split(np.zeros(28)))
    starts = np.broadcast_to(scene.origins, (len(RADII), 3, 3)).copy()
    starts[1] = starts[1, 0]  # no baseline
    rays = (exact.points - scene.origins) / exact.distances[..., None]
    along = scene.normals.copy()
    along[2] = scene.planes[2]  # a contour in its epipolar plane
    found = sensitivity(osculating_circle(starts, rays, 1e-4), scene.views, along)
    np.testing.assert_array_equal(found.valid, [True, False, False, True])
    variance = np.diagonal(found.covariance(np.eye(6), np.eye(22)))
    np.testing.assert_array_equal(np.isfinite(variance), found.valid)
    for values in (found.image, found.pose, found.intrinsics):
        assert np.all(np.isfinite(values)) and not np.any(values[~found.valid])


def test_shapes_that_do_not_fit_are_refused() -> None:
    scene = Spheres(3, DISTORTED)
    exact = scene.circles(*scene.split(np.zeros(28)))
    with pytest.raises(InvalidInput, match="4 views"):
        sensitivity(exact, [*scene.views, scene.views[0]])
    with pytest.raises(InvalidInput, match=r"surface normals \(4, 3\)"):
        sensitivity(exact, scene.views, scene.normals[:, 0])
    with pytest.raises(InvalidInput, match="image covariance"):
        scene.sensitivity().covariance(np.eye(5), np.eye(22))
    with pytest.raises(InvalidInput, match="poses and intrinsics"):
        scene.sensitivity().covariance(np.eye(6), np.eye(18))
