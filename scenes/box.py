"""Boxes: creases and markings only, no extremal boundaries."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np

from extremal.estimator.errors import SceneError
from extremal.scenes.curves import Array, Kind, Piece, SurfaceCurve, arc_samples, check_length
from extremal.scenes.grids import MEASURED, Facets, distinct, grid_triangles, used_only
from extremal.scenes.markings import FACES, BoxPatch, Face, check_markings
from extremal.scenes.surface import Surface


@dataclass(frozen=True, eq=False)
class Box(Surface):
    """Box about the object frame's origin, with sides along its axes.

    On the differential queries: a point belongs to the face nearest to it; every curvature is 0.

    Attributes:
        size: (3,) full lengths of the sides [m].
        markings: rectangles of other colours on the faces, without overlaps.

    Raises:
        SceneError: for a size or markings that are not acceptable.
    """

    size: Sequence[float]
    markings: tuple[BoxPatch, ...] = ()

    def _check(self) -> None:
        if len(self.size) != 3:
            raise SceneError(f"{self.name}: size is {self.size!r}; accepted: three lengths [m]")
        for axis, value in zip("xyz", self.size, strict=True):
            check_length(f"{self.name}: size along {axis}", value)
        check_markings(self.name, self.markings)
        for m in self.markings:
            _, _, u, v = _axes(m.face)
            if np.any(np.abs(m.centre) + np.array(m.size) / 2 > self._half[[u, v]] + 1e-12):
                raise SceneError(f"{self.name}: marking {m.name!r} reaches beyond face {m.face}")

    @cached_property
    def _half(self) -> Array:
        return np.array(self.size, float) / 2

    @property
    def _bounds(self) -> tuple[Array, float]:
        return np.zeros(3), float(np.linalg.norm(self._half)) * (1 + 1e-9)

    def _frame(self, p: Array) -> tuple[Array, Array]:
        axis = np.argmin(np.abs(np.abs(p) - self._half), axis=-1)
        side = np.sign(np.take_along_axis(p, axis[..., None], axis=-1))
        return np.eye(3)[axis] * side, np.zeros((*p.shape, 3))

    def _level(self, p: Array) -> Array:
        return np.max(np.abs(p) - self._half, axis=-1)

    def _signed_distance(self, p: Array) -> Array:
        beyond = np.abs(p) - self._half
        return np.linalg.norm(np.maximum(beyond, 0), axis=1) + np.minimum(beyond.max(axis=1), 0)

    def _intersect(self, origins: Array, directions: Array) -> Array:
        with np.errstate(divide="ignore", invalid="ignore"):
            a, b = (-self._half - origins) / directions, (self._half - origins) / directions
        # A ray within a face's plane gives 0/0: that pair of faces does not bound it.
        enter = np.fmax.reduce(np.minimum(a, b), axis=1)
        leave = np.fmin.reduce(np.maximum(a, b), axis=1)
        t = np.where(enter > 0, enter, leave)
        return np.where((enter <= leave) & (leave > 0), t, np.inf)

    def _contour(self, centre: Array) -> list[Array]:
        return []

    def _fixed(self) -> list[SurfaceCurve]:
        curves = []
        for axis in range(3):
            others = [i for i in range(3) if i != axis]
            for signs in product((-1, 1), repeat=2):
                ends = np.zeros((2, 3))
                ends[:, others] = np.array(signs) * self._half[others]
                ends[:, axis] = (-self._half[axis], self._half[axis])
                n, m = (np.eye(3)[i] * s for i, s in zip(others, signs, strict=True))
                label = "edge" + "".join(
                    f"{'-+'[s > 0]}{'xyz'[i]}" for i, s in zip(others, signs, strict=True)
                )
                curves.append(self._segment("crease", label, ends[0], ends[1], n, m))
        for marking in self.markings:
            curves += self._outline(marking)
        return curves

    def _outline(self, marking: BoxPatch) -> list[SurfaceCurve]:
        axis, sign, u, v = _axes(marking.face)
        normal = np.eye(3)[axis] * sign
        half = np.array(marking.size) / 2
        corners = np.tile(normal * self._half[axis], (4, 1))
        corners[:, [u, v]] = marking.centre + half * [(-1, -1), (1, -1), (1, 1), (-1, 1)]
        return [
            self._segment("marking", f"{marking.name}.{i}", corners[i], corners[(i + 1) % 4], normal)
            for i in range(4)
        ]

    def _segment(
        self, kind: Kind, label: str, start: Array, end: Array, normal: Array, other: Array | None = None
    ) -> SurfaceCurve:
        count = arc_samples(float(np.linalg.norm(end - start)))
        points = np.linspace(start, end, count)
        second = None if other is None else np.tile(other, (count, 1))
        normals = np.tile(normal, (count, 1))
        return SurfaceCurve(
            f"{self.name}/{label}", self.name, kind, points, normals, np.ones(count, bool), second
        )

    def _pieces(self, facets: Facets = MEASURED) -> list[Piece]:
        """Every face cut along its markings' bounds; one piece a colour and face."""
        return [piece for face in FACES for piece in self._face_pieces(face)]

    def _face_pieces(self, face: Face) -> list[Piece]:
        axis, sign, u, v = _axes(face)
        markings = [m for m in self.markings if m.face == face]
        lines = []
        for k, i in enumerate((u, v)):
            cuts = [m.centre[k] + s * m.size[k] / 2 for m in markings for s in (-1, 1)]
            lines.append(
                distinct(np.clip([-self._half[i], self._half[i], *cuts], -self._half[i], self._half[i]))
            )
        x, y = np.meshgrid(*lines)
        vertices = np.zeros((x.size, 3))
        vertices[:, u], vertices[:, v], vertices[:, axis] = x.ravel(), y.ravel(), sign * self._half[axis]
        middle = [(line[1:] + line[:-1]) / 2 for line in lines]
        paint = np.zeros((len(lines[1]) - 1, len(lines[0]) - 1), int)
        colours = [self.appearance.rgba]
        for m in markings:
            within = [np.abs(middle[k] - m.centre[k]) < m.size[k] / 2 for k in (0, 1)]
            if m.rgba not in colours:
                colours.append(m.rgba)
            paint[np.ix_(within[1], within[0])] = colours.index(m.rgba)
        normals = np.tile(np.eye(3)[axis] * sign, (len(vertices), 1))
        outward = np.cross(np.eye(3)[u], np.eye(3)[v])[axis] * sign > 0
        pieces = []
        for i, colour in enumerate(colours):
            faces = grid_triangles(paint == i, wrap=False)
            if len(faces):
                faces = faces if outward else faces[:, ::-1]
                pieces.append(Piece(*used_only(vertices, normals, faces), colour))
        return pieces


def _axes(face: Face) -> tuple[int, float, int, int]:
    """Axis and sign of a face's outward normal, and the two axes of its coordinates in order."""
    axis = "xyz".index(face[1])
    u, v = (i for i in range(3) if i != axis)
    return axis, 1.0 if face[0] == "+" else -1.0, u, v
