"""Linear equations that looks at sections make.

    w (n.(v - o) - (a s + b q + (rho - a) R + rho f(phi) c)) = noise,    T = T_believed exp(root z),  z ~ N(0, I)

as in `estimator.adjustment`: rows y = X theta + O z + noise of theta = (s, q, R, c), in standard deviations. With z eliminated,
a look is information on theta: X'X of each section alone, less G G' that the look's pose takes from all of them together.
With L L' = I + O'O and an orthonormal basis Q = O inv(L)' of what the pose can explain, G = X'Q; the right side of the
normal equations is X'(y - Q Q'y), and z = inv(L)'(Q'y - G' theta) is the pose that fits theta best.

Sections are no circles: their radius is R at phi = m, the middle of the arc that was seen, and changes by c in a radian. With the
support h of a section, h + h'' is its radius (DESIGN, equation 1; `estimator.section`), so that

    f(phi) = phi - m + m cos phi - sin phi,    f(0) = f'(0) = 0

What of this a circle leaves, c / 24 times the arc's third power, is a tenth of a pixel, but alike in all looks and tracks: poses that
are free by 1 mm would bend to explain it, and shift all radii together by several standard deviations.

Arrays of V looks at n sections:

| name | shape | what |
|---|---|---|
| believed, root | (V, 4, 4), (V, 6, 6) | poses; square roots of their covariances |
| normals, sigma | (V, n, 3), (V, n) | tangent planes in the camera frame; [rad], infinite where unseen |
| origin, frame, distance | (n, 3), (n, 3, 3), (n,) | of the sections, as `SectionSmoother` describes them |
| middle | (n,) | [rad] m |
| blocks, right | (V, n, 4, 4), (V, 4 n) | X'X for known poses; X'(y - Q Q'y) |
| loss, pull, inverse | (V, 6, 4 n), (V, 6), (V, 6, 6) | G', Q'y, inv(L) |
| off | (V, n) | [rad] by which planes miss their sections |

All unknowns are in the order c of all sections, then s, q, R of one section after the other (`stacked`).
"""

import math

import numpy as np

from extremal.estimator.camera import Array
from extremal.tasks.compiled import compiled
from extremal.tasks.section_unknowns import Unknowns, changed, stacked, unknowns
from extremal.tasks.triples import Vector, crossed, dot, plus, put, row, row_in, times, turned, turned_back

TERMS = 6  # of the series of a pose error: to rounding at 0.1 rad
NEAREST = 0.25  # of their first distance that contact points are from the camera, for the weight of a look


@compiled
def placed(
    believed: Array, root: Array, normals: Array, theta: Array, loss: Array, pull: Array, inverse: Array
) -> tuple[Array, Array, Array]:
    """Where looks are linearised: z (V, 6) of the poses that fit theta (n, 4) best, these poses (V, 4, 4), and tangent planes
    (V, n, 3) in the world. Of a look that has told nothing yet (all zero) the pose is the believed one."""
    looks, n = normals.shape[:2]
    z, poses, planes = np.zeros((looks, 6)), believed.copy(), np.empty(normals.shape)
    twist, told = np.empty(6), loss.reshape(6 * looks, 4 * n) @ stacked(theta)
    for v in range(looks):
        for k in range(6):
            for i in range(k, 6):
                z[v, k] += inverse[v, i, k] * (pull[v, i] - told[6 * v + i])
        for k in range(6):
            twist[k] = 0.0
            for i in range(6):
                twist[k] += root[v, k, i] * z[v, i]
        _move(poses[v], twist)
        for i in range(n):
            x, y, w = turned(poses[v], row_in(normals, v, i))
            planes[v, i, 0], planes[v, i, 1], planes[v, i, 2] = x, y, w
    return z, poses, planes


@compiled
def tell(
    poses: Array,
    z: Array,
    planes: Array,
    root: Array,
    sigma: Array,
    theta: Array,
    middle: Array,
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
    off: Array,
) -> None:
    """What looks say, linearised at theta (n, 4) and where they are `placed`; the last six arguments are written.

    Args:
        repeats: (n,) [rad] standard deviation of errors that repeat from look to look.
        far: standard deviations from which a row weighs less; its pull falls as it goes farther.
    """
    looks, n = sigma.shape
    X, O, y = np.empty((n, 4)), np.empty((n, 6)), np.empty(n)
    for v in range(looks):
        eye = poses[v, 0, 3], poses[v, 1, 3], poses[v, 2, 3]
        for i in range(n):
            if math.isinf(sigma[v, i]):
                X[i], O[i], y[i], off[v, i] = 0.0, 0.0, 0.0, 0.0
                continue
            spread = math.sqrt(sigma[v, i] * sigma[v, i] + repeats[i] * repeats[i])
            s, plane = unknowns(theta, i), row_in(planes, v, i)
            N, T, lever = row_in(frame, i, 0), row_in(frame, i, 1), plus(eye, -1.0, row(origin, i))
            x, slope, arm, miss, weight = equation(
                plane, spread, s, middle[i], lever, N, T, NEAREST * distance[i], far
            )
            moved = _of_pose(poses, root, z, v, slope, crossed(plane, arm), -weight, O, i)
            y[i] = weight * (miss - moved)
            for j in range(4):
                X[i, j] = weight * x[j]
                y[i] += X[i, j] * s[j]
            off[v, i] = miss / math.sqrt(dot(arm, arm))
        _eliminate(X, O, y, blocks[v], loss[v], right[v], pull[v], inverse[v])


@compiled
def missed(
    believed: Array,
    root: Array,
    planes: Array,
    spread: Array,
    theta: Array,
    middle: Array,
    origin: Array,
    frame: Array,
    distance: Array,
) -> tuple[Array, Array, Array]:
    """By how much tangent planes (n, 3) in the world, seen from a believed pose (4, 4), miss their sections, in standard deviations
    `spread` (n,) [rad], finite: r (n,), which is X (n, 3) times the error of s, q, R and O (n, 6) times z, besides the noise."""
    n = len(spread)
    X, O, r = np.empty((n, 3)), np.empty((n, 6)), np.empty(n)
    poses, roots, z = believed.reshape(1, 4, 4), root.reshape(1, 6, 6), np.zeros((1, 6))
    eye = believed[0, 3], believed[1, 3], believed[2, 3]
    for i in range(n):
        s, plane = unknowns(theta, i), row(planes, i)
        N, T, lever = row_in(frame, i, 0), row_in(frame, i, 1), plus(eye, -1.0, row(origin, i))
        x, slope, arm, miss, weight = equation(
            plane, spread[i], s, middle[i], lever, N, T, NEAREST * distance[i], math.inf
        )
        put(X, i, times(weight, (x[0], x[1], x[2])))
        _of_pose(poses, roots, z, 0, slope, crossed(plane, arm), -weight, O, i)
        r[i] = weight * miss
    return X, O, r


@compiled
def equation(
    n: Vector,
    sigma: float,
    theta: Unknowns,
    middle: float,
    lever: Vector,
    N: Vector,
    T: Vector,
    nearest: float,
    far: float,
) -> tuple[Unknowns, Vector, Vector, float, float]:
    """Of a tangent plane n, with `lever` from a section's origin to the camera: derivatives of its miss by theta and by the camera, the
    arm from contact point to camera, the miss and the weight."""
    R, c = theta[2], theta[3]
    a, b = dot(N, n), dot(T, n)
    rho = max(math.sqrt(a * a + b * b), 1e-9)
    cosine, sine = a / rho, b / rho
    f, turned = changed(math.atan2(b, a), middle)
    d, e = f * cosine - turned * sine, f * sine + turned * cosine  # of the contact point, by c
    arm = plus(plus(lever, R - theta[0] - R * cosine - c * d, N), -theta[1] - R * sine - c * e, T)
    # a contact point that is believed to be in the camera, by a step too long, would weigh without bound
    per_away = 1 / max(math.sqrt(dot(arm, arm)), nearest)
    miss = dot(n, lever) - (a * theta[0] + b * theta[1] + (rho - a) * R + rho * f * c)
    weight = per_away / sigma
    if abs(weight * miss) > far:
        weight *= far / abs(weight * miss)
    # Angles are measured, miss / away: with distances held, a smaller world would always fit better.
    slope = plus(n, -miss * per_away * per_away, arm)
    s, q = dot(N, slope), dot(T, slope)
    return (s, q, s * cosine + q * sine - s, s * d + q * e), slope, arm, miss, weight


@compiled
def _of_pose(
    poses: Array, root: Array, z: Array, v: int, slope: Vector, moment: Vector, scale: float, O: Array, i: int
) -> float:
    """Write row i of O (n, 6): `scale` times the derivative by z of a miss of that slope and moment in look v; and return that
    derivative times z."""
    push, turn, told = turned_back(poses[v], slope), turned_back(poses[v], moment), 0.0
    for k in range(6):
        own = push[0] * root[v, 0, k] + push[1] * root[v, 1, k] + push[2] * root[v, 2, k]
        own += turn[0] * root[v, 3, k] + turn[1] * root[v, 4, k] + turn[2] * root[v, 5, k]
        told += own * z[v, k]
        O[i, k] = scale * own
    return told


@compiled
def _eliminate(
    X: Array, O: Array, y: Array, blocks: Array, loss: Array, right: Array, pull: Array, inverse: Array
) -> None:
    """What rows X (n, 4), O (n, 6), y (n,) of one look say of theta; the last five arguments are written."""
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
            loss[k, i] = O[i, k] * X[i, 3]
            for j in range(3):
                loss[k, n + 3 * i + j] = O[i, k] * X[i, j]
        right[i] = X[i, 3] * left
        for j in range(3):
            right[n + 3 * i + j] = X[i, j] * left
        for j in range(4):
            for k in range(4):
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
