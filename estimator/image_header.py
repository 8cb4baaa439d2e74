"""Size and depth of a PNG or JPEG image from the file's first bytes, without decoding it; and whether its end is there.

PNG: ISO/IEC 15948, 11.2.2 (IHDR) and 11.2.5 (IEND). JPEG: ITU-T T.81, annex B (SOF markers, EOI).
"""

import struct
from pathlib import Path
from typing import BinaryIO

from extremal.estimator.errors import InvalidInput
from extremal.estimator.reading import open_regular

MOST_SEGMENTS = 10_000  # of a JPEG before the picture, bytes of padding included
TAIL = 4096  # bytes from the end, among which the end of the image is looked for: some programs append notes


def image_header(path: Path) -> tuple[int, int, int]:
    """Width and height [px] and bits a channel.

    Raises:
        InvalidInput: a file that can't be read, is neither PNG nor JPEG, or is cut off.
    """
    try:
        with open_regular(path) as file:
            header = _png(file) or _jpeg(file)
    except (OSError, ValueError, struct.error):
        header = None
    if header is None or 0 in header:
        raise InvalidInput(
            f"{path.name} can't be read as an image; accepted: PNG and JPEG files that are whole"
        )
    return header


def _png(file: BinaryIO) -> tuple[int, int, int] | None:
    start = file.read(25)
    if start[:8] != b"\x89PNG\r\n\x1a\n" or start[12:16] != b"IHDR" or not _ends_with(file, b"IEND"):
        return None
    return struct.unpack(">IIB", start[16:25])


def _jpeg(file: BinaryIO) -> tuple[int, int, int] | None:
    """The frame header (marker SOFn) that follows other segments; each tells its own length."""
    file.seek(0)
    if file.read(2) != b"\xff\xd8" or not _ends_with(file, b"\xff\xd9"):
        return None
    file.seek(2)
    for _ in range(MOST_SEGMENTS):
        fill, code, length = struct.unpack(">BBH", file.read(4))
        if code == 0xFF:  # padding
            file.seek(-3, 1)
            continue
        if fill != 0xFF or code == 0xDA:  # the picture itself begins
            return None
        if 0xC0 <= code <= 0xCF and code not in (
            0xC4,
            0xC8,
            0xCC,
        ):  # not Huffman tables, extensions, conditioning
            bits, height, width = struct.unpack(">BHH", file.read(5))
            return width, height, bits
        file.seek(max(length, 2) - 2, 1)
    return None


def _ends_with(file: BinaryIO, mark: bytes) -> bool:
    size = file.seek(0, 2)
    file.seek(max(size - TAIL, 0))
    return mark in file.read()
