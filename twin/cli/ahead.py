"""What is begun before the command line has been read, which takes as long as half of what a run has to import."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress

from twin.report.page import DRAWN
from twin.runs.guard.ahead import end_waiting, start_ahead

JOB = "twin.runs.guard.runs:recorded_runs"
"""Of `twin run`."""
JOBS = {"run": JOB, "report": DRAWN}
_ELSEWHERE = {
    "run": {"--help", "--live", "--sweep", "none", "--isolate=none"},
    "report": {"--help", "--budget"},
}
"""Words of a command line that another process serves, or none."""
FEW = 6
"""Words of a report whose picture is begun ahead: of more runs there hardly is one."""


@contextmanager
def job_expected() -> Iterator[None]:
    """Start the process of a run, or of the picture of a report, if the command line looks like one; it ends with the
    block if nobody has asked."""
    command, words = "".join(sys.argv[1:2]), sys.argv[2:]
    # the pipes would get the numbers of streams that are closed
    usual = os.name == "posix" and None not in (sys.stdin, sys.stdout, sys.stderr)
    # where two cannot work at once it is as fast to draw where everything else is done
    alone = command == "report" and (cores() == 1 or len(words) > FEW)
    if usual and command in JOBS and words and not alone and not _ELSEWHERE[command].intersection(words):
        # what is in the way is told when the process is needed
        with suppress(OSError):
            start_ahead(JOBS[command])
    try:
        yield
    finally:
        end_waiting()


def cores() -> int:
    """Processors this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
