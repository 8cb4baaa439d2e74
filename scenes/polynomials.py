"""First roots of many polynomials at once, without missing double ones."""

from math import comb

import numpy as np

from extremal.scenes.curves import Array


def first_roots(coefficients: Array) -> Array:
    """Smallest root (N,) in [0, 1] of polynomials (N, d + 1), lowest power first; inf where none.

    Descartes' rule on Bernstein coefficients: no change of sign, no root; one change, one root, which
    Newton with bisection then polishes; else the interval is halved. A double root within rounding errors
    (grazing) is reported where its interval has shrunk to 2^-40.
    """
    n, d = coefficients.shape[0], coefficients.shape[1] - 1
    roots = np.full(n, np.inf)
    to_bernstein = np.array(
        [[comb(i, j) / comb(d, j) if j <= i else 0.0 for i in range(d + 1)] for j in range(d + 1)]
    )
    index, low, b = np.arange(n), np.zeros(n), coefficients @ to_bernstein
    brackets: list[tuple[Array, Array, Array]] = []
    width = 1.0
    for _ in range(40):
        sign = np.where(b < 0, -1, 1)
        changes = np.count_nonzero(np.diff(sign, axis=1), axis=1)
        one, many = changes == 1, changes > 1
        brackets.append((index[one], low[one], low[one] + width))
        index, low, b = index[many], low[many], b[many]
        if not len(index):
            break
        left, right = _halves(b)
        width /= 2
        index, low, b = np.tile(index, 2), np.concatenate([low, low + width]), np.concatenate([left, right])
    np.minimum.at(roots, index, low)
    i, lo, hi = (np.concatenate(x) for x in zip(*brackets, strict=True))
    np.minimum.at(roots, i.astype(int), _polish(coefficients[i.astype(int)], lo, hi))
    return roots


def _halves(b: Array) -> tuple[Array, Array]:
    """Bernstein coefficients (K, d + 1) on the two halves of the interval (de Casteljau)."""
    left, right = [b[:, 0]], [b[:, -1]]
    while b.shape[1] > 1:
        b = (b[:, :-1] + b[:, 1:]) / 2
        left.append(b[:, 0])
        right.append(b[:, -1])
    return np.stack(left, axis=1), np.stack(right[::-1], axis=1)


def _polish(c: Array, lo: Array, hi: Array) -> Array:
    """The one root (K,) of polynomials (K, d + 1) between `lo` and `hi` (K,)."""
    powers = np.arange(1, c.shape[1])

    def value(x: Array, c: Array) -> Array:
        y = c[:, -1]
        for k in range(c.shape[1] - 2, -1, -1):
            y = y * x + c[:, k]
        return y

    rising = value(hi, c) > value(lo, c)
    x = (lo + hi) / 2
    for _ in range(80):
        f = value(x, c)
        above = (f > 0) == rising
        lo, hi = np.where(above, lo, x), np.where(above, x, hi)
        slope = value(x, c[:, 1:] * powers)
        newton = x - f / np.where(slope == 0, np.inf, slope)
        middle = (lo + hi) / 2
        new = np.where((newton > lo) & (newton < hi), newton, middle)
        if not np.max(np.abs(new - x), initial=0.0) > 1e-16:
            break
        x = new
    return x
