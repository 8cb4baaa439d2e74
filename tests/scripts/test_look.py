"""`extremal look`: what it writes, what it refuses, and how near the truth it comes."""

import json
import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import pytest

from extremal.estimator import Shape, estimate_shape
from extremal.scenes import load_scene
from extremal.scripts.cli import main
from extremal.scripts.look import LookSettings
from extremal.scripts.scoring import Scored, score

if TYPE_CHECKING:
    from conftest import Taken

SCHEMA = json.loads((Path(__file__).parents[2] / "docs" / "result.schema.json").read_text())
TYPES: dict[str, Any] = {
    "boolean": bool,
    "object": dict,
    "array": list,
    "string": str,
    "integer": int,
    "number": (int, float),
    "null": type(None),
}
KEYWORDS = {
    *("$schema", "title", "type", "enum", "minimum", "required", "properties", "additionalProperties"),
    *("items", "minItems", "maxItems"),
}
VIEWS = 4
QUICK = ("--quality", "preview", "--views", str(VIEWS))
NOTHING_IN_SIGHT = """
target = [0.0, 0.0, 60.0]
[[lights]]
direction = [0.7, 0.5, -0.6]
[[objects]]
type = "sphere"
radius = 0.05
"""


def violations(value: Any, schema: dict[str, Any], where: str = "result") -> list[str]:
    """Where a value breaks a JSON schema; only the keywords that our schema uses are known."""
    assert set(schema) <= KEYWORDS, f"{where}: unknown keywords {set(schema) - KEYWORDS}"
    if "enum" in schema and not any(value == e and type(value) is type(e) for e in schema["enum"]):
        return [f"{where} is {value!r}"]
    if isinstance(value, bool):
        return [] if schema.get("type") == "boolean" else [f"{where} is {value!r}"]
    names = schema.get("type", list(TYPES))
    allowed = [names] if isinstance(names, str) else names
    if not any(isinstance(value, TYPES[name]) for name in allowed):
        return [f"{where} is {value!r}"]
    if isinstance(value, int | float):
        return [f"{where} is {value}"] if value < schema.get("minimum", -np.inf) else []
    if isinstance(value, list):
        found = [
            v for i, item in enumerate(value) for v in violations(item, schema["items"], f"{where}[{i}]")
        ]
        fits = schema.get("minItems", 0) <= len(value) <= schema.get("maxItems", np.inf)
        return found if fits else [*found, f"{where} has {len(value)} items"]
    if isinstance(value, dict):
        known = schema["properties"]
        assert schema["additionalProperties"] is False
        found = [f"{where}.{key} is missing" for key in schema["required"] if key not in value]
        found += [f"{where}.{key} is unknown" for key in value if key not in known]
        return found + [
            v for k in known if k in value for v in violations(value[k], known[k], f"{where}.{k}")
        ]
    return []


@dataclass(frozen=True)
class Done:
    """How a command ended."""

    status: int
    out: str
    err: str


Command = Callable[..., Done]


def process(folder: Path, *arguments: str, **environment: str) -> Done:
    """Run a quick `look` in a process of its own."""
    code = "from extremal.scripts.cli import main; main()"
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", code, "look", *QUICK, *arguments],
        cwd=folder,
        env=os.environ | environment,
        capture_output=True,
        text=True,
        check=False,
    )
    return Done(done.returncode, done.stdout, done.stderr)


@pytest.fixture
def here(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> Command:
    """Run a quick `look` as `process` does, but in this one, which has imported everything already."""

    def run(folder: Path, *arguments: str) -> Done:
        monkeypatch.chdir(folder)
        monkeypatch.setattr(sys, "argv", ["extremal", "look", *QUICK, *arguments])
        capfd.readouterr()
        with pytest.raises(SystemExit) as end:
            main()
        assert isinstance(end.value.code, int)
        captured = capfd.readouterr()
        return Done(end.value.code, captured.out, captured.err)

    return run


def read(folder: Path) -> dict[str, Any]:
    def refuse(text: str) -> None:
        raise AssertionError(f"{text} is no JSON")

    return json.loads((folder / "result.json").read_text(), parse_constant=refuse)


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder in which `look` wrote `first` with the seed 3."""
    folder = tmp_path_factory.mktemp("look")
    done = process(folder, "--out", "first", "--seed", "3")
    assert done.status == 0 and done.err == "", done.err
    assert "wrote first" in done.out
    return folder


def test_the_result_is_as_its_schema_says(written: Path) -> None:
    result = read(written / "first")
    assert violations(result, SCHEMA) == []
    assert result["seed"] == 3 and result["scene"] == LookSettings().scene
    own = {"arm": "ideal", "camera": "ideal", "noise": 2.0, "estimator": "circle"}
    assert result["settings"] == LookSettings(views=VIEWS, quality="preview").resolved() | own
    assert all(pose["error_m"] < 1e-9 and pose["sigma_m"] == 0 for pose in result["poses"])
    assert len(result["points"]) > 100


@pytest.mark.parametrize(
    ("spoil", "where"),
    [
        (lambda r: r.pop("seed"), "seed"),
        (lambda r: r.update(seed=-1), "seed"),
        (lambda r: r.update(seed=True), "seed"),
        (lambda r: r.update(extra=1), "extra"),
        (lambda r: r["settings"].update(views=2), "settings.views"),
        (lambda r: r["points"][4].update(label="limb"), "points[4].label"),
        (lambda r: r["points"][4].update(side=0), "points[4].side"),
        (lambda r: r["points"][4].update(pixel=[1.0]), "points[4].pixel"),
        (lambda r: r["points"][4].update(pixel=[1.0, None]), "points[4].pixel[1]"),
        (lambda r: r["points"][4].update(radius_m="0.1"), "points[4].radius_m"),
    ],
)
def test_the_schema_finds_what_is_wrong(
    written: Path, spoil: Callable[[dict[str, Any]], object], where: str
) -> None:
    result = read(written / "first")
    spoil(result)
    found = violations(result, SCHEMA)
    assert len(found) == 1 and found[0].startswith(f"result.{where} ")


def test_pictures_and_frames(written: Path) -> None:
    out = written / "first"
    assert sorted(p.name for p in out.iterdir()) == ["frames", "look.png", "report.html", "result.json"]
    frames = sorted((out / "frames").iterdir())
    assert [p.name for p in frames] == [f"{i:03d}.png" for i in range(VIEWS)]
    for path in frames:
        image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        assert image is not None and image.shape == (480, 640) and image.std() > 10
    picture = cv2.imread(str(out / "look.png"))
    assert picture is not None and min(picture.shape[:2]) > 300 and picture.std() > 10


def test_seeds_and_replacing_a_former_result(written: Path, here: Command) -> None:
    """The same seed gives the same points and frames, in another process too; another one replaces them."""
    first, second = written / "first", written / "second"
    for seed in (4, 3):
        assert here(written, "--out", "second", "--seed", str(seed)).status == 0
        assert sorted(p.name for p in written.iterdir()) == ["first", "second"]
        assert read(second)["seed"] == seed
        assert (read(first)["points"] == read(second)["points"]) == (seed == 3)
    for path in (first / "frames").iterdir():
        assert path.read_bytes() == (second / "frames" / path.name).read_bytes()


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Where bad commands run: scenes that can't be read, a file, someone's folder."""
    (tmp_path / "malformed.toml").write_text("target = [0.0,\n")
    (tmp_path / "far.toml").write_text(NOTHING_IN_SIGHT.replace("60.0", "3000.0"))
    (tmp_path / "file").write_text("something")
    (tmp_path / "foreign").mkdir()
    (tmp_path / "foreign" / "thesis.txt").write_text("years of work")
    return tmp_path


def content(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() if p.is_file() else b"" for p in folder.rglob("*")}


def assert_refused(folder: Path, done: Done, before: dict[str, bytes]) -> str:
    """One line, exit status 2, and nothing was written, removed or changed."""
    lines = done.err.splitlines()
    assert done.status == 2, done.err
    assert len(lines) == 1 and lines[0].startswith("extremal: error: "), done.err
    assert content(folder) == before
    return lines[0]


@pytest.mark.parametrize(
    ("arguments", "parts"),
    [
        (("--scene", "vase"), ("'vase'", "vase-and-box")),
        (("--scene", "absent.toml"), ("absent.toml",)),
        (("--scene", "malformed.toml"), ("malformed.toml", "TOML")),
        (("--scene", "far.toml"), ("far.toml", "target", "3000")),
        (("--distance", "0.05"), ("inside",)),
        (("--baseline", "0"), ("baseline", "0.0")),
        (("--baseline", "1e-6"), ("baseline", "1e-06")),
        (("--baseline", "nan"), ("baseline", "nan")),
        (("--distance", "inf"), ("distance", "inf")),
        (("--noise", "nan"), ("noise", "nan")),
        (("--position-error", "nan"), ("position", "nan")),
        (("--rotation-error", "-1"), ("rotation", "-1")),
        (("--views", "1"), ("views is 1",)),
        (("--views", "2"), ("views is 2",)),
        (("--seed", "-1"), ("seed", "-1")),
        (("--quality", "best"), ("'best'", "preview, standard, metrology")),
        (("--out", "file"), ("file",)),
        (("--out", "file/below"), ("file/below", "written")),
    ],
    ids=lambda value: " ".join(value) if value and value[0].startswith("--") else "",
)
def test_bad_input_is_one_line_and_leaves_nothing(
    folder: Path, here: Command, arguments: tuple[str, ...], parts: tuple[str, ...]
) -> None:
    before = content(folder)
    out = () if "--out" in arguments else ("--out", "result")
    line = assert_refused(folder, here(folder, *out, *arguments), before)
    for part in parts:
        assert part in line


@pytest.mark.parametrize(
    "arguments",
    [
        ("--scene", "malformed.toml", "--out", "result"),
        ("--out", "file/below"),
        ("--views", "2", "--out", "result"),
    ],
)
def test_processes_end_alike(folder: Path, arguments: tuple[str, ...]) -> None:
    before = content(folder)
    assert_refused(folder, process(folder, *arguments), before)


def test_missing_opengl_is_one_line_and_leaves_nothing(
    folder: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    hidden = tmp_path_factory.mktemp("libraries")
    (hidden / "libEGL.so.1").touch()  # can't be loaded, as if absent
    before = content(folder)
    done = process(folder, "--out", "result", MUJOCO_GL="egl", LD_LIBRARY_PATH=str(hidden))
    assert "egl" in assert_refused(folder, done, before)


def test_a_refusal_leaves_no_parent_folders(folder: Path, here: Command) -> None:
    before = content(folder)
    assert_refused(folder, here(folder, "--scene", "vase", "--out", "new/deeper/result"), before)


def test_what_else_lies_in_the_folder_is_left_alone(folder: Path, here: Command) -> None:
    (folder / "foreign" / "frames").mkdir()
    (folder / "foreign" / "frames" / "keep.png").write_text("mine")
    assert here(folder, "--scene", "sphere", "--out", "foreign").status == 0
    assert (folder / "foreign" / "thesis.txt").read_text() == "years of work"
    assert {p.name for p in (folder / "foreign").iterdir()} == {
        "thesis.txt",
        "report.html",
        "result.json",
        "look.png",
        "frames",
    }
    assert here(folder, "--scene", "sphere", "--out", "foreign", "--views", "4").status == 0
    names = {p.name for p in (folder / "foreign" / "frames").iterdir()}
    assert names == {"keep.png", "000.png", "001.png", "002.png", "003.png"}


def test_a_scene_without_anything_in_sight_has_no_points(folder: Path, here: Command) -> None:
    (folder / "empty.toml").write_text(NOTHING_IN_SIGHT)
    done = here(folder, "--scene", "empty.toml", "--out", "result")
    assert done.status == 0 and done.err == "", done.err
    result = read(folder / "result")
    assert result["points"] == [] and violations(result, SCHEMA) == []
    assert (folder / "result" / "look.png").exists()


# How near the truth: seeds are fixed, so bounds leave room for changes of the estimator, not for chance.


def errors(scored: Scored) -> np.ndarray:
    return scored.column("radius_m") - scored.column("true_radius_m")


def test_radii_are_near_the_truth(taken: "Taken") -> None:
    scored = taken.look.scored
    extremal = scored.column("true_label") == "extremal"
    assert extremal.sum() > 50
    assert np.median(np.abs(errors(scored))[extremal]) < 0.5e-3


def test_sigma_covers_the_errors(taken: "Taken") -> None:
    scored = taken.look.scored
    known = np.isfinite(scored.column("true_radius_m"))
    assert known.mean() > 0.95
    inside = np.abs(errors(scored)) < 1.96 * scored.column("sigma_radius_m")
    assert inside[known].mean() > 0.85


def test_labels_and_sides(taken: "Taken") -> None:
    scored = taken.look.scored
    label, truth = scored.column("label"), scored.column("true_label")
    found = (label == "extremal") & (truth == "extremal")
    assert found.sum() > 0.9 * (truth == "extremal").sum()
    np.testing.assert_array_equal(scored.column("side")[found], scored.column("true_side")[found])
    fixed = truth == "fixed"
    assert np.mean(label[fixed] == "extremal") < 0.12
    assert np.all(np.isnan(scored.column("side")[label == "fixed"]))


def test_positions_are_near_the_truth(taken: "Taken") -> None:
    scored = taken.look.scored
    off = np.linalg.norm(scored.column("position_m") - scored.column("true_position_m"), axis=1)
    extremal = scored.column("true_label") == "extremal"
    assert np.median(off[extremal]) < 1e-3


def test_the_estimator_gets_no_truth(taken: "Taken") -> None:
    """Views alone give the shape; with another scene's truth nothing but the truth of the points changes."""
    look = taken.look
    again = estimate_shape(look.recording.views)
    for name in (f.name for f in fields(Shape) if f.name != "T_world_camera"):
        np.testing.assert_array_equal(getattr(again, name), getattr(look.shape, name), name)
    other = score(look.shape, look.recording, load_scene("sphere")).points
    truth = {key for key in other[0] if key.startswith("true_")} | {"object"}
    assert len(truth) == 6

    def estimated(points: list[dict[str, Any]]) -> list[dict[str, Any]]:
        return [{k: v for k, v in p.items() if k not in truth} for p in points]

    assert estimated(other) == estimated(look.scored.points)
    assert other != look.scored.points
