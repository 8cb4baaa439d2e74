"""What is saved is what is loaded; every kind of bad file is one line that names it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from extremal.estimator import Camera, InvalidInput
from extremal.estimator.board import Board
from extremal.estimator.calibration import Calibration, Simulation
from extremal.estimator.calibration_file import load_calibration, save_calibration


def example() -> Calibration:
    rng = np.random.default_rng(0)
    half = rng.normal(size=(23, 23))
    turns = Rotation.random(2, rng)
    return Calibration(
        Camera(fx=801.25, fy=799.75, distortion=(-0.1, 0.05, 1e-4, -2e-4, 0.01), gamma=2.2),
        RigidTransform.from_components(rng.normal(size=3), turns[0]),
        RigidTransform.from_components(rng.normal(size=3), turns[1]),
        Board(),
        half @ half.T,
        (4e-5, 5e-5),
        0.0051,
        30,
        {"joint_offset_2": 1e-3, "link_a_2": -2e-4},
        Simulation("typical", 7, "industrial"),
    )


@pytest.mark.parametrize("simulated", [True, False])
def test_round_trip(tmp_path: Path, simulated: bool) -> None:
    saved = example() if simulated else replace(example(), simulation=None)
    save_calibration(saved, tmp_path / "c.toml")
    loaded = load_calibration(tmp_path / "c.toml")
    for name in ("camera", "board", "view_errors", "rms", "views", "arm", "simulation"):
        assert getattr(loaded, name) == getattr(saved, name)
    assert np.array_equal(loaded.covariance, saved.covariance)
    for name in ("T_flange_camera", "T_base_board"):
        assert np.allclose(getattr(loaded, name).as_matrix(), getattr(saved, name).as_matrix(), atol=1e-15)
    assert [p.name for p in tmp_path.iterdir()] == ["c.toml"]


@pytest.mark.parametrize(
    ("old", "new", "part"),
    [
        ("fx = 801.25", "fx = nan", "fx"),
        ("fx = 801.25", "fx = 'wide'", "fx"),
        ("fx = 801.25", "", "fx"),
        ("[board]", "[bored]", "bo"),
        ("views = 30", "views = 1", "views"),
        ("quaternion = [", "quaternion = [2.0, ", "quaternion"),
        ("gamma = 2.2", "gamma = 2.2\ncolour = 3", "colour"),
        ("[covariance]", "[covariance", "TOML"),
        ("format = 1", "format = 9", "format"),
    ],
)
def test_bad_files(tmp_path: Path, old: str, new: str, part: str) -> None:
    path = tmp_path / "c.toml"
    save_calibration(example(), path)
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(InvalidInput, match=part) as caught:
        load_calibration(path)
    assert "c.toml" in str(caught.value) and "\n" not in str(caught.value)


def test_a_missing_file(tmp_path: Path) -> None:
    with pytest.raises(InvalidInput, match=r"none\.toml"):
        load_calibration(tmp_path / "none.toml")
