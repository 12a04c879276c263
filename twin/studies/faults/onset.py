"""When a fault begins: in free motion and in contact, as a healthy run of the experiment has them."""

import numpy as np
from numpy.typing import NDArray

from twin.errors import InputRefused
from twin.studies.faults.trial import FaultTrial

TOUCH = 0.5
"""True force (N) from which on the robot touches: half the force at which the monitor lets a contact begin."""


def default_onsets(healthy: FaultTrial) -> tuple[int, int]:
    """(a tick in free motion, a tick in contact) of a `healthy` run.

    The first is the middle of the descent to the first contact, the second the middle of the longest contact: the hold
    of a press, the deepest part of a tap, the sweep of Fig. 4.

    Raises:
        InputRefused: it touches nothing.
    """
    contacts = _spans(touching(healthy))
    if len(contacts) == 0:
        raise InputRefused("the healthy run touches nothing, so it has no contact to break; say when with --onset S")
    first = int(contacts[0, 0])
    rests = np.flatnonzero(np.diff(healthy.z[: first + 1]) >= 0.0)
    descent = int(rests[-1]) + 1 if len(rests) else 0
    longest = contacts[np.argmax(contacts[:, 1] - contacts[:, 0])]
    return (descent + first) // 2, int(longest.sum()) // 2


def touching(run: FaultTrial) -> NDArray[np.bool_]:
    """In which ticks the robot touches, (ticks,)."""
    return run.force >= TOUCH


def _spans(true: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Unbroken stretches of True, (n, 2): first tick, and the one after the last."""
    edges = np.diff(np.concatenate([[False], true, [False]]).astype(int))
    return np.flatnonzero(edges).reshape(-1, 2)
