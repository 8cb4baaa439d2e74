"""Every error that extremal raises on purpose, and a check that often comes before one."""

from numbers import Integral


class ExtremalError(Exception):
    """Base of all errors; the message names the bad value and what is accepted."""


class InvalidInput(ExtremalError, ValueError):
    """A value that is out of range, not finite, or of the wrong shape."""


class DegenerateGeometry(ExtremalError, ValueError):
    """Views or rays that do not determine what was asked for."""


class NotConverged(ExtremalError, RuntimeError):
    """An estimate that did not settle, so that no uncertainty could be stood for."""


class SceneError(ExtremalError, ValueError):
    """A scene that is unknown, unreadable or impossible."""


class RenderingError(ExtremalError, RuntimeError):
    """Offscreen rendering is not available or failed."""


def is_whole(value: object) -> bool:
    """Whether an argument is a whole number, of Python or numpy; True and False are none."""
    return isinstance(value, Integral) and not isinstance(value, bool)
