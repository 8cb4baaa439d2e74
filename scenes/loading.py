"""Scenes read from TOML: the presets and files that users write."""

import math
import os
from collections.abc import Callable
from importlib.resources import as_file, files
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from extremal.estimator.errors import InvalidInput, SceneError
from extremal.estimator.reading import read_toml
from extremal.estimator.toml_values import Reader, Table, number, numbers, text
from extremal.scenes.box import Box
from extremal.scenes.curves import Appearance
from extremal.scenes.lathe import Lathe
from extremal.scenes.markings import MOST_MARKINGS, BoxPatch, LathePatch
from extremal.scenes.mesh import Mesh
from extremal.scenes.quadrics import Ellipsoid, Sphere
from extremal.scenes.scene import Background, Light, Scene
from extremal.scenes.superquadric import Superquadric
from extremal.scenes.surface import Surface

LARGEST_FILE = 1_000_000  # bytes
MOST_CURVED = 20  # objects; cut finely into facets, each may take 130 MB and half a second
MOST_ITEMS = MOST_MARKINGS  # of a list
LARGEST_NUMBER = 1e4  # no length, angle in degrees or strength in a scene is larger


def presets() -> list[str]:
    """Names of the scenes that come with the package."""
    folder = files("extremal.scenes").joinpath("presets")
    return sorted(item.name[:-5] for item in folder.iterdir() if item.name.endswith(".toml"))


def load_scene(name_or_path: str | Path) -> Scene:
    """The preset of that name, else the scene in that TOML file.

    Raises:
        SceneError: one line that names the file and what is wrong with it.
    """
    if str(name_or_path) in presets():
        source = files("extremal.scenes").joinpath("presets").joinpath(f"{name_or_path}.toml")
        with as_file(source) as path:
            return _read(path)
    path = Path(name_or_path)
    if path.suffix != ".toml":
        raise SceneError(
            f"unknown scene {str(name_or_path)!r}; accepted: {', '.join(presets())}, or the path of a .toml file"
        )
    return _read(path)


def _read(path: Path) -> Scene:
    try:
        table = read_toml(path, LARGEST_FILE)
    except InvalidInput as error:
        raise SceneError(f"scene file {str(path)!r}: {_one_line(error)}") from None
    try:
        return _scene(Table(table, "scene"), path)
    except (InvalidInput, SceneError) as error:
        raise SceneError(f"{path.name}: {_one_line(error)}") from None


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())


_number = number(LARGEST_NUMBER)


def _numbers(count: int | None = None) -> Reader[tuple[float, ...]]:
    return numbers(LARGEST_NUMBER, MOST_ITEMS, count)


def _colour(value: Any, where: str) -> tuple[float, ...]:
    """A grey level, [r, g, b] or [r, g, b, a], each in [0, 1]."""
    if not isinstance(value, list):
        return (_number(value, where),) * 3 + (1.0,)
    channels = _numbers()(value, where)
    if len(channels) not in (3, 4):
        raise SceneError(
            f"{where} has {len(channels)} numbers; accepted: a grey level, [r, g, b] or [r, g, b, a]"
        )
    return channels if len(channels) == 4 else (*channels, 1.0)


def _scene(table: Table, path: Path) -> Scene:
    name = table.take("name", text, path.stem)
    target = table.take("target", _numbers(3), (0.0, 0.0, 0.1))
    sky = table.take("sky", _colour, (0.85, 0.87, 0.9, 1.0))[:3]
    lights = []
    for light in table.tables("lights", MOST_ITEMS):
        values: dict[str, Any] = {"direction": light.take("direction", _numbers(3))}
        for key in ("diffuse", "ambient", "specular"):
            values[key] = light.take(key, _number, getattr(Light, key))
        light.done()
        lights.append(Light(**values))
    objects = [_object(item, path.resolve().parent) for item in table.tables("objects", MOST_ITEMS)]
    table.done()
    curved = sum(not isinstance(surface, Box) for surface in objects)
    if curved > MOST_CURVED:
        raise SceneError(f"the scene has {curved} objects that are no boxes; accepted: up to {MOST_CURVED}")
    return Scene(tuple(objects), tuple(lights), Background(sky), target, name)  # pyright: ignore[reportArgumentType]


def _object(table: Table, folder: Path) -> Surface:
    kind = table.take("type", text)
    if kind not in _READERS:
        raise SceneError(f"{table.where}.type is {kind!r}; accepted: {', '.join(_READERS)}")
    position = table.take("position", _numbers(3), (0.0, 0.0, 0.0))
    angles = table.take("rotation_deg", _numbers(3), (0.0, 0.0, 0.0))
    # Rotations about the fixed world axes x, y, z in this order.
    pose = RigidTransform.from_components(
        np.array(position), Rotation.from_euler("xyz", angles, degrees=True)
    )
    common = {
        "name": table.take("name", text, kind),
        "T_world_object": pose,
        "appearance": Appearance(
            table.take("colour", _colour, Appearance.rgba),  # pyright: ignore[reportArgumentType]
            table.take("specular", _number, Appearance.specular),
            table.take("shininess", _number, Appearance.shininess),
        ),
    }
    surface = _READERS[kind](table, common, folder)
    table.done()
    return surface


def _lathe(table: Table, common: dict[str, Any], folder: Path) -> Surface:
    z, r = table.take("profile_z", _numbers()), table.take("profile_r", _numbers())
    return Lathe(
        z,
        r,
        tuple(_lathe_patch(m, i) for i, m in enumerate(table.tables("markings", MOST_MARKINGS))),
        **common,
    )


def _lathe_patch(table: Table, i: int) -> LathePatch:
    patch = LathePatch(
        table.take("name", text, f"marking{i}"),
        math.radians(table.take("azimuth_deg", _number, 0.0)),
        math.radians(table.take("width_deg", _number)),
        table.take("bottom", _number),
        table.take("top", _number),
        table.take("colour", _colour),
    )
    table.done()
    return patch


def _box(table: Table, common: dict[str, Any], folder: Path) -> Surface:
    size = table.take("size", _numbers(3))
    return Box(
        size, tuple(_box_patch(m, i) for i, m in enumerate(table.tables("markings", MOST_MARKINGS))), **common
    )


def _box_patch(table: Table, i: int) -> BoxPatch:
    patch = BoxPatch(
        table.take("name", text, f"marking{i}"),
        table.take("face", text),
        table.take("centre", _numbers(2)),
        table.take("size", _numbers(2)),
        table.take("colour", _colour),
    )
    table.done()
    return patch


def _lengths(shape: Callable[..., Surface], *keys: str) -> Callable[[Table, dict[str, Any], Path], Surface]:
    return lambda table, common, folder: shape(*(table.take(key, _number) for key in keys), **common)


def _mesh(table: Table, common: dict[str, Any], folder: Path) -> Surface:
    relative = table.take("file", text)
    path = Path(os.path.realpath(folder / relative))  # unlike resolve(), of links in a circle too
    if Path(relative).is_absolute() or not path.is_relative_to(folder):
        raise SceneError(
            f"{table.where}.file is {relative!r}; accepted: a path within the scene file's folder"
        )
    return Mesh.from_file(path, scale=table.take("scale", _number, 1.0), **common)


_READERS: dict[str, Callable[[Table, dict[str, Any], Path], Surface]] = {
    "lathe": _lathe,
    "box": _box,
    "sphere": _lengths(Sphere, "radius"),
    "ellipsoid": _lengths(Ellipsoid, "a", "b", "c"),
    "superquadric": _lengths(Superquadric, "a", "b", "c", "e1", "e2"),
    "mesh": _mesh,
}
