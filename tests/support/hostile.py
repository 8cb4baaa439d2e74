"""What every loader must make of a file: an error of its own, or a value that is sound. Used in child processes."""

from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from extremal.estimator.calibration_file import load_calibration, save_calibration
from extremal.estimator.photographs import read_photographs, read_poses
from extremal.scenes import Mesh, load_scene
from extremal.scenes.grids import Facets
from extremal.sim import scene_model

COARSE = Facets(32, 16, 1e-3, 1e-3)
EYE = (-1.1, 0.4, 0.7)  # from where a scene's edges are asked for


def load(case: str) -> None:
    """Read "kind path" of a kind in `READERS`; AssertionError where what is read is not sound."""
    kind, path = case.split(" ", 1)
    READERS[kind](Path(path))


def scene(path: Path) -> None:
    """All numbers of an accepted scene are finite, MuJoCo compiles it, and its edges are where rays touch surfaces."""
    found = load_scene(path)
    model = scene_model(found.to_spec(COARSE))
    for name in ("geom_pos", "geom_size", "mesh_vert", "mesh_normal", "light_dir"):
        assert np.all(np.isfinite(getattr(model, name))), name
    centre = np.array(EYE)
    if any(surface.signed_distance(centre) <= 1e-3 for surface in found.objects):
        return  # seen from within nothing has a contour
    for curve in found.true_edges(centre):
        assert np.all(np.isfinite(curve.points)), curve.name
        assert np.all(np.abs(np.linalg.norm(curve.normals, axis=1) - 1) < 1e-9), curve.name
        if curve.kind == "extremal" and not isinstance(found[curve.object], Mesh):
            ray = curve.points - centre
            across = np.sum(ray * curve.normals, axis=1) / np.linalg.norm(ray, axis=1)
            assert np.all(np.abs(across) < 1e-6), (curve.name, float(np.abs(across).max()))


def mesh(path: Path) -> None:
    """An accepted mesh is closed and finite, and holds its own centre or not, but tells."""
    found = Mesh.from_file(path)
    centre, radius = found.bounding_sphere
    assert np.all(np.isfinite(centre)) and 0 < radius < 1e3
    corners = np.asarray(found.vertices)[np.asarray(found.faces)]
    volume = np.sum(corners[:, 0] * np.cross(corners[:, 1], corners[:, 2])) / 6
    assert np.isfinite(volume) and volume > 0
    if len(found.faces) < 5000:
        assert np.isfinite(found.signed_distance(centre))
        assert np.all(np.isfinite(found.normals(corners[:5].mean(axis=1))))


def images(path: Path) -> None:
    """Accepted photographs are grey bytes of one size."""
    names, found, poses = read_photographs(path, path / "poses.csv")
    assert len(names) == len(found) == len(poses)
    for image in found:
        assert image.dtype == np.uint8 and image.ndim == 2 and image.shape == found[0].shape and image.size


def poses(path: Path) -> None:
    """Accepted poses are finite, near, and rotate."""
    names, found = read_poses(path)
    matrices = found.as_matrix()
    assert len(names) == len(set(names)) == len(matrices) >= 3
    assert np.all(np.abs(matrices[:, :3, 3]) <= 10)
    R = matrices[:, :3, :3]
    assert np.allclose(R @ np.swapaxes(R, 1, 2), np.eye(3), atol=1e-9)


def calibration(path: Path) -> None:
    """An accepted calibration has a covariance, and is the same when it is written and read again."""
    found = load_calibration(path)
    assert np.linalg.eigvalsh(found.covariance).min() >= -1e-6 * max(1, np.abs(found.covariance).max())
    assert np.all(np.isfinite(found.camera.project([[0.01, 0.02, 1.0]])))
    with TemporaryDirectory() as folder:
        save_calibration(found, Path(folder) / "again.toml")
        again = load_calibration(Path(folder) / "again.toml")
    assert np.array_equal(again.covariance, found.covariance) and again.camera == found.camera


READERS: dict[str, Callable[[Path], None]] = {
    "scene": scene,
    "mesh": mesh,
    "images": images,
    "poses": poses,
    "calibration": calibration,
}
