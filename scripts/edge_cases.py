"""Scenes of which every edge is known, and the cameras that look at them: what `edge_study` measures edges on."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from extremal.estimator import Camera
from extremal.scenes import Appearance, Background, Box, BoxPatch, Lathe, Light, Scene, Sphere, SurfaceCurve
from extremal.sim import Sensor
from extremal.sim.cameras import CAMERAS

Labels = Callable[
    [SurfaceCurve, np.ndarray], np.ndarray
]  # names of a curve's points, seen from a centre; or ""

NOISE = 2.0  # [grey levels]
FAINT = 20.0  # [grey levels] of true contrast at the limb, below which it gets a row of its own
ALBEDO, DIFFUSE, AMBIENT = 0.5, 0.7, 0.15
BRIGHT, DARK = 0.9, 0.05
LATHE_Z, LATHE_R = (0.0, 0.05, 0.1, 0.15, 0.2), (0.046, 0.038, 0.0285, 0.037, 0.045)
ANGLES = ((0.5, 0.4, 0.1), (-0.2, 0.6, 0.7), (0.9, -0.5, -0.3))  # rotation vectors of the boxes
LIT_FROM = (45, 90, 225)  # azimuths [degrees] of the lights by which other cameras look at limbs
ASIDE = 0.2  # [rad] by which other cameras look past the objects, so that these come near the image's corners
SMEAR = 1.0  # [px] of motion blur


@dataclass(frozen=True, eq=False)
class Case:
    """A scene, what its edges are called, and how it is looked at.

    Attributes:
        camera_name: "": the pinhole with read noise alone.
        aside: [rad] by which the camera may look past the target, along either axis.
        smear: [px] by which the image moves while the shutter is open.
    """

    scene: Scene
    labels: Labels
    background: str
    light: str = ""
    quality: str = "metrology"
    camera: Camera = field(default_factory=Camera)
    sensor: Sensor = field(default_factory=lambda: Sensor(NOISE))
    camera_name: str = ""
    aside: float = 0.01
    smear: float = 0.0


def fixed_cases() -> list[Case]:
    """Boxes whose faces differ in shade, in three orientations and both qualities."""
    lights = (Light((1, 0.4, -0.7), DIFFUSE, AMBIENT, 0), Light((0.2, -1, -0.2), 0.3, 0, 0))
    cases = []
    for quality in ("metrology", "standard"):
        for angles in ANGLES:
            pose = RigidTransform.from_rotation(Rotation.from_rotvec(angles))
            box = Box(size=(0.12, 0.14, 0.16), T_world_object=pose, appearance=_matte(ALBEDO))
            cases.append(Case(_scene((box,), lights, BRIGHT), _creases, "bright", quality=quality))
    return cases


def backlit_cases() -> list[Case]:
    """Black silhouettes of a sphere and a lathe, in both qualities."""
    scene = _scene(_round_objects(0.0), (), BRIGHT)
    return [Case(scene, _backlit, "bright", quality=quality) for quality in ("metrology", "standard")]


def limb_cases() -> list[Case]:
    """Matte extremal boundaries under one light, from eight sides, before a bright and a dark sky."""
    cases = []
    for background, sky in (("bright", BRIGHT), ("dark", DARK)):
        for azimuth in range(0, 360, 45):
            angle = np.radians(azimuth)
            light = Light((float(np.cos(angle)), float(np.sin(angle)), 0), DIFFUSE, AMBIENT, 0)
            scene = _scene(_round_objects(ALBEDO), (light,), sky)
            cases.append(Case(scene, _limb_labels(light, sky), background, str(azimuth)))
    return cases


def textured_case() -> Case:
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
    return Case(_scene((sphere, board), (light,), BRIGHT), _sphere_limb, "textured", "31")


def camera_cases() -> list[Case]:
    """Creases, silhouettes and limbs as other cameras see them, all over the image; and moving ones."""
    plain = [fixed_cases()[3], backlit_cases()[1]]
    plain += [case for case in limb_cases() if case.background == "bright" and int(case.light) in LIT_FROM]
    cases = []
    for name in ("industrial", "webcam"):
        preset = CAMERAS[name]
        own = {"camera": preset.camera, "sensor": preset.sensor, "camera_name": name, "aside": ASIDE}
        cases += [replace(case, **own) for case in plain]
    return cases + [replace(case, camera_name="moving", smear=SMEAR) for case in plain]


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
