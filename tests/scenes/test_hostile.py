"""Hostile files, through every loader, in processes that may be killed: one clear line, or a sound value; never harm."""

import collections
from pathlib import Path

import hostile_files
import hostile_fuzz
import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, given, settings
from killable import Outcome, outcomes

TARGET = "hostile:load"
# Large files: each is refused, or read within the limits, but takes seconds.
HEAVY = (
    "many materials obj", "long line", "polygon", "only vertices", "continued", "many faces", "unclosed stl", "endless header",
    "bomb", "many scans", "no end of segments", "many keys", "many numbers", "many objects", "unclosed text", "needle",
    "ratio", "poses: quote", "poses: wide", "poses: long", "many rows", "exponents",
)  # fmt: skip
# What looks hostile and is not: materials are not looked for; the last ones are unusual, and whole.
HARMLESS = {
    "mesh: materials obj", "mesh: materials from a device obj", "scene: tags in a name", "scene: needle", "scene: ratio",
    "calibration: huge", "images: appended",
}  # fmt: skip


def check(cases: dict[str, str]) -> None:
    found = dict(zip(cases, outcomes(TARGET, list(cases.values())), strict=True))
    wrong = {
        name: outcome for name, outcome in found.items() if outcome.verdict not in ("accepted", "refused")
    }
    assert not wrong
    assert {name for name, outcome in found.items() if outcome.verdict == "accepted"} == HARMLESS & set(cases)
    for name, outcome in found.items():
        assert len(outcome.message) < 600 and "\n" not in outcome.message, name
        if outcome.verdict == "refused":
            assert Path(outcome.case.split(" ", 1)[1]).name in outcome.message or "images" in name, name


def is_heavy(name: str) -> bool:
    return any(part in name for part in HEAVY)


def test_every_attack_is_refused_in_one_line(tmp_path: Path) -> None:
    cases = {name: case for name, case in hostile_files.attacks(tmp_path).items() if not is_heavy(name)}
    assert len(cases) > 100
    check(cases)


@pytest.mark.slow
def test_every_large_attack_is_refused_within_the_limits(tmp_path: Path) -> None:
    check({name: case for name, case in hostile_files.attacks(tmp_path).items() if is_heavy(name)})


def test_a_child_that_hangs_dies_or_eats_harms_nobody() -> None:
    cases = ["accept", "refuse", "sleep", "accept", "die", "eat", "nonsense", "refuse"]
    found = [outcome.verdict for outcome in outcomes("killable:misbehave", cases, seconds=3.0)]
    assert found == ["accepted", "refused", "hung", "accepted", "died", "escaped", "nonsense", "refused"]


def sound(found: list[Outcome]) -> None:
    """Every input was accepted or refused, and some were each."""
    wrong = [outcome for outcome in found if outcome.verdict not in ("accepted", "refused")]
    assert not wrong, (len(wrong), wrong[:5])
    counts = collections.Counter(outcome.verdict for outcome in found)
    assert min(counts["accepted"], counts["refused"]) > len(found) / 100, counts


@pytest.mark.slow
def test_9000_files_with_small_accidents(tmp_path: Path) -> None:
    valid = hostile_files.valid(tmp_path / "valid")
    rng = np.random.default_rng(1)
    (tmp_path / "fuzzed").mkdir()
    sound(outcomes(TARGET, list(hostile_fuzz.fuzzed(valid, tmp_path / "fuzzed", 9000, rng))))


@pytest.mark.slow
def test_1000_scenes_of_any_numbers(tmp_path: Path) -> None:
    cases: list[str] = []

    @settings(
        max_examples=1000, derandomize=True, database=None, phases=[Phase.generate], deadline=None,
        suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large],
    )  # fmt: skip
    @given(hostile_fuzz.scenes)
    def write(text: str) -> None:
        path = tmp_path / f"{len(cases)}.toml"
        path.write_text(text)
        cases.append(f"scene {path}")

    write()
    assert len(cases) >= 900  # there are no more different ones, where it is less
    sound(outcomes(TARGET, cases))
