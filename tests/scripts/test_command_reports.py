"""What the commands' reports say of a look, an episode, a calibration and an evaluation, and what goes to Rerun."""

import os
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
import trimesh
from rich.table import Table
from scipy.spatial.transform import RigidTransform, Rotation

from extremal.estimator import Camera, InvalidInput
from extremal.scripts.accuracy import AccuracySettings, accuracy
from extremal.scripts.episode_report import Look as Step
from extremal.scripts.episode_report import episode_report
from extremal.scripts.look_report import agreement, look_report
from extremal.scripts.radius_history import radius_histories
from extremal.scripts.rerun_recording import require_rerun, write_rerun
from extremal.scripts.sensitivity import SensitivitySettings, sensitivity
from extremal.scripts.surface_report import colours_of, surface_view, true_distance
from extremal.tasks.features import Features

if TYPE_CHECKING:
    from conftest import Taken

MAILABLE = 5_000_000  # bytes


def table() -> Table:
    found = Table(title="a table")
    found.add_column("name")
    found.add_row("vase")
    return found


def test_the_report_of_a_look(taken: "Taken", tmp_path: Path) -> None:
    report = look_report(taken.scene, "vase-and-box", 3, taken.look, table())
    report.save(tmp_path / "report.html")
    page = (tmp_path / "report.html").read_text()
    assert len(page) < MAILABLE
    median, _, known = agreement(taken.look.scored)
    for words in (
        f"{1e3 * median:.2f} mm",
        str(len(taken.look.scored.points)),
        "R over looks",
        "<dt>seed</dt><dd>3</dd>",
    ):
        assert words in page
    assert known > 100 and page.count('role="img"') == 3 and page.count("<iframe") == 1


def test_agreement_is_that_of_the_points(taken: "Taken") -> None:
    median, inside, known = agreement(taken.look.scored)
    points = [
        p for p in taken.look.scored.points if p["true_radius_m"] is not None and p["radius_m"] is not None
    ]
    off = [abs(p["radius_m"] - p["true_radius_m"]) for p in points]
    assert known == len(points)
    assert median == pytest.approx(
        np.median([o for o, p in zip(off, points, strict=True) if p["true_label"] == "extremal"])
    )
    within = [
        o < 1.96 * (np.inf if p["sigma_radius_m"] is None else p["sigma_radius_m"])
        for o, p in zip(off, points, strict=True)
    ]
    assert inside == pytest.approx(np.mean(within))


def test_what_is_known_of_a_radius_grows_over_looks(taken: "Taken") -> None:
    histories = radius_histories(taken.look.recording.views)
    assert {h.extremal for h in histories} == {True, False}
    for history in histories:
        assert history.looks[-1] == len(taken.look.recording.views)
        assert history.sigma[-1] < history.sigma[0] / 3
        assert (abs(history.radius[-1]) > 0.01) == history.extremal
        first = history.radius[0] - history.radius[-1]
        assert abs(first) < 4 * history.sigma[0]


def test_too_few_views_have_no_history(taken: "Taken") -> None:
    assert radius_histories(taken.look.recording.views[:2]) == []


def features(n: int, extremal: bool, sigma: float) -> Features:
    """Points of R = 50 mm."""
    eye, yes = np.tile(np.eye(3), (n, 1, 1)), np.ones(n, bool)
    known, count = np.full(n, sigma), np.arange(n)
    axis = np.tile([1.0, 0, 0], (n, 1))
    return Features(
        np.full(n, 0.05), known, np.full(n, np.nan), np.full(n, np.inf), np.zeros((n, 3)), 1e-6 * eye, axis, axis,
        yes & extremal, yes & False, count, np.zeros((n, 2)), yes, np.full(n, 5),
    )  # fmt: skip


def test_the_report_of_an_episode(taken: "Taken") -> None:
    picture = np.full((48, 128, 3), 90, np.uint8)
    poses = [RigidTransform.from_components([0.5, 0.05 * k, 0.1], Rotation.identity()) for k in range(3)]
    looks = [Step(pose, features(4, k > 0, 0.01 / (k + 1)), picture) for k, pose in enumerate(poses)]
    assert np.isnan(looks[0].best).all() and looks[2].best == pytest.approx((0.05, 0.01 / 3))
    settings = {"policy": "active", "seed": 5}
    page = episode_report("Navigate", taken.scene, Camera(), looks, table(), settings).html()
    assert len(page) < MAILABLE
    assert "extremal navigate" in page and "active, seed 5, 2 steps" in page and page.count('role="img"') == 2


def test_a_surface_is_coloured_by_its_distance_to_the_truth(taken: "Taken") -> None:
    vase = taken.scene["vase"]
    centre, radius = vase.bounding_sphere
    ball = trimesh.creation.icosphere(subdivisions=3, radius=radius)
    ball.apply_translation(centre)
    np.testing.assert_allclose(
        true_distance(taken.scene, np.array(ball.vertices)),
        np.min([np.abs(o.signed_distance(ball.vertices)) for o in taken.scene.objects], axis=0),
    )
    views = taken.look.recording.views
    poses = RigidTransform.concatenate([view.T_world_camera for view in views])
    sigma = np.full(len(ball.vertices), 1e-3)
    view, caption = surface_view(taken.scene, views[0].camera, poses, [v.image for v in views], ball, sigma)
    assert "mm and more" in caption and len(view.html()) < MAILABLE
    nothing = trimesh.Trimesh(np.zeros((0, 3)), np.zeros((0, 3), int), process=False)
    _, caption = surface_view(taken.scene, views[0].camera, poses, [], nothing, np.zeros(0))
    assert "none was found" in caption
    assert colours_of(np.array([0.0, 1.0, 9.0]), 1.0).tolist() == [
        [68, 1, 84],
        [253, 231, 36],
        [253, 231, 36],
    ]


@pytest.mark.slow
def test_commands_without_frames_write_reports_too(tmp_path: Path) -> None:
    accuracy(AccuracySettings(studies=("rays", "general"), trials=10, out=tmp_path / "accuracy"))
    page = (tmp_path / "accuracy" / "report.html").read_text()
    assert "<h2>rays</h2>" in page and "<h2>general</h2>" in page and "<td >sphere</td>" in page
    sensitivity(SensitivitySettings(out=tmp_path / "sensitivity"))
    assert (tmp_path / "sensitivity" / "report.html").read_text().count('role="img"') == 3


def test_rerun_is_asked_for_where_it_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("extremal.scripts.rerun_recording.find_spec", lambda name: None)
    with pytest.raises(InvalidInput, match="rerun-sdk"):
        require_rerun()


def sockets() -> int:
    """Number of sockets that this process has open."""
    links = [os.readlink(link) for link in Path("/proc/self/fd").iterdir() if link.is_symlink()]
    return sum(name.startswith("socket:") for name in links)


@pytest.mark.skipif(not Path("/proc/self/fd").exists(), reason="counts open sockets by /proc")
def test_a_recording_for_rerun(taken: "Taken", tmp_path: Path) -> None:
    pytest.importorskip("rerun", reason="the extra `rerun` is not installed")
    before = sockets()
    write_rerun(tmp_path / "look.rrd", taken.scene, taken.look)
    data = (tmp_path / "look.rrd").read_bytes()
    assert data[:3] == b"RRF" and 100_000 < len(data) < MAILABLE
    assert [p.name for p in tmp_path.iterdir()] == ["look.rrd"] and sockets() <= before
