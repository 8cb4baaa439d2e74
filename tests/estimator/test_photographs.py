"""Folders of photographs and tables of poses: read back as written, and one clear line for everything that is wrong."""

import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from extremal.estimator.errors import InvalidInput
from extremal.estimator.photographs import read_photographs, read_poses, write_poses

VIEWS = 4
NAMES = [f"view_{i}.png" for i in range(VIEWS)]
RNG = np.random.default_rng(1)
POSES = RigidTransform.from_components(
    RNG.uniform(-1, 1, (VIEWS, 3)), Rotation.from_rotvec(RNG.normal(size=(VIEWS, 3)))
)
IMAGES = [RNG.integers(0, 255, (48, 64), dtype=np.uint8) for _ in range(VIEWS)]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name, image in zip(NAMES, IMAGES, strict=True):
        assert cv2.imwrite(str(tmp_path / name), image)
    write_poses(tmp_path / "poses.csv", NAMES, POSES)
    return tmp_path


def message(folder: Path) -> str:
    """The error of reading the folder: one line."""
    with pytest.raises(InvalidInput) as error:
        read_photographs(folder, folder / "poses.csv")
    assert "\n" not in str(error.value) and "accepted" in str(error.value)
    return str(error.value)


def edit(folder: Path, line: int, old: str, new: str) -> None:
    path = folder / "poses.csv"
    lines = path.read_text().splitlines()
    assert old in lines[line]
    lines[line] = lines[line].replace(old, new, 1)
    path.write_text("\n".join(lines) + "\n")


def png(width: int, height: int, bits: int = 8) -> bytes:
    """A valid PNG of grey zeros, compressed: tiny, whatever its size."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    rows = zlib.compressobj(9)
    row = bytes(1 + width * bits // 8)
    data = b"".join(rows.compress(row) for _ in range(height)) + rows.flush()
    header = struct.pack(">IIBBBBB", width, height, bits, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", data) + chunk(b"IEND", b"")


def test_what_was_written_is_read(folder: Path) -> None:
    names, images, T_base_flange = read_photographs(folder, folder / "poses.csv")
    assert names == NAMES
    for image, expected in zip(images, IMAGES, strict=True):
        assert np.array_equal(image, expected)
    assert np.allclose(T_base_flange.as_matrix(), POSES.as_matrix(), rtol=0, atol=1e-15)
    assert np.array_equal(T_base_flange.translation, POSES.translation)


def test_rotation_vectors_any_order_of_columns_and_a_byte_order_mark(tmp_path: Path) -> None:
    numbers = np.hstack([POSES.rotation.as_rotvec(), POSES.translation])
    rows = [", ".join([*map(repr, row), name]) for row, name in zip(numbers.tolist(), NAMES, strict=True)]
    text = "\ufeffrx, ry, rz, x, y, z, image\r\n" + "\r\n".join(rows) + "\r\n\r\n"
    (tmp_path / "poses.csv").write_text(text, encoding="utf-8")
    names, T_base_flange = read_poses(tmp_path / "poses.csv")
    assert names == NAMES
    assert np.allclose(T_base_flange.as_matrix(), POSES.as_matrix(), rtol=0, atol=1e-14)


def test_colours_become_grey_and_jpeg_is_read(folder: Path) -> None:
    colour = np.zeros((48, 64, 3), np.uint8)
    colour[:, 32:] = 200
    cv2.imwrite(str(folder / NAMES[0]), colour)
    (folder / NAMES[1]).unlink()
    cv2.imwrite(str(folder / "view_1.JPG"), colour)
    edit(folder, 2, NAMES[1], "view_1.JPG")
    _, images, _ = read_photographs(folder, folder / "poses.csv")
    for image in images[:2]:
        assert image.shape == (48, 64) and abs(int(image[5, 60]) - 200) <= 1 and image[5, 3] <= 1


def test_a_noted_orientation_does_not_turn_the_image(folder: Path) -> None:
    """Exif orientation 6 (a quarter turn), as telephones write it: the sensor's pixels stay where they are."""
    _, data = cv2.imencode(".jpg", IMAGES[0])
    exif = b"Exif\0\0MM\0*\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0\x06\0\0\0\0\0\0"
    segment = b"\xff\xe1" + struct.pack(">H", len(exif) + 2) + exif
    (folder / NAMES[0]).write_bytes(data.tobytes()[:2] + segment + data.tobytes()[2:])
    _, images, _ = read_photographs(folder, folder / "poses.csv")
    assert images[0].shape == (48, 64)


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("view_1.png,", "view_1.png,ten,", "line 3: 9 values; accepted: 8"),
        ("view_1.png", "view_0.png", "'view_0.png' has a row already, line 2"),
        ("view_1.png", "view_9.png", "row for 'view_9.png', which is no image"),
        (repr(float(POSES.translation[1, 0])), "nan", "line 3: x is 'nan'"),
        (repr(float(POSES.translation[1, 0])), "left", "line 3: x is 'left'"),
        (repr(float(POSES.translation[1, 0])), "350.2", "x is '350.2'; accepted: a number within +-10 m"),
        (
            repr(POSES.rotation[1].as_quat().tolist()[3]),
            "1.5",
            "line 3: the quaternion qx, qy, qz, qw has the norm",
        ),
    ],
)
def test_bad_rows(folder: Path, old: str, new: str, expected: str) -> None:
    edit(folder, 2, old, new)
    assert expected in message(folder)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", "is empty"),
        ("image,x,y,z,qx,qy,qz\n", "the header is 'image,x,y,z,qx,qy,qz'"),
        ("image;x;y;z;rx;ry;rz\n", "the header is 'image;x;y;z;rx;ry;rz'"),
        ("image,x,y,z,rx,ry,rz\nview_0.png,0,0,0,0,0,0\n", "has 1 rows of poses; accepted: 3 to"),
        ('image,x,y,z,rx,ry,rz\n"view_0.png,0,0,0,0,0,0\n', "can't be read"),
    ],
)
def test_bad_tables(folder: Path, text: str, expected: str) -> None:
    (folder / "poses.csv").write_text(text)
    assert expected in message(folder)


def test_bytes_that_are_no_text(folder: Path) -> None:
    (folder / "poses.csv").write_bytes(b"\xff\xfe\x00image")
    assert "can't be read" in message(folder)


def test_missing_files(tmp_path: Path) -> None:
    with pytest.raises(InvalidInput, match="there is no folder"):
        read_photographs(tmp_path / "none", tmp_path / "poses.csv")
    with pytest.raises(InvalidInput, match="there is no table of poses"):
        read_photographs(tmp_path, tmp_path / "poses.csv")


def test_an_image_without_a_row_and_a_row_without_an_image(folder: Path) -> None:
    cv2.imwrite(str(folder / "more.png"), IMAGES[0])
    assert "no row for the image 'more.png'; " in message(folder)
    cv2.imwrite(str(folder / "most.png"), IMAGES[0])
    assert "no row for the image 'more.png' and 1 more; " in message(folder)
    for name in ("more.png", "most.png", NAMES[2]):
        (folder / name).unlink()
    assert f"row for '{NAMES[2]}', which is no image" in message(folder)


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (b"", "can't be read as an image"),
        (b"hello", "can't be read as an image"),
        (b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR", "can't be read as an image"),
        (b"\xff\xd8\xff\xe0", "can't be read as an image"),
        (b"\xff\xd8\xff\xe0\0\x10" + bytes(14) + b"\xff\xd9", "can't be read as an image"),
        (png(64, 48)[:-5], "can't be read as an image"),
        (png(64, 48).replace(b"IDAT", b"IDaT"), "can't be decoded"),
        (png(0, 0), "can't be read as an image"),
        (png(64, 48, bits=16), "has 16 bits a channel; accepted: 8"),
        (png(65, 48), "has 65 x 48 pixels, view_0.png 64 x 48"),
    ],
)
def test_bad_images(folder: Path, content: bytes, expected: str, capfd: pytest.CaptureFixture[str]) -> None:
    (folder / NAMES[2]).write_bytes(content)
    text = message(folder)
    assert expected in text and NAMES[2] in text


def test_truncated_jpeg(folder: Path) -> None:
    """OpenCV fills what is missing with grey and says nothing."""
    (folder / NAMES[2]).unlink()
    _, data = cv2.imencode(".jpg", IMAGES[2])
    (folder / "view_2.jpg").write_bytes(data.tobytes()[: len(data) // 2])
    edit(folder, 3, NAMES[2], "view_2.jpg")
    assert "view_2.jpg can't be read as an image" in message(folder)


def test_a_small_file_of_a_huge_image_is_not_decoded(folder: Path) -> None:
    (folder / NAMES[0]).write_bytes(png(20_000, 20_000))
    assert "view_0.png has 20000 x 20000 pixels; accepted: up to 100 megapixels" in message(folder)


def test_header_of_every_kind_of_jpeg(tmp_path: Path) -> None:
    from extremal.estimator.image_header import image_header

    for i, progressive in enumerate((0, 1)):
        path = tmp_path / f"{i}.jpg"
        cv2.imwrite(str(path), IMAGES[0][:40], [cv2.IMWRITE_JPEG_PROGRESSIVE, progressive])
        assert image_header(path) == (64, 40, 8)
