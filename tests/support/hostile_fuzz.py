"""Any number of files that differ a little from valid ones, and scenes of numbers that nobody would write."""

from collections.abc import Iterator
from pathlib import Path
from shutil import copytree

import numpy as np
from hypothesis import strategies as st

TOKENS = (
    "nan", "inf", "-inf", "-1", "0", "-0.0", "1e308", "1e-308", "1e400", "0.1", "100", "9" * 30, "0x7fffffff", "4294967295",
    "[", "]", "{", '"', "'", ".", ",", "=", "\n", "\0", "true", "\ufeff", "../", "/", "\\", "é",
)  # fmt: skip
SHARES = {"scene": 0.15, "mesh": 0.35, "images": 0.2, "poses": 0.15, "calibration": 0.15}


def mutated(content: bytes, rng: np.random.Generator) -> bytes:
    """The content after one or two small accidents."""
    data = bytearray(content)
    for _ in range(rng.integers(1, 3)):
        if not data:
            break
        i, j = sorted(rng.integers(0, len(data), 2).tolist())
        j = min(j, i + 64)
        digits = [k for k, c in enumerate(data[:100_000]) if 48 <= c < 58]
        match rng.integers(9):
            case 0:
                data[i] = int(rng.integers(256))
            case 1:
                data[i] ^= 1 << int(rng.integers(8))
            case 2:
                del data[i:j]
            case 3:
                data[i:i] = data[i:j]
            case 4:
                del data[i:]
            case 5 | 6 | 7 if digits:
                data[digits[rng.integers(len(digits))]] = 48 + int(rng.integers(10))
            case _:
                token = TOKENS[rng.integers(len(TOKENS))].encode()
                data[i : i + len(token) * int(rng.integers(2))] = token
    return bytes(data)


def fuzzed(valid: dict[str, Path], folder: Path, count: int, rng: np.random.Generator) -> Iterator[str]:
    """Write `count` mutated files, and tell each as "kind path"."""
    names = {kind: [name for name in valid if name.startswith(kind + " ")] for kind in SHARES}
    for i, kind in enumerate(rng.choice(list(SHARES), count, p=list(SHARES.values()))):
        source = valid[str(rng.choice(names[kind]))]
        path = folder / f"{i}{source.suffix}"
        if source.is_dir():
            copytree(source, path)
            damaged = sorted(path.iterdir())[rng.integers(4)]
            damaged.write_bytes(mutated(damaged.read_bytes(), rng))
        else:
            path.write_bytes(mutated(source.read_bytes(), rng))
        yield f"{kind} {path}"


_number = st.one_of(
    st.floats(),
    st.floats(-1, 1),
    st.floats(0.01, 0.3),
    st.sampled_from(
        [0.0, -0.0, 1e-4, 9.9e-5, 1e-9, 100.0, 1e4, 1e-320, 2**31, -1, 10**30, 0.2, 1.0, float("nan")]
    ),
)


def _numbers(least: int, most: int) -> st.SearchStrategy[list[float]]:
    return st.lists(_number, min_size=least, max_size=most)


def _text(value: object) -> str:
    if isinstance(value, list):
        return f"[{', '.join(map(_text, value))}]"
    return f'"{value}"' if isinstance(value, str) else repr(value)


def _object(kind: str, **keys: st.SearchStrategy[object]) -> st.SearchStrategy[str]:
    common = {
        "position": _numbers(3, 3), "rotation_deg": _numbers(3, 3), "colour": _number, "specular": _number,
        "shininess": _number,
    }  # fmt: skip
    table = st.fixed_dictionaries({"type": st.just(kind), **keys}, optional=common)
    return table.map(lambda t: "[[objects]]\n" + "".join(f"{k} = {_text(v)}\n" for k, v in t.items()))


_heights = st.lists(st.floats(1e-6, 0.2), min_size=1, max_size=6).map(lambda d: [0.0, *np.cumsum(d).tolist()])
_sound = st.floats(0.02, 0.2)
# Texts of scene files with one object.
scenes = st.one_of(
    _object("sphere", radius=_number),
    _object("ellipsoid", a=_number, b=_sound, c=_number),
    _object("superquadric", a=_number, b=_sound, c=_sound, e1=_number, e2=_number),
    _object("box", size=_numbers(3, 3)),
    _object("lathe", profile_z=_heights, profile_r=_numbers(2, 7)),
    _heights.flatmap(
        lambda z: _object(
            "lathe",
            profile_z=st.just(z),
            profile_r=st.lists(st.floats(1e-4, 0.3), min_size=len(z), max_size=len(z)),
        )
    ),
)
