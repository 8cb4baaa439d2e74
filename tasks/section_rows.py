"""Linear equations that looks at sections make.

    w (n.(v - o) - (a s + b q + (rho - a) R)) = noise,    T = T_believed exp(root z),  z ~ N(0, I)

as in `estimator.adjustment`: rows y = X theta + O z + noise of theta = (s, q, R), in standard deviations. With z eliminated,
a look is information on theta: X'X of each section alone, less G G' that the look's pose takes from all of them together.
With L L' = I + O'O and an orthonormal basis Q = O inv(L)' of what the pose can explain, G = X'Q; the right side of the
normal equations is X'(y - Q Q'y), and z = inv(L)'(Q'y - G' theta) is the pose that fits theta best.

Arrays of V looks at n sections:

| name | shape | what |
|---|---|---|
| believed, root | (V, 4, 4), (V, 6, 6) | poses; square roots of their covariances |
| normals, sigma | (V, n, 3), (V, n) | tangent planes in the camera frame; [rad], infinite where unseen |
| origin, frame, distance | (n, 3), (n, 3, 3), (n,) | of the sections, as `SectionSmoother` describes them |
| blocks, right | (V, n, 3, 3), (V, 3 n) | X'X for known poses; X'(y - Q Q'y) |
| loss, pull, inverse | (V, 6, 3 n), (V, 6), (V, 6, 6) | G', Q'y, inv(L) |
"""

import math

import numpy as np

from extremal.estimator.camera import Array
from extremal.tasks.compiled import compiled
from extremal.tasks.triples import Vector, crossed, dot, plus, put, row, turned, turned_back

TERMS = 6  # of the series of a pose error: to rounding at 0.1 rad
NEAREST = 0.25  # of their first distance that contact points are from the camera, for the weight of a look


@compiled
def placed(
    believed: Array, root: Array, normals: Array, theta: Array, loss: Array, pull: Array, inverse: Array
) -> tuple[Array, Array, Array]:
    """Where looks are linearised: z (V, 6) of the poses that fit theta (n, 3) best, these poses (V, 4, 4), and tangent planes
    (V, n, 3) in the world. Of a look that has told nothing yet (all zero) the pose is the believed one."""
    looks, n = normals.shape[:2]
    z, poses, planes = np.zeros((looks, 6)), believed.copy(), np.empty(normals.shape)
    all_theta, twist, left = theta.reshape(3 * n), np.empty(6), np.empty(6)
    for v in range(looks):
        for k in range(6):
            left[k] = pull[v, k]
            for j in range(3 * n):
                left[k] -= loss[v, k, j] * all_theta[j]
        for k in range(6):
            for i in range(k, 6):
                z[v, k] += inverse[v, i, k] * left[i]
        for k in range(6):
            twist[k] = 0.0
            for i in range(6):
                twist[k] += root[v, k, i] * z[v, i]
        _move(poses[v], twist)
        for i in range(n):
            put(planes[v], i, turned(poses[v], row(normals[v], i)))
    return z, poses, planes


@compiled
def tell(
    poses: Array,
    z: Array,
    planes: Array,
    root: Array,
    sigma: Array,
    theta: Array,
    origin: Array,
    frame: Array,
    distance: Array,
    repeats: Array,
    far: float,
    blocks: Array,
    loss: Array,
    right: Array,
    pull: Array,
    inverse: Array,
) -> None:
    """What looks say, linearised at theta (n, 3) and where they are `placed`; the last five arguments are written.

    Args:
        repeats: (n,) [rad] standard deviation of errors that repeat from look to look.
        far: standard deviations from which a row weighs less; its pull falls as it goes farther.
    """
    looks, n = sigma.shape
    X, O, y = np.empty((n, 3)), np.empty((n, 6)), np.empty(n)
    for v in range(looks):
        for i in range(n):
            spread = math.hypot(sigma[v, i], repeats[i])
            nearest = NEAREST * distance[i]
            n_i = row(planes[v], i)
            y[i] = _row(
                poses[v], z[v], root[v], n_i, spread, theta[i], origin[i], frame[i], nearest, far, X[i], O[i]
            )
        _eliminate(X, O, y, blocks[v], loss[v], right[v], pull[v], inverse[v])


@compiled
def _row(
    pose: Array,
    z: Array,
    root: Array,
    n: Vector,
    sigma: float,
    theta: Array,
    origin: Array,
    frame: Array,
    nearest: float,
    far: float,
    X: Array,
    O: Array,
) -> float:
    """Write the row X (3,), O (6,) of a tangent plane n, and return y. All zero where sigma is infinite."""
    if math.isinf(sigma):
        X[:], O[:] = 0.0, 0.0
        return 0.0
    N, T, R = row(frame, 0), row(frame, 1), theta[2]
    lever = (pose[0, 3] - origin[0], pose[1, 3] - origin[1], pose[2, 3] - origin[2])
    a, b = dot(N, n), dot(T, n)
    rho = max(math.sqrt(a * a + b * b), 1e-9)
    arm = plus(plus(lever, R - theta[0] - R * a / rho, N), -theta[1] - R * b / rho, T)
    # a contact point that is believed to be in the camera, by a step too long, would weigh without bound
    away = max(math.sqrt(dot(arm, arm)), nearest)
    miss = dot(n, lever) - (a * theta[0] + b * theta[1] + (rho - a) * R)
    weight = 1 / (sigma * away)
    weight *= min(1.0, far / max(abs(weight * miss), 1e-9))
    # Angles are measured, miss / away: with distances held, a smaller world would always fit better.
    slope = plus(n, -miss / (away * away), arm)
    X[0], X[1] = dot(N, slope), dot(T, slope)
    X[2] = (X[0] * a + X[1] * b) / rho - X[0]
    y = miss + X[0] * theta[0] + X[1] * theta[1] + X[2] * R
    push, turn = turned_back(pose, slope), turned_back(pose, crossed(n, arm))
    for k in range(6):
        own = 0.0
        for j in range(3):
            own += push[j] * root[j, k] + turn[j] * root[3 + j, k]
        y -= own * z[k]
        O[k] = -weight * own
    for j in range(3):
        X[j] *= weight
    return weight * y


@compiled
def _eliminate(
    X: Array, O: Array, y: Array, blocks: Array, loss: Array, right: Array, pull: Array, inverse: Array
) -> None:
    """What rows X (n, 3), O (n, 6), y (n,) of one look say of theta; the last five arguments are written."""
    n = len(y)
    information = np.eye(6)
    for i in range(n):
        for k in range(6):
            for j in range(k + 1):
                information[k, j] += O[i, k] * O[i, j]
    inverse_root(information, inverse)
    pull[:] = 0.0
    for i in range(n):
        # O becomes Q, from the last column, which needs those before it
        for k in range(5, -1, -1):
            O[i, k] *= inverse[k, k]
            for j in range(k):
                O[i, k] += inverse[k, j] * O[i, j]
            pull[k] += O[i, k] * y[i]
    for i in range(n):
        left = y[i]
        for k in range(6):
            left -= O[i, k] * pull[k]
            for j in range(3):
                loss[k, 3 * i + j] = O[i, k] * X[i, j]
        for j in range(3):
            right[3 * i + j] = X[i, j] * left
            for k in range(3):
                blocks[i, j, k] = X[i, j] * X[i, k]


@compiled
def inverse_root(matrix: Array, inverse: Array) -> None:
    """Write inv(L) of L L' = matrix, positive definite and given by its lower triangle, which becomes L."""
    size = len(matrix)
    for j in range(size):
        for k in range(j):
            for i in range(j, size):
                matrix[i, j] -= matrix[i, k] * matrix[j, k]
        scale = 1 / math.sqrt(matrix[j, j])
        for i in range(j, size):
            matrix[i, j] *= scale
    inverse[:] = 0.0
    for j in range(size):
        inverse[j, j] = 1 / matrix[j, j]
        for i in range(j + 1, size):
            for k in range(j, i):
                inverse[i, j] -= matrix[i, k] * inverse[k, j]
            inverse[i, j] /= matrix[i, i]


@compiled
def _move(pose: Array, twist: Array) -> None:
    """Replace a pose (4, 4) by pose exp(twist), as `estimator.poses.pose_exp`, of a small twist u, w (6,).

    The rotation is I + A W + B W W and the translation u + B W u + C W W u, where A, B, C are the sums of
    (-w.w)^k / (2 k + 1)!, ... (2 k + 2)!, ... (2 k + 3)!.
    """
    u, w = (twist[0], twist[1], twist[2]), (twist[3], twist[4], twist[5])
    square = dot(w, w)
    A = B = C = 0.0
    for k in range(TERMS, -1, -1):
        A = 1 - square / ((2 * k + 2) * (2 * k + 3)) * A
        B = 1 - square / ((2 * k + 3) * (2 * k + 4)) * B
        C = 1 - square / ((2 * k + 4) * (2 * k + 5)) * C
    B, C = B / 2, C / 6
    once = crossed(w, u)
    shift = turned(pose, plus(plus(u, B, once), C, crossed(w, once)))
    for i in range(3):
        at = row(pose, i)
        # the rows of a rotation turn by its transpose
        once = crossed(at, w)
        put(pose, i, plus(plus(at, A, once), B, crossed(once, w)))
        pose[i, 3] += shift[i]
