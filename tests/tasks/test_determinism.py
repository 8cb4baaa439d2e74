"""The same bytes every time: in new and used environments, in vectors, in other processes; for the locked versions, the committed ones."""

from functools import partial
from typing import Any

import fingerprint
import numpy as np
import pytest
import reference_estimates
from fingerprint import NAMES, PLAIN, SHORT, STEPS, Prints

REGENERATE = "where that is meant, regenerate: python tests/support/fingerprint.py --write"


def committed() -> dict[str, Any]:
    """The entry of the installed versions."""
    for entry in fingerprint.references():
        if entry["versions"] == fingerprint.installed():
            return entry
    pytest.skip(f"no prints are committed for {fingerprint.installed()}")


def check(found: dict[str, Prints]) -> None:
    """Frames are compared where the renderer is the same."""
    entry = committed()
    same_renderer = entry["opengl"] == fingerprint.opengl()
    for name, prints in found.items():
        for key, value in prints.items():
            if same_renderer or key.startswith("observations"):
                assert entry["prints"][name][key] == value, f"{key} of {name} have changed; {REGENERATE}"


@pytest.mark.slow
def test_short_episodes_have_the_committed_prints() -> None:
    check(fingerprint.elsewhere(NAMES, SHORT, PLAIN))


@pytest.mark.slow
def test_long_episodes_have_the_committed_prints() -> None:
    check(fingerprint.elsewhere(NAMES, STEPS, PLAIN))


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_an_episode_is_the_same_however_it_is_run(name: str) -> None:
    expected = fingerprint.fresh(name, STEPS)
    assert fingerprint.reused(name, STEPS) == expected
    assert fingerprint.elsewhere([name], STEPS)[name] == expected
    for mode in ("sync", "async"):
        assert fingerprint.vector(mode, name, STEPS) == expected
    assert fingerprint.fresh(name, SHORT, number=1) != fingerprint.fresh(name, SHORT)  # they tell seeds apart


def test_prints_notice_every_number() -> None:
    """Of observation, reward, end and frame, and the order of the steps."""
    observation = {"pose": np.zeros(7, np.float32), "rgb": np.zeros((2, 2, 3), np.uint8)}

    def of(*steps: tuple[dict[str, np.ndarray], float, bool]) -> Prints:
        return fingerprint.prints(iter(steps))

    step, nearly = (observation, 0.0, False), np.nextafter(np.zeros(7, np.float32), 1)
    others = [
        of(step, (observation | {"pose": nearly}, 0.0, False)),
        of((observation | {"pose": nearly}, 0.0, False), step),
        of(step, (observation | {"pose": np.zeros(7)}, 0.0, False)),
        of(step, (observation, np.nextafter(0, 1), False)),
        of(step, (observation, 0.0, True)),
        of(step, (observation | {"rgb": observation["rgb"] + np.uint8(1)}, 0.0, False)),
    ]
    found = [tuple(sorted(prints.items())) for prints in [of(step, step), *others]]
    assert len(set(found)) == len(found)


@pytest.mark.parametrize("problem", sorted(reference_estimates.PROBLEMS))
def test_estimates_hang_on_no_version(problem: str) -> None:
    expected = reference_estimates.references()[problem]
    close = partial(np.testing.assert_allclose, rtol=reference_estimates.RTOL, atol=reference_estimates.ATOL)
    found = reference_estimates.PROBLEMS[problem]()
    assert found.keys() == expected.keys()
    for name, values in found.items():
        assert np.isfinite(values).any() and np.any(values != 0)
        close(values, expected[name], err_msg=f"{problem}: {name}")
