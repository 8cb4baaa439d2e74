"""Files that are meant to hurt: one for each way known, and any number that differ from valid ones in a few bytes."""

import os
import socket
import struct
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np
import trimesh
from hostile_texts import BIG, BOX, LATHE, MESH_FILES, OUTSIDE, PATCH, POSES, ROUNDED, SCENES, SPHERE
from scipy.spatial.transform import RigidTransform, Rotation

from extremal.estimator import Camera
from extremal.estimator.board import Board
from extremal.estimator.calibration import Calibration
from extremal.estimator.calibration_file import save_calibration
from extremal.estimator.photographs import write_poses

SPECIAL = (
    "fifo",
    "directory",
    "device",
    "terminal",
    "loop",
    "dangling",
    "socket",
    "sparse",
    "empty",
    "zeros",
)
MESHES = ("obj", "off", "ply", "stl")


def calibration() -> Calibration:
    """A valid one."""
    rng = np.random.default_rng(0)
    half = rng.normal(size=(22, 22))
    turns = Rotation.random(2, rng)
    a, b = (RigidTransform.from_components(rng.normal(size=3), turn) for turn in turns)
    return Calibration(Camera(), a, b, Board(), half @ half.T, (4e-5, 5e-5), 0.005, 30, {"offset": 1e-3})


def valid(folder: Path) -> dict[str, Path]:
    """A valid file for each kind of reader, several for some: "kind name" to path."""
    folder.mkdir(parents=True, exist_ok=True)
    found: dict[str, Path] = {}
    for name, text in {"sphere": SPHERE, "lathe": LATHE + PATCH, "box": BOX, "rounded": ROUNDED}.items():
        found[f"scene {name}"] = folder / f"{name}.toml"
        found[f"scene {name}"].write_text(text)
    ball = trimesh.creation.icosphere(1, 0.05)
    for kind in MESHES:
        found[f"mesh {kind}"] = folder / f"ball.{kind}"
        ball.export(found[f"mesh {kind}"])
    found["mesh ascii"] = folder / "ascii.stl"
    ball.export(found["mesh ascii"], file_type="stl_ascii")
    found["mesh text"] = folder / "text.ply"
    ball.export(found["mesh text"], encoding="ascii")
    save_calibration(calibration(), folder / "calibration.toml")
    found["calibration c"] = folder / "calibration.toml"
    for kind in ("png", "jpg"):
        found[f"images {kind}"] = photographs(folder / kind, kind)
    found["poses p"] = found["images png"] / "poses.csv"
    return found


def photographs(folder: Path, kind: str = "png") -> Path:
    """Three photographs with their poses."""
    folder.mkdir()
    rng = np.random.default_rng(1)
    names = [f"{i}.{kind}" for i in range(3)]
    for name in names:
        cv2.imwrite(str(folder / name), cv2.resize(rng.integers(0, 255, (6, 8), dtype=np.uint8), (64, 48)))
    turns = Rotation.from_rotvec(rng.normal(size=(3, 3)))
    write_poses(
        folder / "poses.csv", names, RigidTransform.from_components(rng.uniform(-1, 1, (3, 3)), turns)
    )
    return folder


def png(width: int, height: int, rows: int | None = None) -> bytes:
    """A PNG of grey zeros, compressed: tiny, whatever its size; `rows` of them are there."""
    packed, row = zlib.compressobj(9), bytes(1 + width)
    data = b"".join(packed.compress(row) for _ in range(height if rows is None else rows)) + packed.flush()
    header = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    chunks = ((b"IHDR", header), (b"IDAT", data), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(_chunk(*chunk) for chunk in chunks)


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def _scans(jpeg: bytes, count: int) -> bytes:
    """A progressive JPEG whose last scan is there many times: every one takes a pass over the whole image."""
    start, end = jpeg.rindex(b"\xff\xda"), jpeg.rindex(b"\xff\xd9")
    return jpeg[:end] + jpeg[start:end] * count + jpeg[end:]


def special(path: Path) -> Iterator[tuple[str, Path]]:
    """What is no regular file, or leads nowhere, beside `path`: name and path."""
    folder, suffix = path.parent, path.suffix

    def place(name: str) -> Path:
        return folder / f"{name}{suffix}"

    os.mkfifo(place("fifo"))
    place("directory").mkdir()
    place("device").symlink_to("/dev/zero")
    place("terminal").symlink_to("/dev/tty")
    place("loop").symlink_to(place("loop"))
    place("dangling").symlink_to("/nowhere")
    before = Path.cwd()
    os.chdir(folder)  # names of sockets are short
    try:
        with socket.socket(socket.AF_UNIX) as listening:
            listening.bind(place("socket").name)
    finally:
        os.chdir(before)
    with place("sparse").open("wb") as file:
        file.truncate(10**12)
    place("empty").touch()
    place("zeros").write_bytes(bytes(10**6))
    for name in SPECIAL:
        yield name, place(name)


def _move(path: Path, to: Path) -> None:
    to.unlink()
    path.rename(to)


def _link(path: Path, target: Path) -> None:
    path.unlink()
    path.symlink_to(target / path.name)


def _spoiled(folder: Path, write: Callable[[Path], object]) -> Path:
    photographs(folder)
    write(folder / "1.png")
    return folder


def attacks(folder: Path) -> dict[str, str]:
    """Every attack: name to "kind path", as `hostile.load` takes them."""
    base = folder / "scene"
    trusted = valid(base)
    found: dict[str, str] = {}
    ball = trimesh.creation.icosphere(1, 0.05)
    ball.export(folder / OUTSIDE)
    ball.export(base / "ball.stl")
    (base / "link.stl").symlink_to(folder / OUTSIDE)
    (base / "linked").symlink_to(folder)
    (base / "circle.stl").symlink_to(base / "circle.stl")
    for i, (name, text) in enumerate(SCENES.items()):
        path = base / f"scene{i}.toml"
        path.write_text(text)
        found[f"scene: {name}"] = f"scene {path}"
    for i, (name, content) in enumerate(MESH_FILES.items()):
        path = base / f"mesh{i}.{name.rsplit(' ', 1)[1]}"
        path.write_bytes(content)
        found[f"mesh: {name}"] = f"mesh {path}"
    for i, (name, content) in enumerate(POSES.items()):
        path = base / f"poses{i}.csv"
        path.write_bytes(content)
        found[f"poses: {name}"] = f"poses {path}"
    for kind, source in (("scene", "scene sphere"), ("mesh", "mesh obj"), ("calibration", "calibration c")):
        for name, path in special(_alone(folder / f"special {kind}", trusted[source])):
            found[f"{kind}: {name}"] = f"{kind} {path}"
    text = trusted["calibration c"].read_text()
    for name, new in {
        "digits": "0x" + "f" * 9000, "decimal": BIG * 2, "nan": "nan", "nested": "[" * 200_000, "huge": "1e9",
        "dotted": "1\n" + ".".join(["a"] * 400_000) + " = 1",
    }.items():  # fmt: skip
        path = base / f"{name}.toml"
        path.write_text(text.replace("fx = 800.0", f"fx = {new}", 1))
        found[f"calibration: {name}"] = f"calibration {path}"
    for name, path in _photographs(folder / "photographs", trusted):
        found[f"images: {name}"] = f"images {path}"
    return found


def _alone(folder: Path, path: Path) -> Path:
    folder.mkdir()
    (folder / path.name).write_bytes(path.read_bytes())
    return folder / path.name


def _photographs(folder: Path, trusted: dict[str, Path]) -> Iterator[tuple[str, Path]]:
    """Folders of photographs of which one is hostile."""
    folder.mkdir()
    (folder / "outside.png").write_bytes((trusted["images png"] / "1.png").read_bytes())
    sources = _alone(folder / "special", trusted["images png"] / "1.png")
    for name, path in special(sources):
        yield name, _spoiled(folder / name, lambda to, path=path: _move(path, to))
        yield (
            f"link to {name}",
            _spoiled(folder / f"to {name}", lambda to, name=name: _link(to, folder / name)),
        )
    progressive = cv2.imencode(".jpg", np.zeros((8000, 8000), np.uint8), [cv2.IMWRITE_JPEG_PROGRESSIVE, 1])[1]
    contents = {
        "bomb": png(60_000, 60_000, 1000),
        "bomb within limits, of another size": png(9000, 9000),
        "size of a lie": png(64, 2**31 - 1, 1),
        "half of it": png(64, 48, 20),
        "no size": png(0, 48),
        "only a header": png(64, 48)[:40] + b"IEND",
        "damaged": png(64, 48)[:45] + b"\xff\xff" + png(64, 48)[47:],
        "HDF5": b"\x89HDF\r\n\x1a\n",
        "TIFF": b"II*\0" + bytes(100),
        "GIF": b"GIF89a" + bytes(100),
        "SVG": b"<svg/>",
        "no end of segments": b"\xff\xd8" + b"\xff" * 5_000_000 + b"\xff\xd9",
        "many scans": _scans(progressive.tobytes(), 20_000),
        "appended": png(64, 48) + b"IEND" * 10,
    }
    for name, content in contents.items():
        yield name, _spoiled(folder / name, lambda to, content=content: to.write_bytes(content))
    for name in ("many scans",):  # all of one size, so that it is decoded
        for i in range(3):
            (folder / name / f"{i}.png").write_bytes(contents[name])
    linked = _spoiled(folder / "link", lambda to: to.unlink())
    (linked / "1.png").symlink_to(folder / "outside.png")
    yield "symbolic link to outside", linked
