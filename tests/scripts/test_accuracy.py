"""The accuracy command: chosen studies, whole results, one line for bad input."""

import json
from pathlib import Path

import pytest

from extremal.estimator import InvalidInput
from extremal.scripts.accuracy import AccuracySettings, accuracy
from extremal.scripts.rendered_study import METHODS, MOTIONS, RenderedRow, rendered_study, rendered_table


def test_writes_the_chosen_studies(tmp_path: Path) -> None:
    accuracy(AccuracySettings(studies=("rays", "general"), trials=10, out=tmp_path / "out"))
    content = json.loads((tmp_path / "out" / "accuracy.json").read_text())
    assert list(content) == ["rays", "general"]
    assert all(value < 1e-6 for value in content["rays"].values())
    text = (tmp_path / "out" / "accuracy.md").read_text()
    assert "## rays" in text and "## general" in text and "| sphere |" in text


@pytest.mark.parametrize(
    ("settings", "part"),
    [
        (AccuracySettings(trials=0), "--trials is 0"),
        (AccuracySettings(seeds=-1), "--seeds is -1"),
        (AccuracySettings(scene="vase"), "'vase'"),
    ],
)
def test_bad_input_names_the_value(settings: AccuracySettings, part: str) -> None:
    with pytest.raises(Exception, match=part) as error:
        accuracy(settings)
    assert isinstance(error.value, InvalidInput | ValueError)


def test_the_rendered_table_has_a_row_for_everything() -> None:
    row = RenderedRow("motion", "joint", 1, 1.0, 10, 0.1, 0.1, 0.95, 1.0, 0.01, 0.1, 0.05, 0.95, 0.05)
    assert rendered_table([row]).count("\n") == 2


@pytest.mark.slow
def test_joint_beats_the_others_on_rendered_frames() -> None:
    """The requirement: |R error| at most 0.5 mm in the median, 1 mm and 1 mrad pose errors, 60 views over 800 mm at 1 m."""
    rows = rendered_study(vases=3, draws=3, first=300)
    assert len(rows) == len(MOTIONS) * len(METHODS)
    for motion in MOTIONS:
        circle, parallax, joint = (
            next(r for r in rows if (r.motion, r.method) == (motion, m))
            for m in ("N-view circle", "parallax", "joint")
        )
        assert joint.settled == 1 and joint.radius_error_mm < 0.5
        assert joint.radius_error_mm < parallax.radius_error_mm < circle.radius_error_mm
        assert joint.coverage > 0.75 and joint.fixed_coverage > 0.8
