"""The doctor's exact silhouette against Monte Carlo rays, and its verdict on this machine."""

import numpy as np
import pytest

from extremal.estimator import Camera
from extremal.estimator.errors import RenderingError
from extremal.scripts import doctor


def test_exact_silhouette_against_rays() -> None:
    """Count the rays of a fine grid that meet the sphere."""
    camera, centre, radius = Camera(), np.array([0.12, 0.05, 0.7]), 0.09
    area, middle, perimeter = doctor.exact_silhouette(camera, centre, radius)
    fine = 8
    u = (np.arange(camera.width * fine) + 0.5) / fine - 0.5
    v = (np.arange(camera.height * fine) + 0.5) / fine - 0.5
    x, y = (u - camera.cx) / camera.fx, (v[:, None] - camera.cy) / camera.fy
    along = (x * centre[0] + y * centre[1] + centre[2]) / np.sqrt(x**2 + y**2 + 1)
    hit = centre @ centre - along**2 < radius**2
    counted = hit.sum() / fine**2
    assert abs(counted - area) / perimeter < 0.002
    rows, columns = np.nonzero(hit)
    np.testing.assert_allclose([u[columns].mean(), v[rows].mean()], middle, atol=0.002)


def test_perimeter_of_a_central_sphere_is_a_circle() -> None:
    camera, radius, distance = Camera(), 0.1, 0.8
    area, middle, perimeter = doctor.exact_silhouette(camera, np.array([0, 0, distance]), radius)
    tangent = camera.fx * radius / np.sqrt(distance**2 - radius**2)
    np.testing.assert_allclose([area, perimeter], [np.pi * tangent**2, 2 * np.pi * tangent], rtol=1e-12)
    np.testing.assert_allclose(middle, [camera.cx, camera.cy], atol=1e-9)


def test_all_is_well(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(doctor, "SPEED_SECONDS", 0.05)
    doctor.doctor(doctor.DoctorSettings())
    screen = capsys.readouterr().out
    for part in ("mujoco", "egl" if "egl" in screen else "osmesa", "px", "frames per second", "all is well"):
        assert part in screen
    assert doctor.examine_silhouette().good


def test_missing_opengl_is_shown_and_raised(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail() -> None:
        raise RenderingError("type this")

    monkeypatch.setattr(doctor, "select_backend", fail)
    with pytest.raises(RenderingError, match="type this"):
        doctor.doctor(doctor.DoctorSettings())
    screen = capsys.readouterr().out
    assert "does not work" in screen and "all is well" not in screen


def test_a_wrong_silhouette_is_not_well(monkeypatch: pytest.MonkeyPatch) -> None:
    wrong = doctor.Silhouette(0.0, np.array([0.0, -0.02]))
    monkeypatch.setattr(doctor, "examine_silhouette", lambda: wrong)
    monkeypatch.setattr(doctor, "SPEED_SECONDS", 0.05)
    with pytest.raises(RenderingError, match="silhouettes wrong"):
        doctor.doctor(doctor.DoctorSettings())
