"""One look at a scene, shared by the tests of what comes out of it."""

from dataclasses import dataclass

import pytest

from extremal.scenes import Scene, load_scene
from extremal.scripts.look import Look, LookSettings, take_look


@dataclass(frozen=True, eq=False)
class Taken:
    """A scene and one look at it."""

    scene: Scene
    look: Look


@pytest.fixture(scope="session")
def taken() -> Taken:
    """The default look, in standard quality."""
    settings = LookSettings()
    scene = load_scene(settings.scene)
    return Taken(scene, take_look(scene, settings))
