"""The example that trains an agent runs, and its environment keeps Gymnasium's rules."""

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import pytest

EXAMPLE = Path(__file__).parents[2] / "docs" / "examples" / "ppo_inspect.py"


@pytest.fixture
def example(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    pytest.importorskip("stable_baselines3")
    spec = importlib.util.spec_from_file_location("ppo_inspect", EXAMPLE)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, "ppo_inspect", module)
    spec.loader.exec_module(module)
    return module


@pytest.mark.slow
@pytest.mark.filterwarnings("default")  # of the libraries
def test_it_trains_saves_and_compares(
    example: ModuleType, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from gymnasium.utils.env_checker import check_env

    env = example.decisions(3)
    check_env(env, skip_render_check=True)
    env.close()
    example.main(example.Settings(steps=256, workers=1, episodes=3, out=tmp_path))
    assert (tmp_path / "ppo_inspect.zip").stat().st_size > 1000
    assert "random: success" in capsys.readouterr().out
