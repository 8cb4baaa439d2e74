"""MuJoCo's warnings: counted, to be raised after the step; never printed, and never written to MUJOCO_LOG.TXT.

MuJoCo resets a state that is not finite, warns, and goes on. Its warnings reach Python by a callback, in which nothing may be
raised: that would end the process. But every `MjData` counts its own.
"""

# mujoco's compiled classes come without type stubs.
# pyright: reportAttributeAccessIssue=false

from collections import deque

import mujoco
import numpy as np
from numpy.typing import NDArray

NAMES = (
    "singular inertia", "too many contacts", "too many constraints", "a position that is not finite",
    "a velocity that is not finite", "an acceleration that is not finite", "a control that is not finite",
)  # fmt: skip
recent: deque[str] = deque(maxlen=20)  # what was said of any model in this process

if mujoco.get_mju_user_warning() is None:  # without a callback they would go to a file in the working folder
    mujoco.set_mju_user_warning(recent.append)


def warning_counts(data: mujoco.MjData) -> NDArray[np.integer]:
    """(7,) how often MuJoCo warned of a simulation since it was made or reset, by kind; it counts on as the simulation does."""
    return data.warning.number


def warnings_of(counts: NDArray[np.integer]) -> str:
    """What `warning_counts` say in words; empty where they are zero."""
    return ", ".join(name for name, count in zip(NAMES, counts, strict=True) if count)
