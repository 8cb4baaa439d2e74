"""How sets of tracks take turns while the camera moves: the same rules for every sensor.

- A look from nearer than `spacing` to the last one that was taken in adds hardly anything (errors of edges repeat) and is
  left out: the features stay as they are.
- Tracks start with FIRST_LOOKS looks over FIRST_BASELINE, or more where poses are poor.
- Where fewer than LEAST_SEEN of the tracks are seen, or the camera has turned about them by more than FARTHEST_TURN since
  they started, their epipolar planes and circles are worn out. A new set starts beside them, and takes their place as soon
  as it has its first looks. What the old set knew stays among the features, no longer visible, until the next change.
"""

import math
from collections.abc import Callable
from typing import Generic, Protocol, TypeVar

import numpy as np

from extremal.estimator.camera import Array
from extremal.estimator.epipolar import LEAST_CERTAINTY
from extremal.estimator.errors import InvalidInput
from extremal.estimator.poses import pose_root
from extremal.tasks.compiled import compiled
from extremal.tasks.features import Features
from extremal.tasks.rigid import is_finite
from extremal.tasks.triples import dot, plus

SPACING = 0.005  # [m]
FIRST_LOOKS, FIRST_BASELINE = 5, 0.02  # [m]
LEAST_SEEN = 0.25
FARTHEST_TURN = 0.9  # [rad]
CERTAINTY = (
    1.5 * LEAST_CERTAINTY
)  # standard deviations of a position that the first baseline is long, at least


L_contra = TypeVar("L_contra", contravariant=True)
S = TypeVar("S")


class Tracks(Protocol[L_contra]):
    """A set of tracks."""

    @property
    def started(self) -> bool: ...

    def take_in(self, look: L_contra) -> None: ...

    def features(self) -> Features: ...


class TrackSets(Generic[S]):
    """Sets of tracks that take turns, by the rules above."""

    def __init__(self, begin: Callable[[], Tracks[S]], spacing: float) -> None:
        self._begin, self._spacing = begin, spacing
        self._current, self._next = begin(), None
        self._past = self._told = self._features = Features.empty()
        self._origin, self._last = np.zeros(3), np.full(3, np.inf)

    @property
    def features(self) -> Features:
        return self._features

    def is_new(self, centre: Array) -> bool:
        """Whether a look from a believed centre (3,) [m] is far enough from the last one that was taken in."""
        return not math.dist(centre, self._last) < self._spacing

    def take_in(self, look: S, centre: Array) -> Features:
        """Take in a look from a believed centre (3,) [m]."""
        if np.isinf(self._last[0]):
            self._origin = centre
        self._last = centre
        self._current.take_in(look)
        if self._current.started:
            self._told = self._current.features()
        if self._next is not None:
            self._next.take_in(look)
            if self._next.started:
                self._take_over(self._next, centre)
        elif self._current.started and self._worn_out(centre):
            self._next = self._begin()
            self._next.take_in(look)
        self._features = self._told.and_then(self._past)
        return self._features

    def _take_over(self, tracks: Tracks[S], centre: Array) -> None:
        """Let the next set take the place of the current one; without tracks, for want of contours, it makes room for another."""
        self._next, told = None, tracks.features()
        if len(told):
            self._past, self._told = self._told.left(), told
            self._current, self._origin = tracks, centre

    def _worn_out(self, centre: Array) -> bool:
        told = self._told
        if len(told) == 0 or np.count_nonzero(told.visible) < LEAST_SEEN * len(told):
            return True
        return _cosine_from_middle(told.position, self._origin, centre) < math.cos(FARTHEST_TURN)


@compiled
def _cosine_from_middle(points: Array, a: Array, b: Array) -> float:
    """Of the angle between a and b as it is seen from the median of points (n, 3)."""
    half = len(points) // 2
    middle = np.sort(points[:, 0])[half], np.sort(points[:, 1])[half], np.sort(points[:, 2])[half]
    to_a, to_b = plus((a[0], a[1], a[2]), -1.0, middle), plus((b[0], b[1], b[2]), -1.0, middle)
    return dot(to_a, to_b) / max(math.sqrt(dot(to_a, to_a) * dot(to_b, to_b)), 1e-12)


def first_baseline(pose_covariance: Array) -> float:
    """Way of the camera [m] from which tracks start: several times as long as positions are uncertain."""
    return max(FIRST_BASELINE, CERTAINTY * float(np.sqrt(np.trace(pose_covariance[:3, :3]) / 3)))


def checked_spacing(spacing: float) -> float:
    """A spacing of looks [m]; InvalidInput if it is none."""
    if not (np.isfinite(spacing) and spacing >= 1e-4):
        raise InvalidInput(f"spacing of looks is {spacing!r}; accepted: 0.0001 m or more")
    return spacing


def travel_of(centres: Array) -> Array:
    """(3,) unit vector of the line that is nearest to centres (n, 3), from the first to the last."""
    along = np.linalg.svd(centres - centres.mean(axis=0))[2][0]
    return along if (centres[-1] - centres[0]) @ along > 0 else -along


def checked_pose(pose: Array) -> Array:
    """The pose (4, 4); InvalidInput if it is none, or not finite."""
    matrix = np.asarray(pose, float)
    if matrix.shape != (4, 4) or not is_finite(matrix):
        raise InvalidInput(f"a pose of shape {matrix.shape} given; accepted: one finite transform (4, 4)")
    return matrix


class PoseRoots:
    """Square roots of pose covariances, remembered as long as these stay the same; all of the first one's rank.

    Attributes:
        baseline: `first_baseline` [m] of the last covariance.
    """

    def __init__(self) -> None:
        self._key, self._root, self.baseline = b"", np.zeros((6, 0)), FIRST_BASELINE

    def of(self, covariance: Array) -> Array:
        """(6, 6), or (6, 0) of an exact pose."""
        covariance = np.asarray(covariance, float)
        key = covariance.tobytes()
        if key != self._key:
            if covariance.shape != (6, 6) or not np.all(np.isfinite(covariance)):
                raise InvalidInput(f"pose covariance is {covariance.shape}; accepted: finite numbers (6, 6)")
            self._root, self.baseline, self._key = pose_root(covariance), first_baseline(covariance), key
        return self._root
