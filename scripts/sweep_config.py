"""What a sweep's TOML file says, checked, and the trials that it makes."""

import hashlib
import os
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from itertools import product
from math import inf, isfinite
from pathlib import Path
from types import MappingProxyType, NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

import numpy as np

from extremal.estimator.errors import InvalidInput
from extremal.scripts.sweep_trials import KINDS, Kind, Trial, get_kind

SECTIONS = ("settings", "grid", "draw")
WHOLE = {"trials": 1, "seed": 0}  # by their defaults
MOST_TRIALS = 1_000_000
WORDS = {
    bool: "true or false",
    int: "a whole number",
    float: "a finite number",
    str: "a text",
    Path: "a path",
}
# by name: whether its numbers are accepted, how they are described, and how one is drawn
DISTRIBUTIONS: Mapping[str, tuple[Callable[[float, float], bool], str, Callable[..., Any]]] = (
    MappingProxyType(
        {
            "uniform": (
                lambda a, b: a < b,
                "[low, high], low < high",
                lambda rng, a, b: float(rng.uniform(a, b)),
            ),
            "log_uniform": (
                lambda a, b: 0 < a < b,
                "[low, high], 0 < low < high",
                lambda rng, a, b: float(np.exp(rng.uniform(np.log(a), np.log(b)))),
            ),
            "integer": (
                lambda a, b: a <= b and isinstance(a, int) and isinstance(b, int),
                "[first, last], whole numbers",
                lambda rng, a, b: int(rng.integers(a, b, endpoint=True)),
            ),
        }
    )
)


@dataclass(frozen=True)
class SweepConfig:
    """A sweep: its trials are every combination of the grid, `trials` times, each time with other draws.

    The draws of a repetition are the same in all combinations of the grid, and don't change when there are more.

    Attributes:
        kind: one of `KINDS`.
        settings: by name, the same in all trials.
        grid: values by name.
        draw: by name, the distribution's name and its numbers, or "choice" and the values.
        trials, seed: number of repetitions, and what draws and trials are derived from.
    """

    kind: str
    settings: Mapping[str, Any]
    grid: Mapping[str, Sequence[Any]]
    draw: Mapping[str, tuple[str, Sequence[Any]]]
    trials: int
    seed: int

    @property
    def names(self) -> list[str]:
        """All that is set."""
        return [*self.settings, *self.grid, *self.draw]

    @property
    def swept(self) -> list[str]:
        """What differs between trials."""
        return [*self.grid, *self.draw]

    def all_trials(self) -> list[Trial]:
        """The trials in order. Raises InvalidInput where one can't be: settings that don't go together."""
        kind = get_kind(self.kind)
        digests = _Digests(kind.FILES)
        return [self._trial(kind, digests, values, i) for values, i in self._combinations()]

    def _combinations(self) -> Iterator[tuple[dict[str, Any], int]]:
        drawn = [self._drawn(i) for i in range(self.trials)]
        for values in product(*self.grid.values()):
            for i, own in enumerate(drawn):
                yield {**self.settings, **dict(zip(self.grid, values, strict=True)), **own}, i

    def _drawn(self, repetition: int) -> dict[str, Any]:
        found = {}
        for name, (distribution, numbers) in self.draw.items():
            stream = int.from_bytes(hashlib.sha256(name.encode()).digest()[:8])
            rng = np.random.default_rng([self.seed, stream, repetition])
            if distribution == "choice":
                found[name] = numbers[int(rng.integers(len(numbers)))]
            else:
                found[name] = DISTRIBUTIONS[distribution][2](rng, *numbers)
        return found

    def _trial(self, kind: Kind, digests: "_Digests", values: dict[str, Any], repetition: int) -> Trial:
        try:
            kind.Settings(**values)
        except InvalidInput as error:
            shown = ", ".join(f"{name} = {values[name]!r}" for name in self.swept) or "the settings"
            raise InvalidInput(f"no trial can have {shown}: {error}") from None
        return Trial(self.kind, values, self.seed, repetition, digests.of(values))


def load_config(path: Path) -> SweepConfig:
    """Read and check a sweep's TOML file.

    Raises InvalidInput, one line, for a file that can't be read, unknown names, values of the wrong type, empty lists, and more
    than a million trials.
    """
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise InvalidInput(f"{path} can't be read: {error}; accepted: a TOML file") from None
    try:
        return read_config(content)
    except InvalidInput as error:
        raise InvalidInput(f"{path}: {error}") from None


def read_config(content: Mapping[str, Any]) -> SweepConfig:
    """Check what a sweep's TOML file holds; raises InvalidInput as `load_config` does."""
    _known(content, ("kind", *WHOLE, *SECTIONS), "the file")
    if not isinstance(content.get("kind"), str):
        raise InvalidInput(f"kind is {content.get('kind')!r}; accepted: {', '.join(KINDS)}")
    kind = get_kind(content["kind"])
    whole = {name: _natural(name, content.get(name, default)) for name, default in WHOLE.items()}
    sections = {name: content.get(name, {}) for name in SECTIONS}
    types = _types(kind)
    seen: set[str] = set()
    for section, values in sections.items():
        if not isinstance(values, Mapping):
            raise InvalidInput(f"{section} is {values!r}; accepted: a table [{section}]")
        _known(values, types, section)
        if twice := seen.intersection(values):
            raise InvalidInput(f"{min(twice)} is set twice; accepted: in one of {', '.join(SECTIONS)}")
        seen |= set(values)
    config = SweepConfig(
        content["kind"],
        {name: _checked(name, value, types[name]) for name, value in sections["settings"].items()},
        {name: _list(f"grid.{name}", value, types[name]) for name, value in sections["grid"].items()},
        {name: _distribution(name, value, types[name]) for name, value in sections["draw"].items()},
        **whole,
    )
    number = config.trials * np.prod([len(v) for v in config.grid.values()], dtype=float)
    if not 1 <= number <= MOST_TRIALS:
        raise InvalidInput(f"there are {number:g} trials; accepted: 1 to {MOST_TRIALS}")
    return config


def _known(values: Mapping[str, Any], accepted: Mapping[str, Any] | Sequence[str], where: str) -> None:
    for name in values:
        if name not in accepted:
            raise InvalidInput(f"{where} sets {name!r}; accepted: {', '.join(accepted)}")


def _natural(name: str, value: Any) -> int:
    if not isinstance(value, int) or isinstance(value, bool) or value < 0:
        raise InvalidInput(f"{name} is {value!r}; accepted: a whole number from 0")
    return value


def _types(kind: Kind) -> dict[str, Any]:
    """What may be set, by name, and the types of the values."""
    hints = get_type_hints(kind.Settings, include_extras=True)
    return {f.name: hints[f.name] for f in fields(kind.Settings) if f.init and f.name not in kind.WITHHELD}


def _checked(name: str, value: Any, kind: Any) -> Any:
    """A value as JSON holds it; whole numbers become floats where floats are expected."""
    for accepted in _alternatives(kind):
        if get_origin(accepted) is Literal:
            if isinstance(value, str) and value in get_args(accepted):
                return value
        elif accepted is float:
            if isinstance(value, int | float) and not isinstance(value, bool) and isfinite(value):
                return float(value)
        elif accepted is int:
            if isinstance(value, int) and not isinstance(value, bool) and abs(value) < 2**63:
                return value
        elif accepted in (str, Path):
            if isinstance(value, str):
                return value
        elif accepted is bool and isinstance(value, bool):
            return value
    raise InvalidInput(f"{name} is {value!r}; accepted: {_words(kind)}")


def _alternatives(kind: Any) -> list[Any]:
    """The types that a union holds, without None: TOML has none, and leaving a setting out says the same."""
    if get_origin(kind) is Annotated:
        return _alternatives(get_args(kind)[0])
    if get_origin(kind) in (Union, UnionType):
        return [each for part in get_args(kind) for each in _alternatives(part)]
    return [] if kind is NoneType else [kind]


def _words(kind: Any) -> str:
    words = []
    for each in _alternatives(kind):
        words += map(str, get_args(each)) if get_origin(each) is Literal else [WORDS[each]]
    return ", ".join(words)


def _list(name: str, values: Any, kind: Any) -> list[Any]:
    if not isinstance(values, list) or not values:
        raise InvalidInput(f"{name} is {values!r}; accepted: a list of one or more of: {_words(kind)}")
    checked = [_checked(name, value, kind) for value in values]
    if twice := [value for i, value in enumerate(checked) if value in checked[:i]]:
        raise InvalidInput(f"{name} holds {twice[0]!r} twice; accepted: different values")
    return checked


def _distribution(name: str, value: Any, kind: Any) -> tuple[str, Sequence[Any]]:
    accepted = "; or ".join(f"{{ {k} = {words} }}" for k, (_, words, _) in DISTRIBUTIONS.items())
    wrong = InvalidInput(f"draw.{name} is {value!r}; accepted: {accepted}; or {{ choice = [values] }}")
    if not isinstance(value, Mapping) or len(value) != 1:
        raise wrong
    [(distribution, numbers)] = value.items()
    if distribution == "choice":
        return distribution, _list(f"draw.{name}.choice", numbers, kind)
    if distribution not in DISTRIBUTIONS or not isinstance(numbers, list) or len(numbers) != 2:
        raise wrong
    if not all(isinstance(n, int | float) and not isinstance(n, bool) and -inf < n < inf for n in numbers):
        raise wrong
    if not DISTRIBUTIONS[distribution][0](*numbers):
        raise wrong
    _checked(f"draw.{name}", 1 if distribution == "integer" else 0.5, kind)  # whether such numbers fit at all
    return distribution, numbers


class _Digests:
    """SHA-256 of the files that settings name, each read once."""

    def __init__(self, names: Sequence[str]) -> None:
        self._names, self._found = names, dict[str, str]()

    def of(self, values: Mapping[str, Any]) -> dict[str, str]:
        return {name: self._digest(name, values[name]) for name in self._names if _is_file(values.get(name))}

    def _digest(self, name: str, path: str) -> str:
        if path not in self._found:
            try:
                self._found[path] = hashlib.sha256(Path(path).read_bytes()).hexdigest()
            except OSError as error:
                raise InvalidInput(f"{name} is {path!r}: {error}; accepted: a readable file") from None
        return self._found[path]


def _is_file(value: Any) -> bool:
    return isinstance(value, str) and os.path.isfile(value)
