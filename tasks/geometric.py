"""A sensor without images: exact apparent contours of the scene, with the errors that edges have in rendered frames."""

import math
from contextlib import nullcontext
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from extremal.estimator.camera import Array, Camera
from extremal.estimator.errors import InvalidInput
from extremal.estimator.sequential import ROUGH
from extremal.estimator.threads import blas_threads, one_blas_thread
from extremal.scenes import Scene
from extremal.tasks.company import in_company
from extremal.tasks.contacts import Contacts, EdgeGeometry
from extremal.tasks.edge_choice import choose
from extremal.tasks.edge_model import EdgeModel
from extremal.tasks.features import Features
from extremal.tasks.section_tracks import SectionTracks
from extremal.tasks.sightings import followed, last_pixels, sighted
from extremal.tasks.track_sets import (
    FIRST_LOOKS,
    SPACING,
    PoseRoots,
    TrackSets,
    checked_pose,
    checked_spacing,
    travel_of,
)
from extremal.tasks.triples import Vector, dot

SLIDES = 3e-4  # [m] of pose errors: contacts slide along curved edges by as much, and the slants seen there are off with them
OCCLUSION_TURNS = 3  # looks, in one of which what hides tracks is looked at


class GeometricSensor:
    """Follows the scene's contours with errors of edges from a model; see `track_sets` for the rules."""

    def __init__(self, edge_model: EdgeModel | None = None, spacing: float = SPACING) -> None:
        self._model, self._spacing = edge_model or EdgeModel(), checked_spacing(spacing)
        self._sets: TrackSets[_Look] | None = None
        self._roots, self._many = PoseRoots(), True

    def reset(self, scene: Scene, camera: Camera, rng: np.random.Generator) -> None:
        """See `FeatureSensor`; raises SceneError for a scene with a mesh."""
        geometry = EdgeGeometry(scene)
        # setting the number of threads takes a tenth of a look
        self._many = blas_threads() > 1
        self._roots = PoseRoots()
        self._sets = TrackSets(lambda: _Tracks(geometry, camera, self._model, rng), self._spacing)

    def look(self, T_world_camera: Array, T_world_camera_believed: Array, pose_covariance: Array) -> Features:
        """See `FeatureSensor`."""
        if self._sets is None:
            raise InvalidInput("a sensor looks at nothing before `reset`")
        actual, believed = checked_pose(T_world_camera), checked_pose(T_world_camera_believed)
        if not self._sets.is_new(believed[:3, 3]):
            return self._sets.features
        root = self._roots.of(pose_covariance)
        look = _Look(actual, believed, root, self._roots.baseline)
        with one_blas_thread() if self._many else nullcontext():
            return self._sets.take_in(look, look.believed[:3, 3])

    @property
    def frame(self) -> NDArray[np.uint8] | None:
        """None: there is no image."""
        return None

    def close(self) -> None:
        """Forget the scene."""
        self._sets = None


@dataclass(frozen=True, eq=False)
class _Look:
    """Poses as matrices (4, 4), the root (6, K) of the believed one's covariance, and the way [m] after which tracks start."""

    actual: Array
    believed: Array
    root: Array
    baseline: float


class _Seen(NamedTuple):
    """Tangent planes (n, 3) in the camera frame, sigma (n,) [rad] infinite where unseen, pixels (n, 2) and their errors (n, 2)."""

    normals: Array
    sigma: Array
    pixels: Array
    shift: Array


class _Tracks:
    """One set of tracks."""

    def __init__(
        self, geometry: EdgeGeometry, camera: Camera, model: EdgeModel, rng: np.random.Generator
    ) -> None:
        self._geometry, self._camera, self._model, self._rng = geometry, camera, model, rng
        self._waiting: list[_Look] = []
        self._looks = 0
        self.started = False

    def take_in(self, look: _Look) -> None:
        if self.started:
            self._absorb(look, self._measured(look))
            return
        self._waiting.append(look)
        centres = np.array([w.believed[:3, 3] for w in self._waiting])
        far = np.linalg.norm(centres - centres[0], axis=1).max() >= look.baseline
        if len(centres) >= FIRST_LOOKS and far:
            self._begin(travel_of(centres))
        elif len(centres) > 2 * FIRST_LOOKS:
            self._waiting = self._waiting[::2]

    def _begin(self, travel: Array) -> None:
        """Choose tracks in the middle look, and take all in that wait."""
        looks, middle = self._waiting, len(self._waiting) // 2
        at = looks[middle]
        turned = at.believed[:3, :3] @ at.actual[:3, :3].T
        contacts, contour = choose(
            self._geometry, self._camera, at.actual[:3, :3], at.actual[:3, 3], travel @ turned
        )
        n = len(contacts)
        away = (contacts.points - at.actual[:3, 3]) @ turned.T
        distance = np.linalg.norm(away, axis=1)
        ray = away / distance[:, None]
        self._noise = self._model.noise(contacts.curve >= 0)
        self._travel, self._start = travel, at.believed[:3, 3].copy()
        self._plane = _unit(np.cross(travel, ray))
        first = np.cross(ray, self._plane)
        first *= np.where(first @ travel < 0, -1.0, 1.0)[:, None]
        frame = np.stack([first, ray, np.cross(first, ray)], axis=1)
        origin = self._start + away * (1 + ROUGH * self._rng.standard_normal((n, 1)))
        slides = float(np.linalg.norm(at.root[:3])) > SLIDES
        self._sections = SectionTracks(
            origin, frame, contour, distance, self._camera.fx, self._model, noisy_slant=slides
        )
        self._bias, self._hidden, self._line = self._model.first_bias(n, self._rng), np.zeros(n, bool), None
        self._pixels = np.full((n, 2), np.nan)
        self._measure_all(contacts, looks, middle)
        self.started, self._waiting = True, []

    def _measure_all(self, contacts: Contacts, looks: list[_Look], middle: int) -> None:
        """Contacts move with the camera from the middle look to the first and on to the last."""
        self._contacts = contacts
        for look in looks[middle::-1]:
            self._move(look)
        for look in looks:
            self._absorb(look, self._measured(look))

    def _move(self, look: _Look) -> tuple[Array, Array, Vector]:
        """Contacts go where the epipolar planes, as the robot believes them to lie, meet the contours; and as `in_camera` has them."""
        of, c = self._geometry, self._contacts
        points, normals, there, u, away, ideal, line = followed(
            of.solids, of.fixed, c.points, c.normals, c.surface, c.curve, c.u,
            self._plane, self._start, look.actual, look.believed,
        )  # fmt: skip
        self._contacts = Contacts(points, normals, there, c.surface, c.curve, u)
        return away, ideal, line

    def _measured(self, look: _Look) -> _Seen:
        away, ideal, line = self._move(look)
        contacts, camera, pixels = self._contacts, self._camera, self._camera.distort(ideal)
        self._update_hidden(look.actual[:3, 3])
        error, found = self._errors(line)
        beside = in_company(
            pixels, contacts.normals, look.actual, (camera.fx, camera.fy), self._sections.contour,
            contacts.there & ~self._hidden,
        )  # fmt: skip
        normals, sigma, shift = sighted(
            away, contacts.normals, self._plane, self._travel, look.actual, look.believed, (camera.fx, camera.fy), error,
            self._model.either_px, pixels, contacts.there, self._hidden, found & ~beside, (camera.width, camera.height),
        )  # fmt: skip
        return _Seen(normals, sigma, pixels, shift)

    def _errors(self, line: Vector) -> tuple[Array, NDArray[np.bool_]]:
        """Errors (n,) [px] of edges, along whose middle goes a line of sight, and which are found."""
        if self._line is not None:
            turn = math.acos(min(max(dot(line, self._line), -1.0), 1.0))
            self._bias = self._model.next_bias(self._bias, turn, self._rng)
        self._line = line
        return self._model.draw(self._bias, self._noise, self._rng)

    def _update_hidden(self, centre: Array) -> None:
        if self._looks % OCCLUSION_TURNS == 0:
            self._hidden = self._geometry.hidden(centre, self._contacts.points)

    def _absorb(self, look: _Look, seen: _Seen) -> None:
        self._sections.take_in(look.believed, look.root, seen.normals, seen.sigma)
        self._looks += 1
        self._pixels = last_pixels(self._pixels, seen.pixels, seen.shift, self._sections.visible)

    def features(self) -> Features:
        return self._sections.features(self._pixels)


def _unit(vectors: Array) -> Array:
    return vectors / np.sqrt(np.vecdot(vectors, vectors))[:, None]
