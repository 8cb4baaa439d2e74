"""Scene files: the presets, and one clear line for every mistake."""

from pathlib import Path

import pytest
import trimesh

from extremal.estimator.errors import SceneError
from extremal.scenes import Mesh, load_scene
from extremal.scenes.loading import presets

SPHERE = '[[objects]]\ntype = "sphere"\nradius = 0.05\n'
LATHE = '[[objects]]\ntype = "lathe"\nprofile_z = [0.0, 0.1]\nprofile_r = [0.04, 0.04]\n'
PATCH = "[[objects.markings]]\nwidth_deg = 20\nbottom = 0.02\ntop = 0.04\ncolour = 0.9\n"


def test_presets_are_the_documented_ones() -> None:
    documented = ["ellipsoid", "glossy-vase", "sphere", "textured-vase", "vase-and-box", "waisted-vase"]
    assert presets() == documented
    for name in documented:
        scene = load_scene(name)
        assert scene.name == name
        assert scene["table"].T_world_object.translation[2] == pytest.approx(-0.015)


def test_users_file_reads_like_a_preset(tmp_path: Path) -> None:
    trimesh.creation.icosphere(2, 50).export(tmp_path / "ball.stl")
    (tmp_path / "mine.toml").write_text(
        SPHERE
        + LATHE
        + PATCH
        + '[[objects]]\ntype = "mesh"\nfile = "ball.stl"\nscale = 0.001\nposition = [0.2, 0, 0.05]\n'
        + '[[objects]]\ntype = "superquadric"\na = 0.1\nb = 0.1\nc = 0.1\ne1 = 0.5\ne2 = 0.8\n'
    )
    scene = load_scene(tmp_path / "mine.toml")
    assert [surface.name for surface in scene.objects] == ["sphere", "lathe", "mesh", "superquadric"]
    ball = scene["mesh"]
    assert isinstance(ball, Mesh)
    assert ball.signed_distance([0.2, 0, 0.05]) == pytest.approx(-0.05, rel=0.05)
    scene.to_spec().compile()


MISTAKES = {
    "malformed": ("x = ]", "malformed TOML.*line 1"),
    "unknown key": (SPHERE + "colur = 1", "unknown key 'colur'.*accepted: .*colour"),
    "unknown top key": ("lamps = 1", "unknown key 'lamps'"),
    "wrong type": (SPHERE.replace("0.05", '"big"'), r"objects\[0\].radius is 'big'"),
    "boolean": (SPHERE.replace("0.05", "true"), "radius is True"),
    "nan": (SPHERE.replace("0.05", "nan"), "radius is nan"),
    "inf": (SPHERE.replace("0.05", "inf"), "radius is inf"),
    "absurd": (SPHERE.replace("0.05", "1e9"), "radius is 1000000000.0"),
    "huge integer": (SPHERE.replace("0.05", "1" + "0" * 400), "radius is 1000"),
    "negative": (SPHERE.replace("0.05", "-0.05"), "-0.05.*accepted"),
    "zero": (SPHERE.replace("0.05", "0"), "accepted: a length"),
    "missing": ('[[objects]]\ntype = "sphere"', "lacks the key 'radius'"),
    "no objects": ("target = [0, 0, 0]", "0 objects"),
    "unknown kind": ('[[objects]]\ntype = "cone"', "'cone'; accepted: lathe, box"),
    "not a table": ("objects = 3", "accepted: a list"),
    "equal names": (SPHERE + SPHERE, "2 objects are called 'sphere'"),
    "slash": (SPHERE + 'name = "a/b"', "'a/b'"),
    "colour": (SPHERE + "colour = [1, 2, 3]", "accepted: four numbers from 0 to 1"),
    "light": ("[[lights]]\ndirection = [0, 0, 0]\n" + SPHERE, "not all zero"),
    "too many markings": (LATHE + PATCH * 10001, "10001 items"),
    "overlap": (LATHE + PATCH + PATCH, "overlap"),
    "marking above": (LATHE + PATCH.replace("0.04", "0.4"), "above the top"),
    "profile order": (LATHE.replace("[0.0, 0.1]", "[0.1, 0.0]"), "lathe: profile z"),
    "profile lengths": (LATHE.replace("[0.0, 0.1]", "[0.0, 0.1, 0.2]"), "accepted: 2 to 200"),
    "negative spline": (
        LATHE.replace("[0.0, 0.1]", "[0, 0.01, 0.1, 0.11]").replace("[0.04, 0.04]", "[0.1, 0.01, 0.01, 0.1]"),
        "stay positive",
    ),
    "mesh outside": ('[[objects]]\ntype = "mesh"\nfile = "../ball.stl"', "within the scene file's folder"),
    "mesh absolute": ('[[objects]]\ntype = "mesh"\nfile = "/etc/ball.stl"', "within the scene file's folder"),
    "mesh missing": ('[[objects]]\ntype = "mesh"\nfile = "no.stl"', "'no.stl' does not exist"),
    "mesh rubbish": ('[[objects]]\ntype = "mesh"\nfile = "bad.obj"', "bad.obj|closed|accepted"),
    "mesh format": ('[[objects]]\ntype = "mesh"\nfile = "bad.xml"', "accepted: .obj"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_mistake_is_told_in_one_line(mistake: str, tmp_path: Path) -> None:
    text, message = MISTAKES[mistake]
    path = tmp_path / "mine.toml"
    path.write_text(text)
    (tmp_path / "bad.obj").write_text("v 1 2\nf 1 2 9\n")
    with pytest.raises(SceneError, match=message) as caught:
        load_scene(path)
    assert "\n" not in str(caught.value)
    assert "mine.toml" in str(caught.value)
    assert len(str(caught.value)) < 400


def test_unknown_names_and_missing_files_are_told_apart(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match=r"unknown scene 'vse'; accepted: ellipsoid, .*vase-and-box"):
        load_scene("vse")
    with pytest.raises(SceneError, match="does not exist"):
        load_scene(tmp_path / "none.toml")
    (tmp_path / "folder.toml").mkdir()
    with pytest.raises(SceneError, match="does not exist"):
        load_scene(tmp_path / "folder.toml")
    (tmp_path / "latin.toml").write_bytes(b"name = '\xe9'")
    with pytest.raises(SceneError, match="cannot be read"):
        load_scene(tmp_path / "latin.toml")
    with pytest.raises(SceneError):
        load_scene("a\0b.toml")
