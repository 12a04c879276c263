"""How long and how large a guarded job may become."""

import math
import os
from dataclasses import dataclass

LONG = 3600.0
"""Time (s) beyond which nobody starts without having been asked."""
PATIENCE = 10.0
"""How long (s) what is stepped is watched before anything is said of how long it will take."""

WAITING = 4.0
"""How many times longer than on a processor a call may wait for something else, which may want a processor itself."""


@dataclass(frozen=True)
class JobLimits:
    """Limits that the supervisor enforces by ending the job.

    Attributes:
        step: longest time of one call into a component (s): on the clock, and of that much on a processor, so that a
            busy machine accuses nobody; a call that waits for something else may take `WAITING` times as long. What
            calls nobody, a compilation say, has no such limit.
        wall: longest time of the whole job (s), less that in which it compiles.
        memory: most resident memory (bytes); watched where the system has /proc, so on Linux.
        expected: longest time that all ticks of one simulation may be expected to take (s), from what they have taken.
    """

    step: float = 10.0
    wall: float = math.inf
    memory: float = 4e9
    expected: float = math.inf


def cores() -> int:
    """Processors this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def duration_text(seconds: float) -> str:
    """`14 minutes`, `2.3 days`."""
    for name, length in (("years", 365.25 * 86400.0), ("days", 86400.0), ("hours", 3600.0)):
        if seconds >= 2.0 * length:
            return f"{seconds / length:.2g} {name}"
    return f"{seconds / 60.0:.0f} minutes" if seconds >= 90.0 else f"{seconds:.0f} s"
