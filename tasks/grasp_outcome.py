"""What became of a grasp, and when it counts as one."""

from dataclasses import dataclass

LIFT, HOLD = 0.1, 1.0  # that make a success [m], [s]
MOST_MOVED = 0.005  # before the lift [m]
ROUNDING = 1e-9  # of sums of time steps [s]


@dataclass(frozen=True)
class GraspOutcome:
    """What became of a grasp.

    Attributes:
        sealed: the cup has sealed.
        lifted_m: how high the target's centre of mass is above where it stood [m].
        held_s: for how long without a break it has been held `LIFT` or higher [s].
        released: the cup has let go.
        moved_before_lift_m: farthest that the target's centre of mass was pushed before the lift [m].
        other_contact: the first touch of anything but the target's standing on the table, "a on b"; empty where none.
        largest_load: of `load_ratio` while sealed.
    """

    sealed: bool
    lifted_m: float
    held_s: float
    released: bool
    moved_before_lift_m: float
    other_contact: str
    largest_load: float

    @property
    def success(self) -> bool:
        """Sealed, lifted 100 mm, held 1 s, never released, moved at most 5 mm before the lift, nothing else touched."""
        kept = self.sealed and not self.released and not self.other_contact
        return kept and self.held_s >= HOLD - ROUNDING and self.moved_before_lift_m <= MOST_MOVED
