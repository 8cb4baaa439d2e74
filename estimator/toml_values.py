"""Values of TOML files, each checked as it is taken: errors name the key and what is accepted."""

from collections.abc import Callable
from typing import Any, TypeVar

from extremal.estimator.errors import InvalidInput
from extremal.estimator.reading import shown

V = TypeVar("V")
Reader = Callable[[Any, str], V]  # of a value and the name of its place

_NEEDED: Any = object()


class Table:
    """A TOML table that is emptied key by key, so that what is left over is unknown."""

    def __init__(self, values: Any, where: str = "the file") -> None:
        """Raises InvalidInput for what is no table; `where` names its place."""
        if not isinstance(values, dict):
            raise InvalidInput(f"{where} is {shown(values)}; accepted: a table")
        self.values, self.where, self.known = dict(values), where, []

    def take(self, key: str, read: Reader[V], default: V = _NEEDED) -> V:
        """The value of a key; without a default, InvalidInput where it is missing."""
        self.known.append(key)
        if key not in self.values:
            if default is _NEEDED:
                raise InvalidInput(f"{self.where} lacks the key {key!r}")
            return default
        return read(self.values.pop(key), key if self.where == "the file" else f"{self.where}.{key}")

    def tables(self, key: str, most: int) -> list["Table"]:
        """Up to `most` tables of an array, which may be missing."""

        def read(values: Any, where: str) -> list[Table]:
            return [Table(item, f"{where}[{i}]") for i, item in enumerate(items(most)(values, where))]

        return self.take(key, read, [])

    def done(self) -> None:
        """InvalidInput if a key is left that is not known."""
        if self.values:
            raise InvalidInput(
                f"{self.where} has the unknown key {next(iter(self.values))!r:.60}; accepted: {', '.join(self.known)}"
            )


def number(largest: float) -> Reader[float]:
    """A number of up to this size; no NaN."""

    def read(value: Any, where: str) -> float:
        is_number = isinstance(value, int | float) and not isinstance(value, bool)
        if not is_number or not abs(value) <= largest:  # NaN compares false
            raise InvalidInput(f"{where} is {shown(value)}; accepted: a number within +-{largest:g}")
        return float(value)

    return read


def integer(value: Any, where: str) -> int:
    """A whole number of 64 bits."""
    if not isinstance(value, int) or isinstance(value, bool) or abs(value) >= 2**63:
        raise InvalidInput(f"{where} is {shown(value)}; accepted: a whole number")
    return value


def text(value: Any, where: str) -> str:
    """A short text in one line."""
    if not isinstance(value, str) or not 1 <= len(value) <= 200 or not value.isprintable():
        raise InvalidInput(f"{where} is {shown(value)}; accepted: a short text")
    return value


def items(most: int) -> Reader[list[Any]]:
    """A list of up to `most` items."""

    def read(value: Any, where: str) -> list[Any]:
        if not isinstance(value, list):
            raise InvalidInput(f"{where} is {shown(value)}; accepted: a list")
        if len(value) > most:
            raise InvalidInput(f"{where} has {len(value)} items; accepted: up to {most}")
        return value

    return read


def numbers(largest: float, most: int, count: int | None = None) -> Reader[tuple[float, ...]]:
    """A list of up to `most` numbers, or of as many as `count`."""
    one, some = number(largest), items(most)

    def read(value: Any, where: str) -> tuple[float, ...]:
        found = tuple(one(item, f"{where}[{i}]") for i, item in enumerate(some(value, where)))
        if count is not None and len(found) != count:
            raise InvalidInput(f"{where} has {len(found)} numbers; accepted: {count}")
        return found

    return read
