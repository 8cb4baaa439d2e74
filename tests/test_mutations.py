"""Covariances halved on purpose: the tests that say that sigma is honest have to fail then, each of them."""

import importlib.util
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from extremal.estimator import adjustment, circle, second_order
from extremal.estimator.strip_arcs import Arcs
from extremal.scripts import general_study

HALF = 0.5
FOLDER = Path(__file__).parent / "estimator"

Mutation = Callable[[pytest.MonkeyPatch], None]


def module_of(name: str) -> ModuleType:
    """A module of tests, to call them."""
    spec = importlib.util.spec_from_file_location(f"mutated_{name}", FOLDER / f"{name}.py")
    assert spec and spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def halved(monkeypatch: pytest.MonkeyPatch, where: Any, name: str, change: Callable[[Any], Any]) -> None:
    """Pass what a function of a module or class returns through `change`."""
    original = getattr(where, name)
    monkeypatch.setattr(where, name, lambda *args, **kwargs: change(original(*args, **kwargs)))


def of_three_views(monkeypatch: pytest.MonkeyPatch) -> None:
    halved(monkeypatch, circle, "_propagated", lambda covariance: HALF * covariance)


def of_many_views(monkeypatch: pytest.MonkeyPatch) -> None:
    halved(monkeypatch, circle, "_least_squares", lambda found: (*found[:2], HALF * found[2]))


def of_sections(monkeypatch: pytest.MonkeyPatch) -> None:
    """All that the joint adjustment says of shapes."""

    def change(shapes: Any) -> Any:
        root = np.sqrt(HALF)
        return replace(
            shapes,
            covariance=HALF * shapes.covariance,
            sigma_radius=root * shapes.sigma_radius,
            own_variance=HALF * shapes.own_variance,
            shared=root * shapes.shared,
        )

    halved(monkeypatch, adjustment, "marginals", change)


def of_second_order(monkeypatch: pytest.MonkeyPatch) -> None:
    halved(
        monkeypatch, second_order, "fit_sections", lambda fit: replace(fit, covariance=HALF * fit.covariance)
    )


def of_arcs(monkeypatch: pytest.MonkeyPatch) -> None:
    halved(monkeypatch, Arcs, "points", lambda found: (found[0], HALF * found[1]))


CASES: list[tuple[Mutation, str, str, tuple[Any, ...]]] = [
    (of_three_views, "test_circle", "test_sigma_by_monte_carlo", (3, 0.1, 0.5)),
    (of_many_views, "test_circle", "test_sigma_by_monte_carlo", (15, 0.4, 0.6)),
    (of_sections, "test_adjustment", "test_sigma_is_the_bound", ()),
    (of_sections, "test_adjustment", "test_planar_errors_are_what_sigma_says", (120,)),
    (of_sections, "test_adjustment", "test_errors_in_space_are_what_sigma_says", (0, 60)),
    (of_second_order, "test_second_order", "test_sigma_is_honest", (general_study.random_ellipsoid,)),
    (of_arcs, "test_strip_arcs", "test_covariance_covers_the_errors", (1e-5, 0.0)),
    (of_arcs, "test_strip_arcs", "test_covariance_covers_the_errors", (1e-5, 2e-5)),
]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("mutation", "file", "test", "arguments"), CASES, ids=[f"{m.__name__}-{t}" for m, _, t, _ in CASES]
)
def test_a_halved_covariance_is_noticed(
    mutation: Mutation, file: str, test: str, arguments: tuple[Any, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The test that passes as it is fails with the covariance halved."""
    check = getattr(module_of(file), test)
    mutation(monkeypatch)
    with pytest.raises(AssertionError):
        check(*arguments)
