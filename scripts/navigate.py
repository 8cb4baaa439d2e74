"""`extremal navigate`: one episode, around a curved obstacle to a goal."""

from extremal.scripts.episode import EpisodeSettings, show_episode


def navigate(settings: EpisodeSettings) -> None:
    """Run one episode and show it."""
    show_episode("Navigate", settings)
