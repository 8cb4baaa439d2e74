"""Answers about a contour: what it is, how curved, where; and how good an answer is."""

import math
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from extremal.estimator.camera import Array
from extremal.estimator.errors import InvalidInput
from extremal.tasks.compiled import compiled
from extremal.tasks.inspect_setup import InspectTruth
from extremal.tasks.triples import Vector, dot, plus, put, row, unit

LARGEST = 0.1  # [m] radii are taken to be anywhere from 0 to this, before anything is seen
WORTHLESS = 0.02  # [m] of the score of R at which an answer is worth nothing
LEAST, ALONG = 1e-12, 1e-9  # [m] of a ray; sine of its angle to a normal that it runs along
RIGHT, RIGHT_SHARE, RIGHT_PLACE = 0.002, 0.1, 0.01  # [m], of R, [m]: errors of an answer that is called right


@dataclass(frozen=True, eq=False)
class Answer:
    """What is believed of a contour.

    Attributes:
        extremal: probability that it is an extremal boundary.
        radius, sigma: normal belief of its radius of curvature [m], if it is one.
        point: (3,) contact point [m].
    """

    extremal: float
    radius: float
    sigma: float
    point: Array

    def __post_init__(self) -> None:
        values = [self.extremal, self.radius, self.sigma, *np.ravel(self.point)]
        if (
            len(values) != 6
            or not np.all(np.isfinite(values))
            or not 0 <= self.extremal <= 1
            or not self.sigma > 0
        ):
            raise InvalidInput(
                f"an answer is {values}; accepted: a probability, a radius, a positive sigma and a point, all finite"
            )


def probability_extremal(radius: float, sigma: float) -> float:
    """That a contour of measured R +- sigma [m] is an extremal boundary: of any radius up to LARGEST, as likely as a fixed one."""
    boundary = (float(ndtr((LARGEST - radius) / sigma)) - float(ndtr(-radius / sigma))) / LARGEST
    fixed = _density(radius / sigma) / sigma
    return boundary / (boundary + fixed) if boundary + fixed > 0 else 0.5


@compiled
def contact_from(eye: Vector, points: Array, normals: Array, radii: Array) -> Array:
    """Contact points (n, 3) [m] of the osculating circles at points with the rays from another place: the contour generator
    slides over the surface as the eye moves. A fixed feature (radius 0) stays.

    Args:
        eye: [m]. points: (n, 3) [m]. normals: (n, 3), of any length, out of the circles. radii: (n,) [m].
    """
    out = np.empty(points.shape)
    for i in range(len(points)):
        put(out, i, _slid(eye, row(points, i), unit(row(normals, i)), radii[i]))
    return out


@compiled
def _slid(eye: Vector, point: Vector, normal: Vector, radius: float) -> Vector:
    centre = plus(point, -radius, normal)
    away = plus(centre, -1.0, eye)
    share = radius / max(math.sqrt(dot(away, away)), LEAST)
    along = unit(away)
    across = plus(normal, -dot(normal, along), along)
    if abs(share) >= 1 or math.sqrt(dot(across, across)) < ALONG:
        return point
    return plus(plus(centre, -radius * share, along), radius * math.sqrt(1 - share * share), unit(across))


def crps(mean: float, sigma: float, value: float) -> float:
    """Continuous ranked probability score [m] of a normal belief (Gneiting and Raftery 2007): proper, 0 at best."""
    z = (value - mean) / sigma
    return sigma * (z * (2 * float(ndtr(z)) - 1) + 2 * _density(z) - float(np.pi) ** -0.5)


def quality(answer: Answer, truth: InspectTruth) -> float:
    """In [0, 1], greatest in expectation for whoever says what he believes: Brier's score of the label, and of an extremal
    boundary as much again for R."""
    label = 1 - (answer.extremal - float(not truth.is_fixed)) ** 2
    if truth.is_fixed:
        return label
    return 0.5 * label + 0.5 * max(0.0, 1 - crps(answer.radius, answer.sigma, truth.radius) / WORTHLESS)


def negative_log_likelihood(answer: Answer, truth: InspectTruth) -> float:
    """Of label and, for an extremal boundary, of R per millimetre: over-confidence costs without limit."""
    right = answer.extremal if not truth.is_fixed else 1 - answer.extremal
    loss = -np.log(max(right, 1e-12))
    if not truth.is_fixed:
        z, spread = (truth.radius - answer.radius) / answer.sigma, 1e3 * answer.sigma
        loss += 0.5 * z**2 + np.log(spread * np.sqrt(2 * np.pi))
    return float(loss)


def is_right(answer: Answer, truth: InspectTruth) -> bool:
    """Label, contact point within RIGHT_PLACE and, of an extremal boundary, R within RIGHT or RIGHT_SHARE of it."""
    label = (answer.extremal > 0.5) == (not truth.is_fixed)
    place = float(np.linalg.norm(answer.point - truth.point)) <= RIGHT_PLACE
    if truth.is_fixed:
        return label and place
    return label and place and abs(answer.radius - truth.radius) <= max(RIGHT, RIGHT_SHARE * truth.radius)


def _density(z: float) -> float:
    """Of the standard normal distribution."""
    return float(np.exp(-0.5 * z**2) / np.sqrt(2 * np.pi))
