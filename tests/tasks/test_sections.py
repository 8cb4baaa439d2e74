"""The compiled equations of sections against finite differences, dense algebra and the estimator's own numpy."""

import numpy as np
import pytest

from extremal.estimator.camera import Array
from extremal.estimator.poses import pose_exp
from extremal.estimator.slant import FAR as FAR_SLANT
from extremal.estimator.slant import smoothed_tangent_planes
from extremal.tasks.section_arcs import crossing, middles, widen
from extremal.tasks.section_looks import Looks, Sums
from extremal.tasks.section_rows import missed, placed, tell
from extremal.tasks.section_slant import smoothed
from extremal.tasks.section_solution import Solution, Spread

LOOKS, N = 7, 11
# of the unknowns s, q, R, c (N, 4): c of all sections first, then those of one after the other
ORDER = np.concatenate([N + np.arange(3 * N).reshape(N, 3), np.arange(N)[:, None]], axis=1)


class Case:
    """Cameras on a line, sections half a metre away and noisy tangent planes of them; some are not seen."""

    def __init__(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        line = np.tile(np.eye(4), (LOOKS, 1, 1))
        line[:, 0, 3] = np.linspace(-0.1, 0.1, LOOKS)
        self.believed = line @ pose_exp(0.1 * rng.normal(size=(LOOKS, 6))).as_matrix()
        self.root = 1e-3 * np.linalg.qr(rng.normal(size=(LOOKS, 6, 6)))[0]
        self.origin = [0, 0, 0.5] + 0.05 * rng.normal(size=(N, 3))
        self.frame = np.linalg.qr(rng.normal(size=(N, 3, 3)))[0]
        self.frame[:, 2] = np.cross(self.frame[:, 0], self.frame[:, 1])
        self.distance = np.linalg.norm(self.origin, axis=1)
        planes = self.frame[:, 0] + 0.3 * rng.normal(size=(LOOKS, N, 3))
        self.theta, self.repeats = 0.01 * rng.normal(size=(N, 4)), 1e-3 * rng.random(N)
        self.middle = 0.2 * rng.normal(size=N)
        off = 1e-3 * rng.normal(size=(LOOKS, N))  # [rad] from planes through their circles' contact points
        for _ in range(20):
            planes /= np.linalg.norm(planes, axis=2, keepdims=True)
            ray = self.arm(self.believed, planes, self.theta)[0]
            ray /= np.linalg.norm(ray, axis=2, keepdims=True)
            planes += (off - np.sum(planes * ray, axis=2))[..., None] * ray
        planes /= np.linalg.norm(planes, axis=2, keepdims=True)
        self.normals = planes @ self.believed[:, :3, :3]
        self.sigma = 1e-3 * (1 + rng.random((LOOKS, N)))
        self.sigma[rng.random((LOOKS, N)) < 0.1] = np.inf
        self.looks = Looks(N)
        for v in range(LOOKS):
            self.looks.add(self.believed[v], self.root[v], self.normals[v], self.sigma[v])

    def place(self, theta: Array) -> tuple[Array, Array, Array]:
        rows = self.looks.part(0)
        return placed(rows.believed, rows.root, rows.normals, theta, rows.loss, rows.pull, rows.inverse)

    def tell(self, theta: Array, far: float = np.inf) -> Array:
        """z (LOOKS, 6) where looks are linearised."""
        rows = self.looks.part(0)
        z, poses, planes = self.place(theta)
        tell(
            poses, z, planes, rows.root, rows.sigma, theta, self.middle, self.origin, self.frame, self.distance,
            self.repeats, far,
            rows.blocks, rows.loss, rows.right, rows.pull, rows.inverse, rows.off,
        )  # fmt: skip
        return z

    def pose(self, v: int, z: Array) -> Array:
        return self.believed[v] @ pose_exp(self.root[v] @ z).as_matrix()

    def angles(self, theta: Array, z: Array, dz: Array | float = 0.0) -> Array:
        """(LOOKS, n) by how much [rad] planes miss their circles' contact points: the equation as it stands.

        Poses are T_believed exp(root z) exp(root dz).
        """
        turn = [pose_exp(self.root[v] @ (dz + np.zeros((LOOKS, 6)))[v]).as_matrix() for v in range(LOOKS)]
        pose = np.stack([self.pose(v, z[v]) @ turn[v] for v in range(LOOKS)])
        n = self.normals @ pose[:, :3, :3].swapaxes(1, 2)
        arm, miss = self.arm(pose, n, theta)
        return miss / np.linalg.norm(arm, axis=2)

    def arm(self, pose: Array, n: Array, theta: Array) -> tuple[Array, Array]:
        """From contact points to cameras (LOOKS, n, 3), and by how much (LOOKS, n) [m] planes n miss the cameras."""
        N0, T0 = self.frame[:, 0], self.frame[:, 1]
        a, b = np.sum(n * N0, axis=2), np.sum(n * T0, axis=2)
        s, q, R, c = theta.T
        lever, rho, phi, m = pose[:, None, :3, 3] - self.origin, np.hypot(a, b), np.arctan2(b, a), self.middle
        x, y = s + R * (a / rho - 1), q + R * b / rho
        # the integral of (R + c (phi - m)) (-sin phi, cos phi), from 0
        x = x + c * ((phi - m) * np.cos(phi) - np.sin(phi) + m)
        y = y + c * ((phi - m) * np.sin(phi) + np.cos(phi) - 1)
        contact = x[..., None] * N0 + y[..., None] * T0
        return lever - contact, np.sum(n * (lever - contact), axis=2)


@pytest.fixture
def case() -> Case:
    return Case(0)


def test_rows_are_the_derivatives_of_angles(case: Case) -> None:
    """The normal equations of all unknowns, by central differences, with z eliminated by dense algebra."""
    z = case.tell(case.theta)
    assert np.all(z == 0)
    case.theta = case.theta + 1e-3
    z = case.tell(case.theta)  # at poses of their own
    assert np.abs(z).max() > 0.1
    weight = 1 / np.hypot(case.sigma, case.repeats)
    step = 1e-6

    def derivative(k: int, of_pose: bool) -> Array:
        dz, dtheta = np.zeros((LOOKS, 6)), np.zeros((N, 4))
        (dz if of_pose else dtheta)[:, k] = step * (1e3 if of_pose else 1)
        ahead, behind = case.angles(case.theta + dtheta, z, dz), case.angles(case.theta - dtheta, z, -dz)
        return (ahead - behind) / (2 * (dz if of_pose else dtheta)[0, k])

    X = -weight[..., None] * np.stack([derivative(k, False) for k in range(4)], axis=2)
    O = -weight[..., None] * np.stack([derivative(k, True) for k in range(6)], axis=2)
    y = weight * case.angles(case.theta, z) + np.einsum("vik,ik->vi", X, case.theta)
    y += np.einsum("vik,vk->vi", O, z)
    rows = case.looks.part(0)
    np.testing.assert_allclose(rows.blocks, X[..., None] * X[..., None, :], rtol=1e-5, atol=1e-3)
    for v in range(LOOKS):
        information = np.eye(6) + O[v].T @ O[v]
        W = np.eye(N) - O[v] @ np.linalg.solve(information, O[v].T)
        full = np.einsum("ij,ia,jb->iajb", W, X[v], X[v]).reshape(4 * N, 4 * N)
        own = np.einsum("ij,ia,jb->iajb", np.eye(N), X[v], X[v]).reshape(4 * N, 4 * N)
        scale = np.abs(own).max()
        at = ORDER.ravel().argsort()  # where the unknowns of one section after the other stand
        np.testing.assert_allclose(
            (own[at][:, at] - rows.loss[v].T @ rows.loss[v]), full[at][:, at], atol=1e-4 * scale
        )
        right = np.einsum("ia,ij,j->ia", X[v], W, y[v]).ravel()[at]
        np.testing.assert_allclose(rows.right[v], right, atol=1e-3 * np.abs(right).max())
    theta = case.theta + 1e-3
    best = [
        np.linalg.solve(np.eye(6) + O[v].T @ O[v], O[v].T @ (y[v] - np.sum(X[v] * theta, axis=1)))
        for v in range(LOOKS)
    ]
    found, poses, planes = case.place(theta)
    np.testing.assert_allclose(found, best, rtol=1e-3, atol=1e-3)
    for v in range(LOOKS):
        pose = case.pose(v, found[v])
        np.testing.assert_allclose(poses[v], pose, atol=1e-14)
        np.testing.assert_allclose(planes[v], case.normals[v] @ pose[:3, :3].T, atol=1e-14)


def test_misses_of_a_new_look_are_linear_in_what_is_not_known(case: Case) -> None:
    """Its rows are those that the look would make at the believed pose, and its miss the angle itself."""
    case.tell(case.theta)
    rows, v, spread = case.looks.part(0), 2, np.full(N, 1e-3)
    planes = case.normals[v] @ case.believed[v, :3, :3].T
    X, O, r = missed(
        case.believed[v],
        case.root[v],
        planes,
        spread,
        case.theta,
        case.middle,
        case.origin,
        case.frame,
        case.distance,
    )
    angles = case.angles(case.theta, np.zeros((LOOKS, 6)))
    np.testing.assert_allclose(r, angles[v] / spread, rtol=1e-9)
    seen = np.isfinite(case.sigma)
    np.testing.assert_allclose(rows.off, np.where(seen, angles, 0.0), rtol=1e-9, atol=1e-15)
    for k, step in ((0, 1e-6), (2, 1e-6)):
        moved = case.theta + step * (np.arange(4) == k)
        change = (case.angles(moved, np.zeros((LOOKS, 6))) - angles)[v] / step
        np.testing.assert_allclose(-X[:, k] * spread, change, rtol=1e-3, atol=1e-4 * np.abs(change).max())
    for k in range(6):
        z = 1e-3 * np.tile(np.arange(6) == k, (LOOKS, 1))
        change = (case.angles(case.theta, z) - angles)[v] / 1e-3
        np.testing.assert_allclose(-O[:, k] * spread, change, rtol=1e-2, atol=1e-2 * np.abs(change).max())


def test_far_rows_weigh_less(case: Case) -> None:
    case.tell(case.theta)
    whole = case.looks.part(0).blocks.copy()
    z = case.angles(case.theta, np.zeros((LOOKS, 6))) / np.hypot(case.sigma, case.repeats)
    other = Case(0)
    other.tell(case.theta, 0.5)
    factor = np.minimum(1.0, 0.5 / np.maximum(np.abs(z), 1e-9))
    assert 0.1 < np.mean(factor < 1) < 1
    np.testing.assert_allclose(other.looks.part(0).blocks, whole * factor[..., None, None] ** 2, rtol=1e-9)


def test_slants_are_smoothed_as_in_the_estimator(case: Case) -> None:
    _, poses, planes = case.place(case.theta)
    found = smoothed(poses, planes, case.sigma, case.theta, case.origin, case.frame, FAR_SLANT)
    at = case.origin + np.einsum("nj,nji->ni", case.theta[:, :2], case.frame[:, :2])
    rays = at - poses[:, None, :3, 3]
    rays = rays - np.sum(rays * planes, axis=2, keepdims=True) * planes
    rays /= np.linalg.norm(rays, axis=2, keepdims=True)
    seen = np.isfinite(case.sigma).T
    wanted = smoothed_tangent_planes(planes.swapaxes(0, 1), rays.swapaxes(0, 1), case.frame[:, 2], seen, 0)
    wanted = wanted.swapaxes(0, 1)
    wanted = wanted * np.where(np.sum(wanted * planes, axis=2, keepdims=True) < 0, -1, 1)
    np.testing.assert_allclose(found, wanted, atol=1e-9)


def test_a_look_can_be_left_out(case: Case) -> None:
    """Sums without it are those of the others, and it is the one whose neighbours are nearest to each other."""
    case.tell(case.theta)
    information = np.eye(4 * N)
    sums, others = Sums.prior(information), Sums.prior(information)
    sums.add(case.looks.part(0))
    centres = case.believed[:, :3, 3]
    gaps = np.linalg.norm(centres[2:] - centres[:-2], axis=1)
    i = case.looks.nearest()
    assert i == 1 + np.argmin(gaps)
    sums.add(case.looks.part(i, i + 1), -1.0)
    case.looks.leave_out(i)
    assert case.looks.count == LOOKS - 1
    np.testing.assert_array_equal(case.looks.part(0).believed, np.delete(case.believed, i, axis=0))
    others.add(case.looks.part(0))
    upper = np.triu_indices(4 * N)
    scale = np.abs(others.matrix).max()
    np.testing.assert_allclose(sums.matrix[upper], others.matrix[upper], atol=1e-9 * scale)
    np.testing.assert_allclose(sums.right, others.right, atol=1e-9 * np.abs(others.right).max())
    np.testing.assert_allclose(sums.blocks, others.blocks, atol=1e-9 * scale)


def test_held_radii_are_conditional() -> None:
    """Against the textbook's conditional of a Gaussian, and each reference's own left out of what is known of it."""
    rng = np.random.default_rng(2)
    A = rng.normal(size=(3 * N, 3 * N))
    covariance = 1e-6 * (A @ A.T + np.eye(3 * N))
    theta, fixed = 1e-3 * rng.normal(size=(N, 3)), np.arange(N) % 3 == 0
    blocks = np.tile(np.eye(3), (N, 1, 1))
    blocks[1] = np.ones((3, 3))  # tells of a sum alone
    root = np.linalg.inv(np.linalg.cholesky(np.linalg.inv(covariance))).T
    solution = Solution(theta, Spread(root + np.tri(3 * N, k=-1), blocks, np.ones(N)))
    held, at = solution.held(fixed), 3 * np.flatnonzero(fixed) + 2
    gain = covariance[:, at] @ np.linalg.inv(covariance[np.ix_(at, at)])
    np.testing.assert_allclose(held.theta.ravel(), theta.ravel() - gain @ theta.ravel()[at], atol=1e-12)
    left = (covariance - gain @ covariance[at]).reshape(N, 3, N, 3)
    np.testing.assert_allclose(held.covariance, np.einsum("iaib->iab", left), atol=1e-15)
    assert not held.valid[1] and np.isinf(held.sigma[1]) and held.valid.sum() == N - 1
    rest, one = at[1:], at[0]
    gain = covariance[one, rest] @ np.linalg.inv(covariance[np.ix_(rest, rest)])
    assert held.radius[0] == pytest.approx(theta[0, 2] - gain @ theta.ravel()[rest])
    assert held.sigma[0] ** 2 == pytest.approx(covariance[one, one] - gain @ covariance[rest, one])


def test_middles_of_arcs(case: Case) -> None:
    first, last = np.full(N, np.inf), np.full(N, -np.inf)
    there = np.zeros((LOOKS, N, 3))
    for v in range(LOOKS):
        seen = crossing(case.believed[v], case.normals[v], case.sigma[v], case.frame, 0.9, there[v])
        up = there[v] @ case.frame.swapaxes(1, 2)
        assert np.all(np.abs(up[:, np.arange(N), 2].diagonal()) < np.sqrt(1 - 0.9**2))
        np.testing.assert_array_equal(seen, np.any(there[v] != 0, axis=1))
        widen(case.believed[v], case.normals[v], np.where(seen, 1.0, np.inf), case.frame, first, last)
    views = np.count_nonzero(there.any(axis=2), axis=0)
    assert views.max() > 1
    spread, valid = np.tile(np.diag([1.0, 2.0, 3.0]), (N, 1, 1)), np.arange(N) > 0
    case.middle[views > 0] = (first[views > 0] + last[views > 0]) / 2
    points, covariance, normals = middles(
        case.origin, case.frame, case.middle, case.theta[:, 3], there, case.theta[:, :3], spread, valid, 2.0
    )
    for i in np.flatnonzero(views):
        angles = np.arctan2(*(there[there[:, i].any(axis=1), i] @ case.frame[i, 1::-1].T).T)
        assert (first[i], last[i]) == pytest.approx((angles.min(), angles.max()))
        phi = (angles.min() + angles.max()) / 2
        middle = np.cos(phi) * case.frame[i, 0] + np.sin(phi) * case.frame[i, 1]
        J = np.stack([*case.frame[i, :2], middle - case.frame[i, 0]])
        # by the integral of the circle's and what is added to its radius
        along = np.linspace(0, phi, 20_001)
        tangent = np.cos(along)[:, None] * case.frame[i, 1] - np.sin(along)[:, None] * case.frame[i, 0]
        radius = case.theta[i, 2] + case.theta[i, 3] * (along - phi)
        there_by = np.trapezoid(radius[:, None] * tangent, along, axis=0)
        np.testing.assert_allclose(
            points[i], case.origin[i] + case.theta[i, :2] @ J[:2] + there_by, atol=1e-9
        )
        wanted = 4 * J.T @ spread[i] @ J if valid[i] else np.full((3, 3), np.inf)
        np.testing.assert_allclose(covariance[i], wanted, atol=1e-12)
        assert normals[i] @ np.cross(middle, case.frame[i, 2]) == pytest.approx(0)
        nearest = there[np.argmax(there[:, i] @ middle), i]
        assert normals[i] @ nearest == pytest.approx(np.linalg.norm([middle, case.frame[i, 2]] @ nearest))
