"""`extremal grasp`: one episode, lift a vase by the side that was not seen."""

from extremal.scripts.episode import EpisodeSettings, show_episode


def grasp(settings: EpisodeSettings) -> None:
    """Run one episode and show it."""
    show_episode("Grasp", settings)
