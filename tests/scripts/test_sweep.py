"""Sweeps: what a file may say, keys, going on, one table whatever runs the trials."""

import csv
import hashlib
import json
import re
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import binom

from extremal.estimator.errors import InvalidInput, NotConverged
from extremal.estimator.kept_files import keep_first
from extremal.scripts import sweep_estimate
from extremal.scripts.cli import main
from extremal.scripts.sweep import SweepSettings, TrialsFailed, sweep
from extremal.scripts.sweep_attempts import Outcome
from extremal.scripts.sweep_config import load_config, read_config
from extremal.scripts.sweep_ray import RayMissing
from extremal.scripts.sweep_report import ReportSettings, median_interval, report
from extremal.scripts.sweep_store import Store
from extremal.scripts.sweep_trials import Trial, run_trial

TINY = """
kind = "estimate"
trials = 3
[settings]
fixed_points = 4
[grid]
views = [3, 4]
[draw]
radius = { uniform = [0.02, 0.05] }
"""


def tiny(folder: Path, text: str = TINY) -> Path:
    path = folder / "sweep.toml"
    path.write_text(text)
    return path


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("kind = 3", ("kind is 3", "look, episode, estimate")),
        ("kind = 'stare'", ("'stare'", "look, episode, estimate")),
        ("trials = 3", ("kind is None",)),
        ("kind = 'estimate'\nworkers = 3", ("'workers'", "kind, trials, seed, settings, grid, draw")),
        ("kind = 'estimate'\ntrials = 0", ("0 trials", "1 to 1000000")),
        ("kind = 'estimate'\ntrials = 10000000", ("1e+07 trials",)),
        ("kind = 'estimate'\ntrials = -1", ("trials is -1",)),
        ("kind = 'estimate'\nseed = true", ("seed is True",)),
        ("kind = 'estimate'\ngrid = 3", ("grid is 3", "[grid]")),
        ("kind = 'estimate'\n[settings]\nveiws = 3", ("'veiws'", "views", "edge_error")),
        ("kind = 'estimate'\n[settings]\nviews = 3.5", ("views is 3.5", "a whole number")),
        ("kind = 'estimate'\n[settings]\nviews = true", ("views is True",)),
        ("kind = 'estimate'\n[settings]\nradius = nan", ("radius is nan", "a finite number")),
        ("kind = 'estimate'\n[settings]\nradius = '3'", ("radius is '3'",)),
        ("kind = 'estimate'\n[grid]\nviews = []", ("grid.views is []", "one or more")),
        ("kind = 'estimate'\n[grid]\nviews = 3", ("grid.views is 3", "a list")),
        ("kind = 'estimate'\n[grid]\nradius = [1, 1.0]", ("grid.radius", "twice")),
        ("kind = 'estimate'\n[settings]\nviews = 3\n[grid]\nviews = [3]", ("views is set twice",)),
        ("kind = 'estimate'\n[draw]\nradius = 3", ("draw.radius is 3", "uniform", "choice")),
        ("kind = 'estimate'\n[draw]\nradius = {normal = [0, 1]}", ("normal", "log_uniform")),
        ("kind = 'estimate'\n[draw]\nradius = {uniform = [2, 1]}", ("low < high",)),
        ("kind = 'estimate'\n[draw]\nradius = {uniform = [0, inf]}", ("low < high",)),
        ("kind = 'estimate'\n[draw]\nradius = {log_uniform = [0, 1]}", ("0 < low",)),
        ("kind = 'estimate'\n[draw]\nviews = {uniform = [3, 9]}", ("draw.views", "a whole number")),
        ("kind = 'estimate'\n[draw]\nviews = {integer = [3, 9.5]}", ("whole numbers",)),
        ("kind = 'estimate'\n[draw]\nradius = {choice = []}", ("draw.radius.choice", "one or more")),
        ("kind = 'episode'\n[settings]\nenv = 'Stare'", ("'Stare'", "Inspect, Navigate, Grasp")),
        ("kind = 'look'\n[settings]\nout = 'x'", ("'out'", "scene")),
        ("kind = ", ("can't be read", "a TOML file")),
    ],
)
def test_what_a_file_must_not_say(tmp_path: Path, text: str, parts: tuple[str, ...]) -> None:
    with pytest.raises(InvalidInput) as error:
        load_config(tiny(tmp_path, text))
    message = str(error.value)
    assert "\n" not in message and "accepted" in message
    for part in parts:
        assert part in message


def test_settings_that_dont_go_together_are_told_before_anything_runs() -> None:
    for settings, part in (({"radius": 0.9}, "twice the radius"), ({"views": 2}, "views is 2")):
        with pytest.raises(InvalidInput, match=part):
            read_config({"kind": "estimate", "settings": settings}).all_trials()
    with pytest.raises(InvalidInput, match="tier = 'no'"):
        read_config({"kind": "episode", "grid": {"tier": ["no"]}}).all_trials()


def test_a_missing_file_is_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["extremal", "sweep", "no-such.toml"])
    with pytest.raises(SystemExit) as end:
        main()
    assert end.value.code == 2 and "no-such.toml can't be read" in capsys.readouterr().err


def test_a_key_is_the_digest_of_what_is_set() -> None:
    trial = Trial("estimate", {"views": 7, "radius": 0.03, "focal": 800.0}, 5, 2, {})
    text = '{"files":{},"kind":"estimate","repetition":2,"seed":5,"settings":{"radius":0.03,"views":7}}'
    assert trial.key == hashlib.sha256(text.encode()).hexdigest()  # focal has its default
    assert trial.random_seed == int(trial.key, 16) >> (4 * 49)
    others = [replace(trial, repetition=3), replace(trial, seed=6), replace(trial, settings={"views": 8})]
    assert len({t.key for t in [trial, *others]}) == 4


def test_keys_dont_depend_on_how_it_is_said() -> None:
    one = {"kind": "estimate", "settings": {"distance": 1, "views": 7}, "grid": {"baseline": [0.2]}}
    two = {
        "kind": "estimate",
        "settings": {"baseline": 0.2, "fixed_points": 12},
        "grid": {"views": [7], "distance": [1.0]},
    }
    assert [t.key for t in read_config(one).all_trials()] == [t.key for t in read_config(two).all_trials()]


def test_the_content_of_a_scene_is_part_of_the_key(tmp_path: Path) -> None:
    scene = tmp_path / "scene.toml"
    keys = []
    for text in ("a = 1", "a = 2"):
        scene.write_text(text)
        config = read_config({"kind": "look", "settings": {"scene": str(scene)}})
        keys.append(config.all_trials()[0].key)
    assert keys[0] != keys[1]


def test_draws_stay_when_there_are_more_and_are_the_same_all_over_the_grid() -> None:
    draw = {"radius": {"uniform": [0.02, 0.05]}, "edge_error": {"log_uniform": [0.01, 1]}}
    more = {"fixed_points": {"integer": [3, 5]}, "baseline": {"choice": [0.2, 0.4]}}

    def drawn(trials: int, draw: dict[str, Any]) -> list[dict[str, Any]]:
        config = read_config({"kind": "estimate", "trials": trials, "grid": {"views": [5, 9]}, "draw": draw})
        return [dict(trial.settings) for trial in config.all_trials()]

    few, many = drawn(2, draw), drawn(400, draw | more)
    for name in draw:
        assert [t[name] for t in few] == [many[i][name] for i in (0, 1, 400, 401)]
        assert [t[name] for t in many[:400]] == [t[name] for t in many[400:]]
    radius, edge = (np.array([t[name] for t in many[:400]]) for name in draw)
    assert np.all((radius >= 0.02) & (radius <= 0.05)) and np.all((edge >= 0.01) & (edge <= 1))
    below = int(np.sum(edge < 0.1))  # half of them: four standard deviations are 40
    assert abs(below - 200) < 40 and abs(int(np.sum(radius < 0.035)) - 200) < 40
    assert {t["fixed_points"] for t in many} == {3, 4, 5} and {t["baseline"] for t in many} == {0.2, 0.4}


def test_one_table_however_it_was_made(tmp_path: Path) -> None:
    """One worker; two workers that go on where the folder was left; and the digest by its definition."""
    config, one, two = tiny(tmp_path), tmp_path / "one", tmp_path / "two"
    sweep(SweepSettings(config, workers=1, out=one))
    kept = sorted((one / "trials").iterdir())
    assert len(kept) == 6
    (two / "trials").mkdir(parents=True)
    for path in kept[:3]:
        (two / "trials" / path.name).write_bytes(path.read_bytes().replace(b'"seconds":', b'"seconds":1'))
    sweep(SweepSettings(config, workers=2, out=two))
    assert all(b'"seconds":1' in (two / "trials" / path.name).read_bytes() for path in kept[:3])
    assert (one / "digest.txt").read_text() == (two / "digest.txt").read_text()
    with (one / "results.csv").open(newline="") as file:
        head, *rows = list(csv.reader(file))
    assert head[:5] == ["key", "fixed_points", "views", "radius", "repetition"] and head[-1] == "seconds"
    lines = sorted(",".join(row[:-1]) + "\n" for row in rows)  # no cell of it has a comma
    assert (one / "digest.txt").read_text().strip() == hashlib.sha256("".join(lines).encode()).hexdigest()
    assert {row[0] for row in rows} == {path.stem for path in kept} and {row[5] for row in rows} == {"ok"}
    report(ReportSettings(one))
    page = (one / "report.html").read_text()
    assert page.count("<svg") == 8 and "joint_covered by views" in page  # four results by two settings


def test_a_parquet_file_holds_the_same(tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    trials = read_config({"kind": "estimate", "trials": 2}).all_trials()
    store = Store(tmp_path)
    for i, trial in enumerate(trials):
        content = {
            "status": "ok",
            "message": "",
            "result": {"a": 0.5 * i, "b": None, "c": True},
            "seconds": 1.0,
        }
        store.keep(trial, json.dumps(content).encode())
    rows = store.merge(trials, [], {})
    assert parquet.read_table(tmp_path / "results.parquet").to_pylist() == rows


def test_what_has_no_estimate_is_a_row_and_what_is_broken_is_an_error(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    trial = Trial("estimate", {}, 0, 0, {})
    for error in (NotConverged("not\nsettled"), ZeroDivisionError()):

        def run(settings: object, seed: int, error: Exception = error) -> dict[str, float]:
            raise error

        monkeypatch.setattr(sweep_estimate, "run", run)
        if isinstance(error, NotConverged):
            found = json.loads(run_trial(trial))
            assert (found["status"], found["message"], found["result"]) == ("NotConverged", "not settled", {})
        else:
            with pytest.raises(ZeroDivisionError):
                run_trial(trial)


def test_what_was_given_up_is_reported_and_tried_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def engine(run: Any, prepare: Any, jobs: Iterator[Trial], *_: Any) -> Iterator[Outcome[Trial]]:
        for i, job in enumerate(jobs):
            yield Outcome(job, None, "killed by SIGKILL") if i == 1 else Outcome(job, run_trial(job))

    monkeypatch.setattr("extremal.scripts.sweep.run_locally", engine)
    settings = SweepSettings(tiny(tmp_path), out=tmp_path / "out")
    with pytest.raises(TrialsFailed, match=r"1 of 6 trials have no result; .*SIGKILL.*quarantined\.json"):
        sweep(settings)
    [listed] = json.loads((tmp_path / "out/quarantined.json").read_text())
    assert listed["reason"] == "killed by SIGKILL" and listed["repetition"] == 1
    with (tmp_path / "out/results.csv").open(newline="") as file:
        rows = {row["key"]: row for row in csv.DictReader(file)}
    assert len(rows) == 6 and rows[listed["key"]]["status"] == "quarantined"
    sweep(settings)  # one job is left, the first of its run
    assert not (tmp_path / "out/quarantined.json").exists()


def test_a_folder_of_another_version_is_refused(tmp_path: Path) -> None:
    (tmp_path / "sweep.json").write_text('{"version": "0.0.1"}')
    with pytest.raises(InvalidInput, match=r"0\.0\.1.*a new folder"):
        Store(tmp_path)
    (tmp_path / "file").touch()
    with pytest.raises(InvalidInput, match="can't be written"):
        Store(tmp_path / "file")


def test_of_two_writers_the_first_wins(tmp_path: Path) -> None:
    assert keep_first(tmp_path / "a", b"one") and not keep_first(tmp_path / "a", b"two")
    assert (tmp_path / "a").read_bytes() == b"one" and len(list(tmp_path.iterdir())) == 1


def test_without_ray_one_line_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(RayMissing, match=re.escape("pip install 'extremal[cluster]'")):
        sweep(SweepSettings(tiny(tmp_path), engine="ray", out=tmp_path / "out"))


@pytest.mark.parametrize("n", [1, 5, 6, 17, 100, 1001])
def test_the_interval_of_a_median_covers_it_as_often_as_it_says(n: int) -> None:
    """Order statistics r and n + 1 - r enclose the median unless fewer than r values, or all but fewer than r, are below it."""
    low, high = median_interval(np.arange(1, n + 1, dtype=float))
    if not np.isfinite(low):
        assert n <= 5 and high == np.inf
        return
    assert low + high == n + 1
    assert 2 * binom.cdf(low - 1, n, 0.5) <= 0.05 < 2 * binom.cdf(low, n, 0.5)


def test_a_report_of_nothing_is_one_line(tmp_path: Path) -> None:
    for text in ("", "a,b\n1,2\n", "key,repetition,status,message,seconds\n1,2\n"):
        (tmp_path / "results.csv").write_text(text)
        with pytest.raises(InvalidInput, match="no table of a sweep"):
            report(ReportSettings(tmp_path))
    with pytest.raises(InvalidInput, match="a sweep that has ended"):
        report(ReportSettings(tmp_path / "missing"))
