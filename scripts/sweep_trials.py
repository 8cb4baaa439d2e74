"""Trials of a sweep: what one is, its key, and how it is run, by whichever process."""

import hashlib
import json
import math
import time
from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import cached_property
from importlib import import_module
from typing import Any, Protocol, cast

from extremal.estimator.errors import ExtremalError, InvalidInput

KINDS = (
    "look",
    "episode",
    "estimate",
)  # each the module `extremal.scripts.sweep_<kind>`, imported where it is used
OK = "ok"
Value = bool | int | float | str | None


class Kind(Protocol):
    """What the module of a kind offers.

    Attributes:
        Settings: frozen dataclass of everything that may be set; all fields have defaults, and those of `WITHHELD` are not set by
            sweeps. Its `__post_init__` may raise InvalidInput.
        FILES: those of the settings that may name a file.
    """

    Settings: type[Any]
    WITHHELD: tuple[str, ...]
    FILES: tuple[str, ...]

    def run(self, settings: Any, seed: int) -> Mapping[str, Value]:
        """Results by name. The same settings and seed give the same results."""
        ...


def get_kind(name: str) -> Kind:
    """A kind by its name; InvalidInput lists the names."""
    if name not in KINDS:
        raise InvalidInput(f"kind is {name!r}; accepted: {', '.join(KINDS)}")
    return cast(Kind, import_module(f"extremal.scripts.sweep_{name}"))


@dataclass(frozen=True)
class Trial:
    """One trial: what is set, and which repetition it is.

    Attributes:
        kind: one of `KINDS`.
        settings: by name, as JSON holds them; those that are left out have their defaults.
        seed, repetition: of the sweep; from 0.
        files: SHA-256 of the files that settings name.
    """

    kind: str
    settings: Mapping[str, Any]
    seed: int
    repetition: int
    files: Mapping[str, str]

    @cached_property
    def key(self) -> str:
        """SHA-256 of everything that the result depends on: JSON, names sorted, without settings that have their defaults."""
        defaults = {field.name: field.default for field in fields(get_kind(self.kind).Settings)}
        content = {
            "kind": self.kind,
            "settings": {k: v for k, v in self.settings.items() if v != defaults[k]},
            "seed": self.seed,
            "repetition": self.repetition,
            "files": dict(self.files),
        }
        return hashlib.sha256(_json(content)).hexdigest()

    @property
    def random_seed(self) -> int:
        """What all randomness of the trial comes from; below 2^60."""
        return int(self.key[:15], 16)


def run_trial(trial: Trial) -> bytes:
    """Run a trial. The result is JSON: how it went, what came out, and how long it took [s].

    Of an error that `extremal` raises on purpose the result tells (it would come again); another is raised.
    """
    kind, started = get_kind(trial.kind), time.perf_counter()
    try:
        found, status, message = kind.run(kind.Settings(**trial.settings), trial.random_seed), OK, ""
    except ExtremalError as error:
        found, status, message = {}, type(error).__name__, " ".join(str(error).split())
    content = {
        "key": trial.key,
        "status": status,
        "message": message,
        "result": {name: _finite(value) for name, value in found.items()},
        "seconds": round(time.perf_counter() - started, 4),
    }
    return _json(content)


def _finite(value: Value) -> Value:
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _json(content: Mapping[str, Any]) -> bytes:
    return json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False).encode()
