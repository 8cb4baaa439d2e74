"""Looks at sections as they are kept, and their sum as normal equations."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.blas import dsyrk  # pyright: ignore[reportAttributeAccessIssue]

from extremal.estimator.camera import Array
from extremal.tasks.compiled import compiled

ROUNDING = 1e-7  # of its information that a section is given besides, so that rounding leaves it positive
ROOM = 32  # looks


class Rows(NamedTuple):
    """V looks at n sections and what they say, as `section_rows` names it; all zero where they were not linearised yet."""

    believed: Array
    root: Array
    normals: Array
    sigma: Array
    blocks: Array
    loss: Array
    right: Array
    pull: Array
    inverse: Array
    off: Array

    @staticmethod
    def zeros(looks: int, n: int) -> "Rows":
        tails = (4, 4), (6, 6), (n, 3), (n,), (n, 4, 4), (6, 4 * n), (4 * n,), (6,), (6, 6), (n,)
        return Rows(*(np.zeros((looks, *tail)) for tail in tails))

    def part(self, first: int, last: int) -> "Rows":
        """Some of the looks: views."""
        return Rows(*[values[first:last] for values in self])


class Looks:
    """`count` looks, the oldest first."""

    def __init__(self, sections: int) -> None:
        self._rows = Rows.zeros(ROOM, sections)
        self.count = 0

    def add(self, believed: Array, root: Array, normals: Array, sigma: Array) -> None:
        """A look, as `SectionSmoother.update` describes it."""
        rows, i = self._rows, self.count
        if i == len(rows.sigma):
            self._rows = rows = Rows(*(np.concatenate([values, np.zeros_like(values)]) for values in rows))
        rows.believed[i], rows.normals[i], rows.sigma[i] = believed, normals, sigma
        rows.root[i, :, : root.shape[1]] = root
        self.count += 1

    def part(self, first: int, last: int | None = None) -> Rows:
        """The looks from the first to before the last, or to the end: views."""
        return self._rows.part(first, self.count if last is None else last)

    def leave_out(self, i: int) -> None:
        """Forget look i."""
        for values in self._rows:
            values[i : self.count - 1] = values[i + 1 : self.count]
            values[self.count - 1] = 0.0
        self.count -= 1

    def forget(self, sections: NDArray[np.bool_], looks: int) -> None:
        """That `sections` (n,) were seen in the latest looks."""
        self._rows.sigma[max(self.count - looks, 0) : self.count, sections] = np.inf

    def nearest(self) -> int:
        """The look, neither first nor last, whose neighbours are nearest to each other."""
        centres = self._rows.believed[: self.count, :3, 3]
        return 1 + int(np.argmin(np.linalg.norm(centres[2:] - centres[:-2], axis=1)))


class Sums:
    """Normal equations of n sections, whose unknowns are in the order of `section_rows`.

    Attributes:
        matrix: (4 n, 4 n), the upper triangle. right: (4 n,).
        blocks: (n, 4, 4) of the information for known poses, without the prior.
    """

    def __init__(self, matrix: Array, right: Array, blocks: Array) -> None:
        self.matrix, self.right, self.blocks = matrix, right, blocks

    @staticmethod
    def prior(information: Array) -> "Sums":
        """Of no look: information (4 n, 4 n)."""
        n = len(information) // 4
        return Sums(information.copy(), np.zeros(4 * n), np.zeros((n, 4, 4)))

    def copy(self) -> "Sums":
        return Sums(self.matrix.copy(), self.right.copy(), self.blocks.copy())

    def add(self, rows: Rows, sign: float = 1.0) -> None:
        """Add what looks say, or take it away."""
        loss = rows.loss.reshape(-1, len(self.right))
        if len(loss):
            # LAPACK counts along columns: its lower triangle is the upper one here
            dsyrk(-sign, loss.T, beta=1.0, c=self.matrix.T, lower=1, overwrite_c=1)
            _add(rows.blocks, rows.right, sign, self.matrix, self.right, self.blocks)


@compiled
def _add(blocks: Array, right: Array, sign: float, matrix: Array, total: Array, each: Array) -> None:
    """Add sign times what V looks say but for the loss of information, blocks (V, n, 4, 4) and right (V, 4 n), to what `Sums` holds."""
    looks, n = blocks.shape[:2]
    for v in range(looks):
        for i in range(4 * n):
            total[i] += sign * right[v, i]
        for i in range(n):
            for j in range(4):
                for k in range(4):
                    each[i, j, k] += sign * blocks[v, i, j, k]
            at = n + 3 * i
            matrix[i, i] += sign * (1 + ROUNDING) * blocks[v, i, 3, 3]
            for j in range(3):
                matrix[i, at + j] += sign * blocks[v, i, 3, j]
                for k in range(3):
                    rounded = 1 + ROUNDING if j == k else 1.0
                    matrix[at + j, at + k] += sign * rounded * blocks[v, i, j, k]
