"""What other packages offer by entry points, found by its name."""

from importlib.metadata import entry_points
from typing import Any

from extremal.estimator.errors import InvalidInput


def offered(group: str) -> list[str]:
    """Names that installed packages have registered in an entry-point group."""
    return sorted({point.name for point in entry_points(group=group)})


def load(group: str, name: str) -> Any:
    """What is registered by a name in a group.

    Raises InvalidInput where it can't be imported, or two packages register different things by that name.
    """
    points = {point.value: point for point in entry_points(group=group, name=name)}
    if len(points) != 1:
        raise InvalidInput(
            f"{name!r} is registered {len(points)} times in {group}: {', '.join(points)}; accepted: once"
        )
    try:
        return next(iter(points.values())).load()
    except (ImportError, AttributeError) as error:
        raise InvalidInput(f"{name!r} of {group} can't be imported: {error}") from None
