"""What this process may use of the machine."""

import os


def cores() -> int:
    """Processors on which the thread that asks may run."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
