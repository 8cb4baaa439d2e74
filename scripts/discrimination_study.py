"""From which radius on is an extremal boundary told from a fixed feature? The book's experiment by Monte Carlo (3.27).

A point is called extremal where |R| > 1.96 sigma_R. The limit is the smallest R that is recognised in 95 % of all trials
while 5 % of fixed features are called extremal; for normal errors (1.96 + 1.645) sigma_R. The book quotes the threshold
itself, 1.96 sigma_R, which a boundary of that radius passes every other time.
"""

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from functools import cache

import numpy as np

from extremal.estimator import OsculatingCircle
from extremal.estimator.camera import Array
from extremal.estimator.references import References, bootstrap
from extremal.estimator.sensitivity import Sensitivity, sensitivity
from extremal.scripts.book_setting import BASELINE, FIXED_POINTS, BookSetting

THRESHOLD, POWER = 1.96, 1.645  # normal quantiles: 5 % false alarms, two-sided, and 95 % power
MARKING = (-0.01186, -0.00159)  # [m] from A: 12 mm away, as `extremal sensitivity` has it
BOOK_LIMITS = (0.015, 0.003)  # [m] absolute and by one reference
POINTWISE, POOLED = 0.1, 0.02  # [px] edgels one by one, and edges pooled along the contour
CHEAP = 10  # trials of circles for one of a bundle adjustment
VIEWS = 3
BOOTSTRAPPED = "bootstrapped references"
SHARES = ("power", "false_alarms", "with_references", "false_references")


@dataclass(frozen=True)
class Errors:
    """Standard deviations of independent errors: of edges [px], of every view's position [m] and rotation [rad], each axis."""

    edge: float
    position: float
    rotation: float

    @property
    def pose_sigma(self) -> Array:
        """(6,) of a pose."""
        return np.repeat([self.position, self.rotation], 3)


Estimates = tuple[Array, Array]  # R and sigma_R (trials) [m]
Method = Callable[[BookSetting, Errors, int, np.random.Generator], Estimates]


@dataclass(frozen=True)
class LimitRow:
    """The limit of one method.

    Attributes:
        robot, method: what is compared.
        position_mm, rotation_mrad, edge_px: standard deviations of the errors.
        sigma_mm: median stated sigma of R.
        threshold_mm: 1.96 sigma, the book's limit.
        normal_limit_mm: (1.96 + 1.645) sigma.
        limit_mm: the smallest R recognised in 95 % of the trials.
        power: share recognised at that R, in other trials.
        false_alarms: share of fixed features that are called extremal.
    """

    robot: str
    method: str
    position_mm: float
    rotation_mrad: float
    edge_px: float
    sigma_mm: float
    threshold_mm: float
    normal_limit_mm: float
    limit_mm: float
    power: float
    false_alarms: float


@dataclass(frozen=True)
class ReferenceRow:
    """What references the bootstrap finds among A, at one radius, and the 12 fixed points.

    Attributes:
        robot, edge_px: as in LimitRow.
        radius_mm: of A, no fixed feature.
        with_references: share of trials in which references stand out.
        references: their mean number in these.
        false_references: share of all references that are none, that is A.
    """

    robot: str
    edge_px: float
    radius_mm: float
    with_references: float
    references: float
    false_references: float


def discrimination_study(trials: int, seed: int = 0) -> list[LimitRow]:
    """Limits of all methods with two robots and three qualities of edges, from `trials` bundle adjustments each."""
    rows = []
    for robot, errors in _settings():
        for name, method in METHODS.items():
            count = trials if method is joint else CHEAP * trials
            rows.append(limit_row(robot, name, errors, count, np.random.default_rng(seed)))
    return rows


def reference_study(rows: Sequence[LimitRow], trials: int, seed: int = 0) -> list[ReferenceRow]:
    """The references found where A's radius is sigma, and at the limits of `rows`."""
    limits = {(row.robot, row.edge_px): row for row in rows if row.method == BOOTSTRAPPED}
    out = []
    for robot, errors in _settings():
        limit = limits[robot, errors.edge]
        for radius in (limit.sigma_mm, limit.limit_mm):
            setting, rng = _setting(1e-3 * radius), np.random.default_rng(seed)
            out.append(reference_row(robot, setting, errors, trials, rng))
    return out


def reference_row(
    robot: str, setting: BookSetting, errors: Errors, trials: int, rng: np.random.Generator
) -> ReferenceRow:
    """The references found in a number of trials."""
    fixed = np.array([found.fixed for found in references(setting, errors, trials, rng)])
    some, count = float(np.mean(fixed.any(axis=1))), int(fixed.sum())
    own = (some, count / max(some * trials, 1.0), float(fixed[:, 0].sum()) / max(count, 1))
    return ReferenceRow(robot, errors.edge, 1e3 * setting.radius, *own)


def _settings() -> list[tuple[str, Errors]]:
    book = book_errors()
    robots = {"the book's": (book.position, book.rotation), "1 mm, 1 mrad": (1e-3, 1e-3)}
    edges = (book.edge, POOLED, POINTWISE)
    return [(robot, Errors(edge, *poses)) for robot, poses in robots.items() for edge in edges]


def limit_row(robot: str, name: str, errors: Errors, trials: int, rng: np.random.Generator) -> LimitRow:
    """The limit of one method, from 3 `trials`: fixed features, boundaries near the limit, and at it."""
    method = METHODS[name]
    fixed, sigma = method(_setting(0.0), errors, trials, rng)
    false_alarms = float(np.mean(np.abs(fixed) > THRESHOLD * sigma))
    expected = (THRESHOLD + POWER) * float(np.median(sigma))
    radius, sigma = method(_setting(expected), errors, trials, rng)
    # a trial with the error e recognises every R that exceeds 1.96 sigma - e
    limit = float(np.quantile(THRESHOLD * sigma - (radius - expected), 0.95))
    radius, again = method(_setting(limit), errors, trials, rng)
    power = float(np.mean(np.abs(radius) > THRESHOLD * again))
    typical = 1e3 * float(np.median(sigma))
    own = (1e3 * errors.position, 1e3 * errors.rotation, errors.edge)
    limits = (typical, THRESHOLD * typical, (THRESHOLD + POWER) * typical, 1e3 * limit)
    return LimitRow(robot, name, *own, *limits, power, false_alarms)


def limit_table(rows: Sequence[LimitRow] | Sequence[ReferenceRow]) -> str:
    """The rows as a table in GitHub's Markdown."""
    names = [field.name for field in fields(rows[0])]
    left = [isinstance(getattr(rows[0], name), str) for name in names]
    lines = [" | ".join(names), " | ".join("---" if text else "---:" for text in left)]
    lines += [" | ".join(_cell(name, getattr(row, name)) for name in names) for row in rows]
    return "\n".join(f"| {line} |" for line in lines)


def _cell(name: str, value: str | float) -> str:
    if isinstance(value, str):
        return value
    return f"{value:.1%}" if name in SHARES else f"{value:.3g}"


@cache
def book_errors() -> Errors:
    """The errors for which 1.96 sigma_R is the book's 15 mm absolute and its 3 mm by one reference, with poses good to
    the same part of the travel as of the total rotation."""
    found = _setting(0.0).sensitivity()
    kinds = Errors(0.0, BASELINE, _setting(0.0).rotation), Errors(1.0, 0.0, 0.0)
    by_square = np.array([[_variance(found, e)[0], _relative_variance(found, e)[0]] for e in kinds])
    parts, edge = np.sqrt(np.linalg.solve(by_square.T, (np.array(BOOK_LIMITS) / THRESHOLD) ** 2))
    return Errors(float(edge), float(parts * kinds[0].position), float(parts * kinds[0].rotation))


def _setting(radius: float) -> BookSetting:
    return BookSetting(radius, MARKING)


# The methods.


def absolute(setting: BookSetting, errors: Errors, trials: int, rng: np.random.Generator) -> Estimates:
    """R of the osculating circle at A."""
    circles, found = _circles(setting, errors, trials, rng)
    sigma = np.sqrt(_variance(found, errors))
    return circles.radius[::2], np.where(found.valid, sigma, np.inf)[::2]


def one_reference(setting: BookSetting, errors: Errors, trials: int, rng: np.random.Generator) -> Estimates:
    """R_A - R_B: parallax against the marking."""
    circles, found = _circles(setting, errors, trials, rng)
    sigma = np.sqrt(_relative_variance(found, errors))
    known = found.valid[::2] & found.valid[1::2]
    return circles.radius[::2] - circles.radius[1::2], np.where(known, sigma, np.inf)


def bootstrapped(setting: BookSetting, errors: Errors, trials: int, rng: np.random.Generator) -> Estimates:
    """R at A given the references among A and 12 points around; where none stand out, R of the osculating circle."""
    found = references(setting, errors, trials, rng)
    return np.array([f.radius[0] for f in found]), np.array([f.sigma_radius[0] for f in found])


def references(
    setting: BookSetting, errors: Errors, trials: int, rng: np.random.Generator
) -> list[References]:
    """The references of each trial among A (first) and 12 points around, none of which is known to be fixed.

    Three tangents fit a circle exactly whatever the poses: all radii free, an adjustment would leave poses as they are.
    """
    edges = errors.edge * rng.standard_normal((trials, VIEWS))
    points = errors.edge * rng.standard_normal((trials, FIXED_POINTS, VIEWS, 2))
    poses = errors.pose_sigma * rng.standard_normal((trials, VIEWS, 6))
    circles = _flat(setting.circles_around(edges, points, poses))
    found, lead = sensitivity(circles, setting.views), (trials, 1 + FIXED_POINTS)
    own = np.where(found.valid, _image_variance(found, errors), np.inf).reshape(lead)
    shared = (found.pose * errors.pose_sigma).reshape(*lead, -1)
    contour = np.arange(1 + FIXED_POINTS)
    radii = circles.radius.reshape(lead)
    return [bootstrap(*trial, contour) for trial in zip(radii, own, shared, strict=True)]


def joint(setting: BookSetting, errors: Errors, trials: int, rng: np.random.Generator) -> Estimates:
    """R at A of a contour bundle adjustment with 12 fixed points around, and without B."""
    found = []
    for _ in range(trials):
        edges = errors.edge * rng.standard_normal(VIEWS)
        points = errors.edge * rng.standard_normal((FIXED_POINTS, VIEWS, 2))
        poses = errors.pose_sigma * rng.standard_normal((VIEWS, 6))
        shape = setting.joint(edges, points, poses, errors.edge, errors.pose_sigma).shapes[0]
        found.append((shape.radius[0], shape.sigma_radius[0]))
    radius, sigma = np.array(found).T
    return radius, sigma


METHODS: dict[str, Method] = {
    "absolute": absolute,
    "1 reference": one_reference,
    BOOTSTRAPPED: bootstrapped,
    f"joint, {FIXED_POINTS} fixed points": joint,
}


def _circles(
    setting: BookSetting, errors: Errors, trials: int, rng: np.random.Generator
) -> tuple[OsculatingCircle, Sensitivity]:
    """Circles at A, B, A, B, ... (2 trials) with their sensitivities, as the estimates have them."""
    edges = errors.edge * rng.standard_normal((trials, 2, VIEWS))
    poses = errors.pose_sigma * rng.standard_normal((trials, VIEWS, 6))
    circles = _flat(setting.circles(edges, poses))
    return circles, sensitivity(circles, setting.views)


def _flat(circles: OsculatingCircle) -> OsculatingCircle:
    """Circles (trials, n) as (trials n)."""
    arrays = {f.name: getattr(circles, f.name) for f in fields(OsculatingCircle)}
    return OsculatingCircle(**{name: a.reshape(-1, *a.shape[2:]) for name, a in arrays.items()})


def _image_variance(found: Sensitivity, errors: Errors) -> Array:
    """Variance (n,) [m^2] of R by the edges alone."""
    return errors.edge**2 * np.sum(found.image**2, axis=(1, 2))


def _variance(found: Sensitivity, errors: Errors) -> Array:
    """Variance (n,) [m^2] of R by independent errors (eq. 3.26)."""
    return _image_variance(found, errors) + np.sum((found.pose * errors.pose_sigma) ** 2, axis=(1, 2))


def _relative_variance(found: Sensitivity, errors: Errors) -> Array:
    """Variance (n / 2,) [m^2] of R_A - R_B for points A, B, A, B, ...: what is common to both cancels."""
    own = _image_variance(found, errors)
    shared = (found.pose[::2] - found.pose[1::2]) * errors.pose_sigma
    return own[::2] + own[1::2] + np.sum(shared**2, axis=(1, 2))


def main() -> None:
    """Print the tables for a number of trials: python -m extremal.scripts.discrimination_study 1000."""
    trials = int(sys.argv[1]) if len(sys.argv) > 1 else 1000
    rows = discrimination_study(trials)
    print(limit_table(rows), limit_table(reference_study(rows, trials)), sep="\n\n")


if __name__ == "__main__":
    main()
