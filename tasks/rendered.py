"""A sensor that looks: frames rendered by MuJoCo, through the real vision pipeline."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from extremal.estimator.camera import Array, Camera, View
from extremal.estimator.contours import SYSTEMATIC, Contours, find_contours
from extremal.estimator.errors import InvalidInput
from extremal.estimator.estimates import OVERLAP
from extremal.estimator.sequential import SequentialShape
from extremal.estimator.threads import one_blas_thread
from extremal.scenes import Scene
from extremal.scenes.grids import MEASURED, QUICK
from extremal.sim import FrameRenderer, Quality, Sensor, scene_model
from extremal.sim.quality import get_quality
from extremal.sim.window import cropped
from extremal.tasks.edge_contrasts import EdgeContrasts
from extremal.tasks.edge_model import PREVIEW, EdgeModel
from extremal.tasks.features import Features
from extremal.tasks.section_tracks import LEAST_TILT, STEEPER, SectionTracks
from extremal.tasks.track_sets import (
    FIRST_LOOKS,
    SPACING,
    PoseRoots,
    TrackSets,
    checked_pose,
    checked_spacing,
    first_baseline,
)

FINE = replace(
    PREVIEW, sigma_px=SYSTEMATIC, fixed_sigma_px=SYSTEMATIC, bias_px=SYSTEMATIC
)  # edges in frames that are sampled finely
APART = round(OVERLAP)  # edgels along a contour from which on errors are independent
NEAREST = 0.06  # [m] of depths: past an obstacle at the wanted clearance, tangents are as short
MOST = 40  # tracks that are estimated

AROUND = 32  # [px] about a track in which the frame is looked at: as far as neighbours help to judge an edge
GRID = 16  # [px] to which parts of frames are rounded


@dataclass(frozen=True, eq=False)
class _Look:
    """A view of the whole frame or of a part, at whose pixel `corner` (2,) it begins; its contours are found once for all sets."""

    view: View
    contours: Contours
    corner: Array
    whole: bool


class RenderedSensor:
    """Follows contours in rendered frames; see `track_sets` for the rules. Of one thread."""

    def __init__(
        self, quality: str | Quality = "preview", sensor: Sensor | None = None, spacing: float = SPACING
    ) -> None:
        self._quality, self._sensor, self._spacing = quality, sensor or Sensor(), checked_spacing(spacing)
        self._renderer: FrameRenderer | None = None
        self._sets: TrackSets[_Look] | None = None

    def reset(self, scene: Scene, camera: Camera, rng: np.random.Generator) -> None:
        """See `FeatureSensor`; raises RenderingError where there is no offscreen rendering."""
        self.close()
        coarse = get_quality(self._quality).supersampling == 1
        edges, facets = (PREVIEW, QUICK) if coarse else (FINE, MEASURED)
        self._renderer = FrameRenderer(scene_model(scene.to_spec(facets)), camera, self._quality).__enter__()
        self._camera, self._seed, self._looks = camera, rng.integers(2**63, size=2), 0
        self._sets = TrackSets(lambda: self._new_tracks(edges), self._spacing)
        self._pose, self._frame = None, None

    def _new_tracks(self, edges: EdgeModel) -> "_Tracks":
        self._newest = _Tracks(edges)
        return self._newest

    def look(self, T_world_camera: Array, T_world_camera_believed: Array, pose_covariance: Array) -> Features:
        """See `FeatureSensor`."""
        if self._sets is None:
            raise InvalidInput("a sensor looks at nothing before `reset`")
        actual, believed = checked_pose(T_world_camera), checked_pose(T_world_camera_believed)
        centre = believed[:3, 3]
        self._pose, self._frame = RigidTransform(actual, normalize=False), None
        self._looks += 1
        if not self._sets.is_new(centre):
            return self._sets.features
        # threads that wait for more matrices would keep the renderer from its cores
        with one_blas_thread():
            seen = self._seen(RigidTransform(believed, normalize=False), pose_covariance)
            return self._sets.take_in(seen, centre)

    def _seen(self, believed: RigidTransform, pose_covariance: Array) -> _Look:
        """The frame; where no tracks have yet to start, only what is near to those that are followed."""
        near = self._newest.expected(believed, self._camera) if self._newest.started else np.zeros((0, 2))
        if not len(near) or self._sensor.vignetting > 0:  # about the middle of the whole frame
            view = View(self._camera, believed, self._image(), pose_covariance)
            return _Look(view, find_contours(view.image, view.camera), np.zeros(2), True)
        part, corner = _part(self._camera, near)
        view = View(part, believed, self._taken(part), pose_covariance)
        return _Look(view, find_contours(view.image, part, _far_from(near - corner, part)), corner, False)

    @property
    def frame(self) -> NDArray[np.uint8] | None:
        """See `FeatureSensor`; of looks that are left out, it is rendered when it is asked for."""
        return None if self._pose is None else self._image()

    def close(self) -> None:
        """Free the renderer's buffers."""
        if self._renderer is not None:
            self._renderer.close()
        self._renderer = self._sets = None
        self._pose = None

    def _image(self) -> NDArray[np.uint8]:
        """The image of the last look: the same whether and when it is asked for."""
        if self._frame is None:
            self._frame = self._taken(self._camera)
        return self._frame

    def _taken(self, camera: Camera) -> NDArray[np.uint8]:
        """What the camera, or a part of it, takes in the last look."""
        if self._renderer is None or self._pose is None:
            raise InvalidInput("a sensor looks at nothing before `reset`")
        rng = np.random.default_rng([*self._seed, self._looks])
        return self._sensor.read(self._renderer.render(self._pose, part=camera), camera, rng)


class _Tracks(SequentialShape):
    """One set of tracks: matched view by view as in the sequential estimate; `SectionTracks` estimates and tells."""

    def __init__(self, edges: EdgeModel) -> None:
        super().__init__(FIRST_LOOKS, nearest=NEAREST)
        self._edges = edges
        self._sections: SectionTracks | None = None
        self._root = PoseRoots()

    def take_in(self, look: _Look) -> None:
        if self.started:
            self._pixels = self._pixels - look.corner
            self._follow(look.view, look.contours)
            self._pixels = self._pixels + look.corner
        elif look.whole:  # what other tracks are near to is no place to look for new ones
            self._baseline = first_baseline(look.view.pose_covariance)
            self.update(look.view, look.contours)

    def expected(self, T_world_camera: RigidTransform, camera: Camera) -> Array:
        """Pixels (n, 2) of the camera's frame near which tracks should be seen from a pose."""
        points, _ = self._circles.predict(T_world_camera.translation)
        pixels = camera.project(T_world_camera.inv().apply(points))
        size = (camera.width, camera.height)
        with np.errstate(invalid="ignore"):
            return pixels[np.all((pixels > -AROUND) & (pixels < np.add(size, AROUND)), axis=1)]

    def _begin(self) -> None:
        """From here on only the points that are estimated are followed."""
        super()._begin()
        rows, circles = self._rows, self._circles
        self._planes = circles.planes = self._planes.take(rows)
        for name in ("information", "vector", "covariance", "state"):
            setattr(circles, name, getattr(circles, name)[rows])
        for name in ("_direction", "_loose", "_pixels"):
            setattr(self, name, getattr(self, name)[rows])
        self._rows = np.arange(len(rows))

    def _absorb(self, view: View, normals: Array, sigma: Array, contrast: Array) -> np.ndarray:
        """Of the contour points a few, whose errors are their own, in place of all in a `ContourFilter`."""
        pose = view.T_world_camera.as_matrix()
        if self._sections is None:
            up = np.einsum("ni,ni->n", normals @ pose[:3, :3].T, self._frame[:, 2])
            steep = np.isfinite(sigma) & (up**2 < 1 - (STEEPER * LEAST_TILT) ** 2)
            self._rows = np.flatnonzero(steep)[_thinned(self._contour[steep])]
            origin = self._origin[self._rows]
            self._sections = SectionTracks(
                origin,
                self._frame[self._rows],
                self._contour[self._rows],
                np.linalg.norm(origin - view.centre, axis=1),
                view.camera.fx,
                self._edges,
                noisy_slant=True,
                may_stray=True,
            )
            self._contrasts = EdgeContrasts(len(origin))
        root = self._root.of(view.pose_covariance)
        # the pipeline does not know how coarsely a frame was sampled
        sigma = np.maximum(sigma[self._rows], self._edges.either_px / view.camera.fx)
        changed = self._contrasts.changed(
            np.where(np.isfinite(sigma), contrast[self._rows], np.nan), self._sections.fixed
        )
        strayed = np.zeros(len(normals), bool)
        strayed[self._rows] = changed | self._sections.take_in(
            pose, root, normals[self._rows], np.where(changed, np.inf, sigma)
        )
        return strayed

    def features(self) -> Features:
        if self._sections is None:
            return Features.empty()
        return self._sections.features(self._pixels[self._rows])


def _part(camera: Camera, near: Array) -> tuple[Camera, Array]:
    """The part of a camera that holds what is AROUND pixels (n, 2), and the pixel (2,) at its corner."""
    size = np.array([camera.width, camera.height])
    first = np.floor((near.min(axis=0) - AROUND) / GRID).astype(int) * GRID
    last = np.ceil((near.max(axis=0) + AROUND) / GRID).astype(int) * GRID
    first = np.clip(first, 0, size - 2 * GRID)
    last = np.clip(last, first + 2 * GRID, size)
    return cropped(camera, *map(int, (*first, *(last - first)))), first


def _far_from(near: Array, camera: Camera) -> NDArray[np.bool_]:
    """Pixels (height, width) that are not AROUND pixels (n, 2)."""
    far = np.ones((camera.height, camera.width), bool)
    for x, y in np.rint(near).astype(int):
        far[max(y - AROUND, 0) : max(y + AROUND, 0), max(x - AROUND, 0) : max(x + AROUND, 0)] = False
    return far


def _thinned(contour: NDArray[np.integer]) -> NDArray[np.integer]:
    """Rows (n) to keep, of points in order along contours: every APART-th, or where these are more than MOST, fewer, of each contour as
    the square root of its length: a long one is to be known better, but may not outvote all others."""
    _, of, count = np.unique(contour, return_inverse=True, return_counts=True)
    room = (count + APART // 2) // APART
    share = MOST * np.sqrt(room) / max(np.sqrt(room).sum(), 1.0)
    kept, count = np.minimum(room, np.maximum(share, 1).astype(int))[of], count[of]
    rank = np.arange(len(contour)) - np.searchsorted(contour, contour)
    return np.flatnonzero((rank + 1) * kept // count > rank * kept // count)
