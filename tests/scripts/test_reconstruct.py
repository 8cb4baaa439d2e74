"""`extremal reconstruct`: what it writes, what it refuses, and how near the truth it comes."""

import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from extremal.estimator import DegenerateGeometry, InvalidInput
from extremal.scenes import load_scene
from extremal.scripts.cli import main
from extremal.scripts.reconstruct import ReconstructSettings, alone, take_around
from extremal.sim.around import CircularMotion

SHAPES = {
    "vase": 'type = "lathe"\nprofile_z = [0.0, 0.03, 0.07, 0.115, 0.155, 0.18, 0.2]\n'
    "profile_r = [0.034, 0.0405, 0.0455, 0.0425, 0.0345, 0.0325, 0.036]",
    "superquadric": 'type = "superquadric"\na = 0.04\nb = 0.05\nc = 0.07\ne1 = 0.6\ne2 = 0.6\nposition = [0.0, 0.0, 0.07]',
    "valleys": 'type = "mesh"\nfile = "valleys.ply"\nposition = [0.0, 0.0, 0.07]',
    "mesh": 'type = "mesh"\nfile = "bumps.ply"\nposition = [0.0, 0.0, 0.07]',
}
HEAD = "target = [0.0, 0.0, 0.1]\n[[lights]]\ndirection = [0.75, 0.55, -0.65]\nambient = 0.3\n[[objects]]\ncolour = 0.3\n"


def scene_file(folder: Path, shape: str) -> str:
    """A scene with one object, as a user would write it."""
    ball = trimesh.creation.icosphere(5)
    around = np.arctan2(ball.vertices[:, 1], ball.vertices[:, 0])
    level = 1 - ball.vertices[:, 2] ** 2
    for name, lobes in (("bumps", 0.06), ("valleys", 0.15)):
        radius = 0.05 * (1 + lobes * np.sin(3 * around) * level**1.5 + 0.12 * np.cos(4 * ball.vertices[:, 2]))
        made = trimesh.Trimesh(ball.vertices * radius[:, None] * [1, 1, 1.3], ball.faces, process=False)
        made.export(folder / f"{name}.ply")
    (folder / f"{shape}.toml").write_text(HEAD + SHAPES[shape] + "\n")
    return str(folder / f"{shape}.toml")


def test_what_is_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out = tmp_path / "out"
    arguments = ["--scene", "ellipsoid", "--views", "12", "--resolution", "40", "--quality", "preview"]
    monkeypatch.setattr(sys, "argv", ["extremal", "reconstruct", *arguments, "--out", str(out)])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 0
    result = json.loads((out / "result.json").read_text())
    assert {"rms_m", "p95_m", "completeness", "visual_hull", "stereo", "timing_s", "seed"} <= set(result)
    assert 0 < result["rms_m"] < 0.5 * result["visual_hull"]["rms_m"]
    assert 0.5 < result["completeness"] <= 1
    mesh = trimesh.load_mesh(out / "surface.ply", process=False)
    sigma = mesh.metadata["_ply_raw"]["vertex"]["data"]["sigma"]
    assert mesh.is_watertight and len(sigma) == len(mesh.vertices) == result["vertices"]
    assert np.isfinite(sigma).mean() > 0.5 and np.all(sigma > 0)
    for kind in ("glb", "stl"):
        again = trimesh.load_mesh(out / f"surface.{kind}")
        assert len(again.faces) == len(mesh.faces)
        assert np.allclose(again.bounds, mesh.bounds, atol=1e-5)
    assert len(list((out / "frames").glob("*.png"))) == 12
    assert (out / "contours.png").stat().st_size and (out / "distances.png").stat().st_size
    assert 1e5 < (out / "report.html").stat().st_size < 6e6


@pytest.mark.slow
def test_views_that_are_far_apart_are_refused() -> None:
    settings = ReconstructSettings("ellipsoid", views=4, resolution=40, quality="preview")
    with pytest.raises(DegenerateGeometry, match="less than about 50 degrees"):
        take_around(alone(load_scene("ellipsoid")), settings, workers=1)


def test_settings_that_make_no_sense_are_refused() -> None:
    scene = alone(load_scene("ellipsoid"))
    for settings in (ReconstructSettings(seed=-1), ReconstructSettings(resolution=4)):
        with pytest.raises(InvalidInput, match=r"--(seed is -1|resolution is 4)"):
            take_around(scene, settings, workers=1)


def test_the_object_at_the_target_is_taken_alone() -> None:
    scene = load_scene("vase-and-box")
    assert [o.name for o in alone(scene).objects] == ["vase"]
    box = scene["box"].bounding_sphere[0]
    nearer = replace(scene, target=tuple(float(x) for x in box - [0.04, 0.0, 0.0]))
    assert [o.name for o in alone(nearer).objects] == ["box"]


@pytest.mark.parametrize("bad", [{"views": 2}, {"distance": -1.0}, {"elevation": 2.0}, {"irregularity": 0.5}])
def test_motions_that_make_no_sense_are_refused(bad: dict[str, float]) -> None:
    with pytest.raises(InvalidInput, match=next(iter(bad))):
        CircularMotion(**bad)  # pyright: ignore[reportArgumentType]


def test_circles_fixate_their_target() -> None:
    target = np.array([0.1, 0.2, 0.3])
    poses = CircularMotion(7, 0.5, 0.3).poses(target, np.random.default_rng(0))
    away = poses.translation - target
    assert np.allclose(np.linalg.norm(away, axis=1), 0.5)
    assert np.allclose(poses.rotation.as_matrix()[:, :, 2], -away / 0.5)
    turned = np.unwrap(np.arctan2(away[:, 1], away[:, 0]))
    assert np.all(np.diff(turned) > 0) and turned[-1] - turned[0] < 2 * np.pi


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scene", "ratio"),
    [
        *(("vase", 0.5), ("glossy-vase", 0.5), ("textured-vase", 0.5), ("waisted-vase", 0.25)),
        *(("ellipsoid", 0.5), ("superquadric", 0.5), ("mesh", 0.5)),
        ("valleys", 1.0),  # concave where no ray touches: contours can't show it
    ],
)
def test_whole_objects_from_36_views(scene: str, ratio: float, tmp_path: Path) -> None:
    name = scene_file(tmp_path, scene) if scene in SHAPES else scene
    settings = ReconstructSettings(name, seed=5)
    found = take_around(alone(load_scene(name)), settings)
    ours, hull = found.distances["contours"].summary(), found.distances["visual_hull"].summary()
    assert ours["rms_m"] < 3e-4
    assert ours["rms_m"] < ratio * hull["rms_m"]
    stereo = found.distances["stereo"].summary()
    assert stereo["rms_m"] is None or ours["rms_m"] < stereo["rms_m"]


@pytest.mark.slow
def test_a_surface_ends_where_the_image_cuts_the_object() -> None:
    scene = alone(load_scene("waisted-vase"))
    found = take_around(scene, ReconstructSettings(distance=0.3, quality="preview"))
    assert all(outline.cut for outline in found.surface.outlines)
    ours = found.distances["contours"].summary()
    assert ours["rms_m"] < 3e-4 and ours["completeness"] < 0.7
    seen = found.surface.mesh.vertices[found.surface.observed]
    assert np.ptp(seen[:, 2]) < 0.19
