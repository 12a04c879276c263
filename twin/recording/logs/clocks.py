"""What times say about the clocks they come from."""

import numpy as np
from numpy.typing import NDArray

BACK, PERIODS = 0.1, 10.0
"""Messages may overtake each other by less than `BACK` (s) or so many of their periods, whichever is more; what goes
back further was started anew. Two publishers and a network come to some milliseconds."""
LATE, DRIFT = 0.1, 0.02
"""Stamps of the clock of the log are this much (s) behind it at most, and their delay changes by less than `DRIFT`; a
camera is as late, a robot's drive is not."""
SHARE = 8
"""Of the messages, this part at either end tells what a delay is there."""


def restart(t: NDArray[np.float64]) -> int:
    """Index at which the times t (n,), n >= 2, in s, in the order of a log, first start anew; 0 if nowhere."""
    steps = np.diff(t)
    back = np.flatnonzero(steps < -max(BACK, PERIODS * float(np.median(np.abs(steps)))))
    return int(back[0]) + 1 if len(back) else 0


def clock_note(name: str, logged: NDArray[np.float64], stamps: NDArray[np.float64], by_stamp: bool) -> str:
    """A sentence if the stamps of a topic are of another clock than the log's; empty if not.

    Args:
        name: of the topic.
        logged: log times in the order of the log, s, (n,).
        stamps: of the messages, s, (n,).
        by_stamp: whether stamps are the times that are used.
    """
    if not by_stamp and (again := restart(stamps)):
        return (
            f"the stamps of {name} start anew {logged[again] - logged[0]:.3f} s after its first message: "
            f"from {stamps[again - 1]:.3f} s back to {stamps[again]:.3f} s"
        )
    delay = logged - stamps
    few = max(1, len(delay) // SHARE)
    first, last = float(np.median(delay[:few])), float(np.median(delay[-few:]))
    if abs(first) <= LATE and abs(last - first) <= DRIFT:
        return ""
    where = "behind" if first > 0.0 else "ahead of"
    change = f", and by {abs(last - first):.3f} s {'more' if abs(last) > abs(first) else 'less'} at the end"
    used = "stamps" if by_stamp else "log times"
    return (
        f"two clocks: the stamps of {name} are {abs(first):.3f} s {where} its log times"
        f"{change if abs(last - first) > DRIFT else ''}; {used} are used"
    )
