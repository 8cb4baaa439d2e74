"""A user's own data: photographs in a folder and a table of the robot's poses, T_base_flange of each (docs/calibration.md).

image,x,y,z,qx,qy,qz,qw        metres; unit quaternion, scalar last
image,x,y,z,rx,ry,rz           metres; rotation vector [rad], as the controllers of Universal Robots show it
"""

import csv
import math
import os
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from extremal.estimator.errors import InvalidInput
from extremal.estimator.image_header import image_header
from extremal.estimator.reading import read_bytes

QUATERNION = ("image", "x", "y", "z", "qx", "qy", "qz", "qw")
ROTATION_VECTOR = ("image", "x", "y", "z", "rx", "ry", "rz")
SUFFIXES = (".png", ".jpg", ".jpeg")
FEWEST_VIEWS = 3
MOST_VIEWS = 2000
MOST_PIXELS = 100_000_000  # of an image
MOST_PIXELS_TOGETHER = 3_000_000_000  # they are kept, a byte each
LARGEST_IMAGE = 400_000_000  # bytes
MOST_SCANS = 100  # of a progressive JPEG, each of which takes a pass over the whole image
LARGEST_TABLE = 1_000_000  # bytes
FARTHEST = 10.0  # [m] no arm reaches further: the numbers are millimetres
UNIT = 1e-3  # by how much a quaternion's norm may be off 1


def read_photographs(
    images: str | Path, poses: str | Path
) -> tuple[list[str], list[NDArray[np.uint8]], RigidTransform]:
    """Names, grey images (height, width) of one size, and T_base_flange (V), in the table's order.

    Args:
        images: folder of PNG or JPEG files, 8 bits a channel; colours become grey, an orientation noted in the file is
            ignored, as it would turn the camera.
        poses: CSV table with one row an image.

    Raises:
        InvalidInput: one line that says what is wrong with which file or row, and what is accepted.
    """
    folder, table = Path(images), Path(poses)
    if not folder.is_dir():
        raise InvalidInput(f"there is no folder {str(folder)!r} of images")
    names, T_base_flange = read_poses(table)
    found = sorted(item.name for item in folder.iterdir() if item.suffix.lower() in SUFFIXES)
    _check_names(names, found, folder, table)
    paths = [_within(folder, name) for name in names]
    size = _check_sizes(paths)
    return names, [_grey(path, size) for path in paths], T_base_flange


def read_poses(path: str | Path) -> tuple[list[str], RigidTransform]:
    """Names of images and T_base_flange (V) of a table; errors as `read_photographs`."""
    path = Path(path)
    rows = _rows(path)
    header = tuple(cell.strip() for cell in rows[0][1])
    columns = next((c for c in (QUATERNION, ROTATION_VECTOR) if sorted(c) == sorted(header)), None)
    if columns is None:
        raise InvalidInput(
            f"{path.name}: the header is {','.join(header)!r:.100}; accepted: {','.join(QUATERNION)} or {','.join(ROTATION_VECTOR)}"
        )
    order = [header.index(name) for name in columns]
    names: dict[str, int] = {}
    numbers = []
    for line, cells in rows[1:]:
        if len(cells) != len(columns):
            raise InvalidInput(
                f"{path.name}, line {line}: {len(cells)} values; accepted: {len(columns)}, as in the header"
            )
        name, *values = (cells[i].strip() for i in order)
        if not name.isprintable() or Path(name).name != name:
            raise InvalidInput(
                f"{path.name}, line {line}: image is {name!r:.100}; accepted: the name of a file, without its folder"
            )
        if name in names:
            raise InvalidInput(
                f"{path.name}, line {line}: image {name!r:.100} has a row already, line {names[name]}; accepted: one row an image"
            )
        names[name] = line
        numbers.append([_number(v, key, path, line) for v, key in zip(values, columns[1:], strict=True)])
    if not FEWEST_VIEWS <= len(names) <= MOST_VIEWS:
        raise InvalidInput(
            f"{path.name} has {len(names)} rows of poses; accepted: {FEWEST_VIEWS} to {MOST_VIEWS}"
        )
    rotations = _rotations(np.array(numbers)[:, 3:], path, list(names.values()))
    return list(names), RigidTransform.from_components(np.array(numbers)[:, :3], rotations)


def write_poses(path: str | Path, names: Sequence[str], T_base_flange: RigidTransform) -> None:
    """Write the table of quaternions that `read_poses` reads, in full precision."""
    with Path(path).open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(QUATERNION)
        numbers = np.hstack([T_base_flange.translation, T_base_flange.rotation.as_quat()]).tolist()
        writer.writerows([name, *map(repr, row)] for name, row in zip(names, numbers, strict=True))


def _rows(path: Path) -> list[tuple[int, list[str]]]:
    """Line numbers and cells of all rows that are not empty."""
    if not path.is_file():
        raise InvalidInput(f"there is no table of poses {str(path)!r}")
    content = read_bytes(path, LARGEST_TABLE)
    try:
        text = content.decode("utf-8-sig")
        reader = csv.reader(text.splitlines(), strict=True)
        rows = [(reader.line_num, cells) for cells in reader if any(cell.strip() for cell in cells)]
    except (UnicodeError, csv.Error) as error:
        raise InvalidInput(
            f"{path.name} can't be read: {' '.join(str(error).split()):.100}; accepted: a CSV table in UTF-8"
        ) from None
    if not rows:
        raise InvalidInput(
            f"{path.name} is empty; accepted: the header {','.join(QUATERNION)} and one row an image"
        )
    return rows


def _number(text: str, key: str, path: Path, line: int) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    largest, unit = {"q": (2.0, ""), "r": (100.0, "rad")}.get(key[0], (FARTHEST, "m"))
    if not abs(value) <= largest:
        raise InvalidInput(
            f"{path.name}, line {line}: {key} is {text!r:.40}; accepted: a number within +-{largest:g} {unit}".rstrip()
        )
    return value


def _rotations(numbers: NDArray[np.floating], path: Path, lines: list[int]) -> Rotation:
    if numbers.shape[1] == 3:
        return Rotation.from_rotvec(numbers)
    length = np.linalg.norm(numbers, axis=1)
    worst = int(np.argmax(np.abs(length - 1)))
    if not abs(length[worst] - 1) < UNIT:
        raise InvalidInput(
            f"{path.name}, line {lines[worst]}: the quaternion qx, qy, qz, qw has the norm {length[worst]:.4g}; accepted: 1 +- {UNIT}"
        )
    return Rotation.from_quat(numbers)


def _check_names(names: list[str], found: list[str], folder: Path, table: Path) -> None:
    lacking = [name for name in names if name not in set(found)]
    if lacking:
        raise InvalidInput(
            f"{table.name} has a row for {lacking[0]!r:.100}{_more(lacking)}, which is no image in {str(folder)!r}; accepted: "
            f"names of {', '.join(SUFFIXES)} files there"
        )
    unknown = [name for name in found if name not in set(names)]
    if unknown:
        raise InvalidInput(
            f"{table.name} has no row for the image {unknown[0]!r:.100}{_more(unknown)}; accepted: one row for each image in "
            f"{str(folder)!r}"
        )


def _more(names: list[str]) -> str:
    return f" and {len(names) - 1} more" if len(names) > 1 else ""


def _within(folder: Path, name: str) -> Path:
    path = Path(os.path.realpath(folder / name))  # unlike resolve(), of links in a circle too
    if not path.is_relative_to(os.path.realpath(folder)):
        raise InvalidInput(f"{name} links to a file elsewhere; accepted: files in {str(folder)!r}")
    return path


def _check_sizes(paths: list[Path]) -> tuple[int, int]:
    """Height and width of all, by the files' headers: decoding an image that is too large would take the memory first."""
    sizes = []
    for path in paths:
        width, height, bits = image_header(path)
        if width * height > MOST_PIXELS:
            raise InvalidInput(
                f"{path.name} has {width} x {height} pixels; accepted: up to {MOST_PIXELS // 10**6} megapixels"
            )
        if bits > 8:
            raise InvalidInput(f"{path.name} has {bits} bits a channel; accepted: 8")
        sizes.append((width, height))
        if sizes[-1] != sizes[0]:
            raise InvalidInput(
                f"{path.name} has {width} x {height} pixels, {paths[0].name} {sizes[0][0]} x {sizes[0][1]}; accepted: images of "
                "one size, from one camera"
            )
    if sizes[0][0] * sizes[0][1] * len(paths) > MOST_PIXELS_TOGETHER:
        raise InvalidInput(
            f"{len(paths)} images of {sizes[0][0]} x {sizes[0][1]} pixels; accepted: up to {MOST_PIXELS_TOGETHER // 10**6} "
            "megapixels together"
        )
    return sizes[0][::-1]


def _grey(path: Path, size: tuple[int, int]) -> NDArray[np.uint8]:
    flags = cv2.IMREAD_GRAYSCALE | cv2.IMREAD_IGNORE_ORIENTATION
    content = read_bytes(path, LARGEST_IMAGE)
    if content.startswith(b"\xff") and content.count(b"\xff\xda") > MOST_SCANS:
        raise InvalidInput(f"{path.name} has more than the accepted {MOST_SCANS} scans")
    try:
        image = cv2.imdecode(np.frombuffer(content, np.uint8), flags)
    except (MemoryError, cv2.error):
        image = None
    if image is None or image.shape != size:
        raise InvalidInput(f"{path.name} can't be decoded; accepted: PNG and JPEG files that are whole")
    return np.asarray(image, np.uint8)
