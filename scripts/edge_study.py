"""How well are edges localised? Rendered frames of known scenes against the exact projected curves."""

import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields

import numpy as np
from scipy.spatial import KDTree
from scipy.spatial.transform import RigidTransform, Rotation
from scipy.special import ndtr

from extremal.estimator import Camera, Contours, View, find_contours
from extremal.estimator.contours import ROWS, _profiles
from extremal.estimator.profile import PIXEL_VARIANCE, fit_profiles, offsets
from extremal.scenes import Scene, SurfaceCurve
from extremal.scripts.edge_cases import (
    NOISE,
    Case,
    Labels,
    backlit_cases,
    camera_cases,
    fixed_cases,
    limb_cases,
    textured_case,
)
from extremal.sim import FrameRenderer, fixating, scene_model

Progress = Callable[[int, int], None]

DISTANCE = 0.6  # [m] from the camera to the target
MATCHED = 2.0  # [px] beyond which an edgel belongs to no true edge
SUB_EXPOSURES = 8  # of a frame that is smeared
JUNCTION = 6.0  # [px] from the ends of visible edges within which nothing is counted


@dataclass(frozen=True)
class EdgeRow:
    """Errors [px] of edgels across one kind of edge: positive outwards; of fixed edges, to the brighter side.

    Attributes:
        name, background, light: light is an azimuth [degrees]; "0" comes from behind the camera, "180" from
            behind the object.
        edgels: number of them.
        bias_px, sd_px: of the spline at the edgels.
        sigma_px: median of what is stated for the spline.
        coverage: fraction within 1.96 of their sigma.
        edgel_sd_px: of single edgels before a spline averages them, read as if no other edge were beside them.
        bound_px: root mean square of the Cramer-Rao bound of a single edgel, for a plain step of its contrast.
    """

    name: str
    background: str
    light: str
    edgels: int
    bias_px: float
    sd_px: float
    sigma_px: float
    coverage: float
    edgel_sd_px: float
    bound_px: float


@dataclass(frozen=True, eq=False)
class _Errors:
    """Errors [px] of n edgels, with what the estimator states of them; `edgel` is NaN where there is no edge."""

    label: np.ndarray
    spline: np.ndarray
    sigma: np.ndarray
    edgel: np.ndarray
    contrast: np.ndarray


def edge_study(seeds: int, progress: Progress | None = None) -> list[EdgeRow]:
    """Errors of every kind of edge, pooled over `seeds` frames of each scene: other poses, other noise."""
    cases = [*fixed_cases(), *backlit_cases(), *limb_cases(), textured_case(), *camera_cases()]
    return _study(cases, seeds, progress)


def simple_edge_study(seeds: int) -> list[EdgeRow]:
    """The same of edges without shading: boxes and black silhouettes."""
    return _study([*fixed_cases()[:2], *backlit_cases()[:1]], seeds, None)


def camera_edge_study(seeds: int) -> list[EdgeRow]:
    """The same as other cameras, and moving ones, see them."""
    return _study(camera_cases(), seeds, None)


def edge_table(rows: list[EdgeRow]) -> str:
    """The rows as a table in GitHub's Markdown."""
    names = [field.name for field in fields(EdgeRow)]
    lines = [" | ".join(names), " | ".join("---" if i < 3 else "---:" for i in range(len(names)))]
    lines += [" | ".join(_cell(name, getattr(row, name)) for name in names) for row in rows]
    return "\n".join(f"| {line} |" for line in lines)


def _cell(name: str, value: str | float) -> str:
    if isinstance(value, str | int):
        return str(value)
    return f"{value:.1%}" if name == "coverage" else f"{value:+.4f}" if name == "bias_px" else f"{value:.4f}"


def _study(cases: list[Case], seeds: int, progress: Progress | None) -> list[EdgeRow]:
    found: dict[tuple[str, str, str], list[_Errors]] = {}
    for i, case in enumerate(cases):
        others = [case.camera_name, "" if case.quality == "metrology" else case.quality]
        suffix = "".join(f" ({word})" for word in others if word)
        for errors in _case_errors(case, seeds, np.random.default_rng([7, i])):
            for name in np.unique(errors.label):
                part = _Errors(*(getattr(errors, f.name)[errors.label == name] for f in fields(_Errors)))
                found.setdefault((f"{name}{suffix}", case.background, case.light), []).append(part)
        if progress:
            progress(i + 1, len(cases))
    return [_row(key, parts) for key, parts in found.items()]


def _row(key: tuple[str, str, str], parts: list[_Errors]) -> EdgeRow:
    pooled = _Errors(*(np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(_Errors)))
    inside = np.abs(pooled.spline) < 1.96 * pooled.sigma
    bound = unit_step_bound() / np.maximum(np.abs(pooled.contrast), NOISE)
    return EdgeRow(
        *key,
        len(pooled.spline),
        float(pooled.spline.mean()),
        float(pooled.spline.std()),
        float(np.median(pooled.sigma)),
        float(inside.mean()),
        float(np.nanstd(pooled.edgel)),
        float(np.sqrt(np.mean(bound**2))),
    )


def unit_step_bound(blur: float = Camera().blur) -> float:
    """Cramer-Rao bound [px] of one edgel on a blurred step of one grey level between two unknown levels."""
    s, spread = offsets(), float(np.sqrt(blur**2 + PIXEL_VARIANCE))
    slope = np.exp(-0.5 * (s / spread) ** 2) / (np.sqrt(2 * np.pi) * spread)
    levels = np.stack([np.ones_like(s), ndtr(s / spread)], axis=1)
    left = slope - levels @ np.linalg.lstsq(levels, slope, rcond=None)[0]
    return float(NOISE / np.sqrt(ROWS) / np.linalg.norm(left))


def _case_errors(case: Case, seeds: int, rng: np.random.Generator) -> Iterator[_Errors]:
    gains = case.sensor.gains(seeds, rng)
    with FrameRenderer(scene_model(case.scene.to_spec()), case.camera, case.quality) as renderer:
        for i in range(seeds):
            pose = _pose(case.aside, rng)
            frame = renderer.render(_exposure(pose, case.smear, case.camera, rng), gains[i])
            view = View(case.camera, pose, case.sensor.read(frame, case.camera, rng))
            yield view_errors(view, case.scene, case.labels)


def _pose(aside: float, rng: np.random.Generator) -> RigidTransform:
    """A camera on the -x axis, turned away from the target by up to `aside` [rad] and about its own axis by up to 0.3."""
    y, z = rng.uniform(-0.03, 0.03, 2)
    pose = fixating(np.array([[-DISTANCE, y, z]]), np.zeros(3))[0]
    turn = rng.uniform(-1, 1, 3) * (aside, aside, 0.3)
    return pose * RigidTransform.from_rotation(Rotation.from_rotvec(turn))


def _exposure(pose: RigidTransform, smear: float, camera: Camera, rng: np.random.Generator) -> RigidTransform:
    """Poses of sub-exposures around one, of a camera that moves sideways and smears the target by so many pixels."""
    if not smear:
        return pose
    direction, steps = rng.uniform(0, 2 * np.pi), (np.arange(SUB_EXPOSURES) + 0.5) / SUB_EXPOSURES - 0.5
    way = smear * DISTANCE / camera.fx * np.array([np.cos(direction), np.sin(direction), 0.0])
    return pose * RigidTransform.from_translation(steps[:, None] * way)


def view_errors(view: View, scene: Scene, labels: Labels) -> _Errors:
    """Errors of the edgels of one view that belong to a labelled true edge."""
    contours = find_contours(view.image, view.camera)
    pixels, outward, bend, label, ends = _true_curves(view, scene, labels)
    distance, nearest = KDTree(pixels).query(contours.positions)
    use = (distance < MATCHED) & (label[nearest] != "")
    if len(ends):
        use &= KDTree(ends).query(contours.positions)[0] > JUNCTION
    at = np.asarray(nearest)[use]
    normals = contours.normals[use]
    out = np.where(np.isfinite(outward[at]), outward[at], normals)
    across = np.stack([-bend[at, 3], bend[at, 2]], axis=1)  # of the curve, exactly
    across *= np.sign(np.sum(across * out, axis=1))[:, None]
    error = _across(contours.positions[use] - pixels[at], across, bend[at])
    step, keeps = _edgel_steps(view, contours)
    edgel = error + np.where(keeps, step, np.nan)[use] * np.sum(normals * across, axis=1)
    return _Errors(label[at], error, contours.sigma[use], edgel, contours.contrast[use])


def _across(d: np.ndarray, across: np.ndarray, bend: np.ndarray) -> np.ndarray:
    """Distance (n,) of points at d (n, 2) from samples of curves that bend: the curve is a parabola there."""
    t = np.sum(d * bend[:, 2:], axis=1)
    return np.sum(d * across, axis=1) - 0.5 * t**2 * np.sum(bend[:, :2] * across, axis=1)


def _edgel_steps(view: View, contours: Contours) -> tuple[np.ndarray, np.ndarray]:
    """Single edgels found again from the finished splines: steps (n,) [px] along the normals; whether found."""
    camera = view.camera
    lines = contours.u[:, None] + np.arange(ROWS) - (ROWS - 1) / 2
    position, _, normal, curvature = contours.splines.frame(lines)
    profiles = _profiles(camera.linear(view.image), position, normal)
    fit = fit_profiles(profiles, contours.noise, ROWS, camera.blur, contours.contour)
    step = fit.offset - 0.5 * (camera.blur**2 + PIXEL_VARIANCE) * curvature.mean(axis=1)
    return step, np.isfinite(fit.sigma) & (fit.sigma < 0.7)


def _true_curves(view: View, scene: Scene, labels: Labels) -> tuple[np.ndarray, ...]:
    """Visible true edges as dense points: pixels, outward normals (NaN: none), (curvature vector, tangent), label;
    and the ends of their visible parts."""
    rows, ends = [], []
    for curve in scene.true_edges(view.centre):
        if not curve.visible.any():
            continue
        pixels = view.project(curve.points)
        outward = np.full_like(pixels, np.nan)
        if curve.kind == "extremal":
            outward = view.project(curve.points + 1e-5 * curve.normals) - pixels
        columns = pixels, outward, _bend(pixels), labels(curve, view.centre)
        rows.append([column[curve.visible] for column in columns])
        ends.append(pixels[_ends(curve)])
    return *(np.concatenate(column) for column in zip(*rows, strict=True)), np.concatenate(ends)


def _bend(pixels: np.ndarray) -> np.ndarray:
    """Curvature vectors [1/px] and unit tangents (n, 4) of a dense curve at its points."""
    closed = np.linalg.norm(pixels[0] - pixels[-1]) < 1e-6
    before, after = np.roll(pixels, 1, axis=0), np.roll(pixels, -1, axis=0)
    if closed:
        before[0], after[-1] = pixels[-2], pixels[1]
    else:
        before[0], after[-1] = 2 * pixels[0] - pixels[1], 2 * pixels[-1] - pixels[-2]
    a, b = pixels - before, after - pixels
    la, lb = (np.maximum(np.linalg.norm(v, axis=1, keepdims=True), 1e-9) for v in (a, b))
    tangent = (a / la * lb + b / lb * la) / (la + lb)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    return np.concatenate([2 * (b / lb - a / la) / (la + lb), tangent], axis=1)


def _ends(curve: SurfaceCurve) -> np.ndarray:
    """Whether a point (N,) is the first or the last of a visible part."""
    closed = np.linalg.norm(curve.points[0] - curve.points[-1]) < 1e-9
    seen = np.pad(curve.visible, 1, mode="wrap" if closed else "constant")
    return curve.visible & ~(seen[:-2] & seen[2:])


def main() -> None:
    """Print the table for a number of frames of each scene: python -m extremal.scripts.edge_study 4."""
    seeds = int(sys.argv[1]) if len(sys.argv) > 1 else 4
    print(edge_table(edge_study(seeds, lambda done, total: print(done, total, file=sys.stderr))))


if __name__ == "__main__":
    main()
