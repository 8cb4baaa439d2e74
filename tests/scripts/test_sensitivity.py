"""`extremal sensitivity` against the book's figures; the limit of discrimination against its own Monte Carlo."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from extremal.estimator import ExtremalError
from extremal.scripts.book_setting import BookSetting
from extremal.scripts.discrimination_study import (
    BOOK_LIMITS,
    BOOTSTRAPPED,
    METHODS,
    POWER,
    THRESHOLD,
    Errors,
    absolute,
    book_errors,
    limit_row,
    limit_table,
    one_reference,
    reference_row,
    references,
)
from extremal.scripts.sensitivity import (
    BOOK,
    SensitivitySettings,
    edge_figure,
    position_figure,
    rotation_figure,
    sensitivity,
)

SETTING = BookSetting.with_vase(0.045, 0.012, 0.5)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("sensitivity") / "out"
    sensitivity(SensitivitySettings(out=out))
    return out


def test_slopes_are_those_of_the_book(folder: Path) -> None:
    content = json.loads((folder / "sensitivity.json").read_text())
    for name, unit in (("position", "mm"), ("rotation", "mrad")):
        slopes, book = content[f"{name}_percent_per_{unit}"], BOOK[name]
        assert set(slopes) == {"absolute", "parallax", "joint"}
        assert 1 / 1.5 < slopes["absolute"] / book["absolute"] < 1.5
        assert slopes["parallax"] <= book["parallax"]
        assert 0 < slopes["joint"] < 0.25 * slopes["parallax"]
    assert 50 < content["radius_mm_per_px"] < 80
    assert content["geometry"]["rotation"] == pytest.approx(0.2, rel=0.01)
    assert [row["view"] for row in content["views"]] == [0, 1, 2]
    last = content["views"][2]
    assert last["rotation_percent_per_mrad"][0] == content["rotation_percent_per_mrad"]["absolute"]
    assert last["position_along_travel_percent_per_mm"] == [
        pytest.approx(content["position_percent_per_mm"][m], rel=1e-9) for m in ("absolute", "parallax")
    ]


@pytest.mark.slow
def test_the_tables_show_all_slopes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    sensitivity(SensitivitySettings(out=tmp_path / "out"))
    shown = capsys.readouterr().out
    assert all(
        part in shown for part in ("% of R per mm", "155, 19", "100, 12", "mm per px", "224 / 11.4", "64.1")
    )


def test_slopes_by_hand() -> None:
    """A support moves R by 1 / (2 - 2 cos(angle)) at the ends of the arc; a rotation moves it by the distance."""
    angle = np.arctan(0.05 / 0.5)
    gain = 1 / (2 - 2 * np.cos(angle)) / 45 * 100  # [% per mm]
    distance = 0.5 / np.cos(angle)
    position, rotation = position_figure(SETTING).curves[0], rotation_figure(SETTING).curves[0]
    assert position.slope / 45 * 100 == pytest.approx(gain, rel=0.02)
    assert rotation.slope / 45 * 100 == pytest.approx(gain * distance, rel=0.04)


def test_figures_are_png(folder: Path) -> None:
    assert {p.name for p in folder.iterdir()} == {
        "report.html",
        "sensitivity.json",
        "edge.png",
        "position.png",
        "rotation.png",
    }
    for path in folder.glob("*.png"):
        assert path.read_bytes().startswith(b"\x89PNG")
        picture = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        assert picture is not None and picture.max() - picture.min() > 100


def test_curves_touch_their_tangents() -> None:
    for figure in (edge_figure(SETTING), position_figure(SETTING), rotation_figure(SETTING)):
        for curve in figure.curves:
            middle = len(figure.errors) // 2
            assert figure.errors[middle] == 0
            assert curve.radius[middle] == pytest.approx(45, abs=1e-3)
            slope = np.gradient(curve.radius, figure.errors)[middle]
            assert slope == pytest.approx(curve.slope, rel=2e-3)
            tangent = curve.radius[middle] + curve.slope * figure.errors
            span = np.ptp(tangent)
            assert np.abs(curve.radius - tangent).max() < 0.04 * span


def test_edges_reach_the_epipolar_section_only() -> None:
    """The vase stands upright on the plane: edge errors along the contour and poses out of the plane do nothing."""
    found = SETTING.sensitivity()
    scale = np.abs(found.pose).max()
    np.testing.assert_allclose(found.image[..., 1], 0, atol=1e-12)
    np.testing.assert_allclose(found.pose[..., [1, 3, 5]], 0, atol=1e-12 * scale)


@pytest.mark.parametrize(
    ("changed", "parts"),
    [
        ({"radius": 0.0}, ("--radius", "0")),
        ({"radius": float("nan")}, ("--radius", "nan")),
        ({"distance": -1.0}, ("--distance", "-1")),
        ({"radius": 0.3}, ("--distance", "0.6")),
        ({"marking": 0.0}, ("--marking", "0.00", "accepted")),
        ({"marking": float("nan")}, ("--marking", "nan")),
        ({"marking": 0.2}, ("--marking", "0.2")),
    ],
)
def test_bad_input_is_refused(changed: dict[str, float], parts: tuple[str, ...], tmp_path: Path) -> None:
    with pytest.raises(ExtremalError) as refusal:
        sensitivity(SensitivitySettings(**changed, out=tmp_path / "out"))
    assert all(part in str(refusal.value) for part in parts) and "\n" not in str(refusal.value)
    assert not (tmp_path / "out").exists()


def test_the_errors_of_the_book() -> None:
    """They give the limits that the book reports, by the sigma that the estimates state themselves."""
    rng = np.random.default_rng(1)
    for method, limit in ((absolute, BOOK_LIMITS[0]), (one_reference, BOOK_LIMITS[1])):
        sigma = method(BookSetting(0.0, (-0.01186, -0.00159)), book_errors(), 200, rng)[1]
        assert THRESHOLD * np.median(sigma) == pytest.approx(limit, rel=0.01)


@pytest.mark.parametrize(
    ("name", "trials"),
    [
        ("absolute", 20000),
        ("1 reference", 20000),
        (BOOTSTRAPPED, 250),
        pytest.param("joint, 12 fixed points", 100, marks=pytest.mark.slow),
    ],
)
def test_the_limit_of_discrimination(name: str, trials: int) -> None:
    row = limit_row("robot", name, Errors(0.02, 2e-5, 4e-5), trials, np.random.default_rng(2))
    spread = np.sqrt(0.05 * 0.95 / trials)
    assert row.false_alarms == pytest.approx(0.05, abs=4 * spread)
    assert row.power == pytest.approx(0.95, abs=4 * np.sqrt(2) * spread)
    # a quantile's standard error at 95 % is 2.1 standard deviations / sqrt(n)
    assert row.limit_mm == pytest.approx(
        row.normal_limit_mm, abs=4 * 2.2 * row.sigma_mm / np.sqrt(trials) + 0.01
    )
    assert row.normal_limit_mm == pytest.approx((THRESHOLD + POWER) * row.sigma_mm)


def test_free_circles_are_exact_and_the_bootstrap_finds_the_fixed_points() -> None:
    exact = SETTING.circles_around(np.zeros(3), np.zeros((12, 3, 2)), np.zeros((3, 6)))
    np.testing.assert_allclose(exact.radius, [0.045, *np.zeros(12)], atol=1e-9)
    found = references(SETTING, book_errors(), 50, np.random.default_rng(3))
    assert not any(trial.fixed[0] for trial in found)
    assert np.mean([trial.fixed[1:] for trial in found]) > 0.95


def test_the_sigma_that_references_leave_is_true_and_above_that_of_the_adjustment() -> None:
    errors, setting = book_errors(), BookSetting(0.02, (-0.01186, -0.00159))
    found = references(setting, errors, 400, np.random.default_rng(4))
    normalised = np.array([(trial.radius[0] - 0.02) / trial.sigma_radius[0] for trial in found])
    assert np.mean(normalised**2) == pytest.approx(1, abs=4 * np.sqrt(2 / 400))
    # which is told of the 12 fixed points, and uses both their coordinates
    assert np.median([trial.sigma_radius[0] for trial in found]) > 0.99 * float(
        np.median(METHODS["joint, 12 fixed points"](setting, errors, 20, np.random.default_rng(5))[1])
    )


def test_poor_edges_leave_no_reference_and_the_absolute_estimate() -> None:
    setting, errors = BookSetting(0.04, (-0.01186, -0.00159)), Errors(0.1, 2e-5, 4e-5)
    row = reference_row("robot", setting, errors, 50, np.random.default_rng(6))
    assert (row.with_references, row.references, row.false_references) == (0, 0, 0)
    assert "| 0.0% | 0 | 0.0% |" in limit_table([row])
    sigma = [
        np.median(m(setting, errors, 50, np.random.default_rng(7))[1])
        for m in (METHODS[BOOTSTRAPPED], absolute)
    ]
    assert sigma[0] == pytest.approx(sigma[1], rel=0.02)


def test_a_line_for_every_row() -> None:
    row = limit_row("robot", "absolute", Errors(0.02, 2e-5, 4e-5), 50, np.random.default_rng(0))
    lines = limit_table([row]).splitlines()
    assert len(lines) == 3 and lines[2].startswith("| robot | absolute | 0.02 | 0.04 | 0.02 |")
    assert set(METHODS) >= {"absolute", "1 reference"}
