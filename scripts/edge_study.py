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
from extremal.scenes import Appearance, Background, Box, BoxPatch, Lathe, Light, Scene, Sphere, SurfaceCurve
from extremal.sim import FrameRenderer, Sensor, fixating, scene_model

Progress = Callable[[int, int], None]
Labels = Callable[
    [SurfaceCurve, np.ndarray], np.ndarray
]  # names of a curve's points, seen from a centre; or ""

DISTANCE = 0.6  # [m] from the camera to the target
NOISE = 2.0  # [grey levels]
MATCHED = 2.0  # [px] beyond which an edgel belongs to no true edge
JUNCTION = 6.0  # [px] from the ends of visible edges within which nothing is counted
FAINT = 20.0  # [grey levels] of true contrast at the limb, below which it gets a row of its own
ALBEDO, DIFFUSE, AMBIENT = 0.5, 0.7, 0.15
BRIGHT, DARK = 0.9, 0.05
LATHE_Z, LATHE_R = (0.0, 0.05, 0.1, 0.15, 0.2), (0.046, 0.038, 0.0285, 0.037, 0.045)
ANGLES = ((0.5, 0.4, 0.1), (-0.2, 0.6, 0.7), (0.9, -0.5, -0.3))  # rotation vectors of the boxes


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
class _Case:
    scene: Scene
    labels: Labels
    background: str
    light: str = ""
    quality: str = "metrology"


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
    return _study([*fixed_cases(), *backlit_cases(), *limb_cases(), textured_case()], seeds, progress)


def simple_edge_study(seeds: int) -> list[EdgeRow]:
    """The same of edges without shading: boxes and black silhouettes."""
    return _study([*fixed_cases()[:2], *backlit_cases()[:1]], seeds, None)


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


# The scenes.


def fixed_cases() -> list[_Case]:
    """Boxes whose faces differ in shade, in three orientations and both qualities."""
    lights = (Light((1, 0.4, -0.7), DIFFUSE, AMBIENT, 0), Light((0.2, -1, -0.2), 0.3, 0, 0))
    cases = []
    for quality in ("metrology", "standard"):
        for angles in ANGLES:
            pose = RigidTransform.from_rotation(Rotation.from_rotvec(angles))
            box = Box(size=(0.12, 0.14, 0.16), T_world_object=pose, appearance=_matte(ALBEDO))
            cases.append(_Case(_scene((box,), lights, BRIGHT), _creases, "bright", quality=quality))
    return cases


def backlit_cases() -> list[_Case]:
    """Black silhouettes of a sphere and a lathe, in both qualities."""
    scene = _scene(_round_objects(0.0), (), BRIGHT)
    return [_Case(scene, _backlit, "bright", quality=quality) for quality in ("metrology", "standard")]


def limb_cases() -> list[_Case]:
    """Matte extremal boundaries under one light, from eight sides, before a bright and a dark sky."""
    cases = []
    for background, sky in (("bright", BRIGHT), ("dark", DARK)):
        for azimuth in range(0, 360, 45):
            angle = np.radians(azimuth)
            light = Light((float(np.cos(angle)), float(np.sin(angle)), 0), DIFFUSE, AMBIENT, 0)
            scene = _scene(_round_objects(ALBEDO), (light,), sky)
            cases.append(_Case(scene, _limb_labels(light, sky), background, str(azimuth)))
    return cases


def textured_case() -> _Case:
    """A sphere before a board of patches."""
    rng = np.random.default_rng(0)
    patches = []
    for y in np.arange(-6, 7) * 0.04:
        for z in np.arange(-4, 5) * 0.04:
            patches.append(_patch(f"{len(patches)}", float(y), float(z), rng))
    board = Box(
        name="board",
        size=(0.01, 0.6, 0.44),
        markings=tuple(patches),
        T_world_object=RigidTransform.from_translation([0.1, 0, 0]),
        appearance=_matte(0.8),
    )
    sphere = Sphere(radius=0.07, appearance=_matte(ALBEDO))
    light = Light((1, 0.6, -0.5), DIFFUSE, AMBIENT, 0)
    return _Case(_scene((sphere, board), (light,), BRIGHT), _sphere_limb, "textured", "31")


def _patch(name: str, y: float, z: float, rng: np.random.Generator) -> BoxPatch:
    width, height = rng.uniform(0.02, 0.039, 2)
    grey = float(rng.uniform(0.02, 1.0))
    return BoxPatch(name, "-x", (y, z), (float(width), float(height)), (grey, grey, grey, 1.0))


def _round_objects(albedo: float) -> tuple[Sphere, Lathe]:
    look = _matte(albedo)
    there, here = (RigidTransform.from_translation(t) for t in ([0, 0.1, 0], [0, -0.1, -0.1]))
    return (
        Sphere(radius=0.06, T_world_object=there, appearance=look),
        Lathe(profile_z=LATHE_Z, profile_r=LATHE_R, T_world_object=here, appearance=look),
    )


def _matte(grey: float) -> Appearance:
    return Appearance((grey, grey, grey, 1.0))


def _scene(objects: tuple, lights: tuple[Light, ...], sky: float) -> Scene:
    return Scene(objects, lights, Background((sky, sky, sky)), target=(0.0, 0.0, 0.0))


def _creases(curve: SurfaceCurve, centre: np.ndarray) -> np.ndarray:
    """Creases between two visible faces, or where the box ends."""
    other = curve.normals if curve.other_normals is None else curve.other_normals
    ray = curve.points - centre
    both = (np.sum(curve.normals * ray, axis=1) < 0) & (np.sum(other * ray, axis=1) < 0)
    return np.where(both, "box creases", "box outline")


def _backlit(curve: SurfaceCurve, centre: np.ndarray) -> np.ndarray:
    name = f"backlit {curve.object}" if curve.kind == "extremal" else ""
    return np.full(len(curve.points), name, object)


def _sphere_limb(curve: SurfaceCurve, centre: np.ndarray) -> np.ndarray:
    return np.full(len(curve.points), "sphere limb" if curve.object == "sphere" else "", object)


def _limb_labels(light: Light, sky: float) -> Labels:
    """Names by object and by what the shading leaves of the contrast at the limb itself."""

    def labels(curve: SurfaceCurve, centre: np.ndarray) -> np.ndarray:
        if curve.kind != "extremal":
            return np.full(len(curve.points), "", object)
        lit = np.maximum(-curve.normals @ np.array(light.direction), 0)
        contrast = 255 * (sky - ALBEDO * (AMBIENT + DIFFUSE * lit))
        name = f"{curve.object} limb"
        return np.where(np.abs(contrast) < FAINT, f"{name}, faint", name).astype(object)

    return labels


# From frames to errors.


def _study(cases: list[_Case], seeds: int, progress: Progress | None) -> list[EdgeRow]:
    found: dict[tuple[str, str, str], list[_Errors]] = {}
    for i, case in enumerate(cases):
        suffix = "" if case.quality == "metrology" else f" ({case.quality})"
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


def _case_errors(case: _Case, seeds: int, rng: np.random.Generator) -> Iterator[_Errors]:
    camera = Camera()
    with FrameRenderer(scene_model(case.scene.to_spec()), camera, case.quality) as renderer:
        for _ in range(seeds):
            pose = _pose(rng)
            view = View(camera, pose, Sensor(NOISE).read(renderer.render(pose), camera, rng))
            yield view_errors(view, case.scene, case.labels)


def _pose(rng: np.random.Generator) -> RigidTransform:
    """A camera on the -x axis, turned about the target by up to 3 degrees and about its own axis by up to 17."""
    y, z = rng.uniform(-0.03, 0.03, 2)
    pose = fixating(np.array([[-DISTANCE, y, z]]), np.zeros(3))[0]
    turn = rng.uniform(-1, 1, 3) * (0.01, 0.01, 0.3)
    return pose * RigidTransform.from_rotation(Rotation.from_rotvec(turn))


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
    profiles = _profiles(view.image.astype(np.float32), position, normal)
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
