"""The page on policies of one's own does what it says."""

import re
from importlib.metadata import EntryPoint, EntryPoints
from pathlib import Path

import numpy as np
import pytest

from extremal.estimator import InvalidInput
from extremal.tasks import plugins
from extremal.tasks.evaluation import Evaluation, run_episode
from extremal.tasks.policies.policy import GROUP, RandomPolicy, arguments_of, load_policy
from extremal.tasks.tiers import TRAIN_SEEDS

PAGE = Path(__file__).parents[2] / "docs" / "own_policy.md"
SEED = TRAIN_SEEDS[73_000]


@pytest.fixture
def modules(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The page's modules, where Python finds them."""
    monkeypatch.syspath_prepend(str(tmp_path))
    blocks = re.findall(
        r"```python\n# file: (\w+)\.py\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL
    )
    for name, code in blocks:
        (tmp_path / f"{name}.py").write_text(code)
    return [name for name, _ in blocks]


def registered(monkeypatch: pytest.MonkeyPatch, *points: tuple[str, str]) -> None:
    found = EntryPoints(EntryPoint(name, value, GROUP) for name, value in points)
    monkeypatch.setattr(plugins, "entry_points", lambda **which: found.select(**which))


def test_the_policy_of_the_page_inspects(modules: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    assert modules == ["my_policies", "my_estimator"]
    result = run_episode(Evaluation("Inspect", "my_policies:Sideways", 1), SEED)
    assert result["answered"] == 1 and result["steps"] == 21 and result["label_right"] == 1
    # by the short name that the page registers
    name, value = re.search(
        r'^(\w+) = "(my_policies:.*)"$', PAGE.read_text(encoding="utf-8"), re.MULTILINE
    ).groups()  # pyright: ignore[reportOptionalMemberAccess]
    registered(monkeypatch, (name, value))
    assert run_episode(Evaluation("Inspect", name, 1), SEED) == result
    with pytest.raises(InvalidInput, match=rf"accepted: random, .*blind, {name} \(entry points of the group"):
        Evaluation("Inspect", "clever", 1)


def test_the_estimator_of_the_page_sees_pictures(modules: list[str]) -> None:
    policy = load_policy("my_estimator:FromPictures", {})
    assert arguments_of(policy) == {"obs_mode": "both"}
    result = run_episode(Evaluation("Inspect", "my_estimator:FromPictures", 1), SEED)
    assert result["answered"] == 1 and np.isfinite(result["negative_log_likelihood"])


def test_what_cannot_be_had_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    registered(
        monkeypatch, ("gone", "nowhere:Policy"), ("twice", "builtins:dict"), ("twice", "builtins:list"),
        ("none", "builtins:dict"),
    )  # fmt: skip
    for name, message in (
        ("gone", "can't be imported: No module named 'nowhere'"),
        ("twice", "registered 2 times"),
        ("none", "one with reset and act"),
        (":Policy", "or module:Class"),
        ("builtins:", "can't be made"),
    ):
        with pytest.raises(InvalidInput, match=message):
            load_policy(name, {"random": RandomPolicy})
    own = RandomPolicy()
    own.arguments = {"tier": "ideal-calibration-v0"}  # pyright: ignore[reportAttributeAccessIssue]
    with pytest.raises(InvalidInput, match="'tier'; accepted: obs_mode, action_mode"):
        arguments_of(own)
