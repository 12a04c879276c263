"""Work begun before the command line is read: the imports that a run needs."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress

from twin.kernel.process.job import core_count
from twin.report.explore import ANSWER_JOB
from twin.report.page import DRAW_JOB
from twin.studies.sweep import WORKER_JOB

RUN_JOB = "twin.robot.live.runs:recorded_runs"
"""Of `twin run`."""
COMMAND_JOBS = {"run": RUN_JOB, "report": DRAW_JOB, "sweep": WORKER_JOB, "explore": ANSWER_JOB}
_EXCLUDING_WORDS = {
    "run": {"--help", "--live", "--sweep", "none", "--isolate=none"},
    "report": {"--help", "--budget"},
    "explore": {"--help"},
    "sweep": {"--help", "show", "dask", "--engine=dask"},
}
"""Words of a command line that another process serves, or none."""
MAX_REPORT_WORDS = 6
"""Words of a report whose picture is begun ahead: of more runs there hardly is one."""


@contextmanager
def start_expected_job() -> Iterator[None]:
    """Start the process of a run, of the picture of a report or of a sweep's first run, if the command line looks like
    one; it ends with the block if it was not asked for."""
    job = _expected_job(sys.argv[1:])
    if not job:
        yield
        return
    # for every other command this would be half of what it imports
    from twin.kernel.process.process import end_waiting, start_ahead

    # an obstacle is reported when the process is needed
    with suppress(OSError):
        start_ahead(job)
    try:
        yield
    finally:
        end_waiting()


def _expected_job(words: list[str]) -> str:
    """What the command line `words` will ask for, "" if it does not look so."""
    command, words = "".join(words[:1]), words[1:]
    # the pipes would get the numbers of streams that are closed
    usual = os.name == "posix" and None not in (sys.stdin, sys.stdout, sys.stderr)
    # where two cannot work at once it is as fast to draw where everything else is done
    alone = command == "report" and (core_count() == 1 or len(words) > MAX_REPORT_WORDS)
    begins = (
        usual and command in COMMAND_JOBS and words and not alone and not _EXCLUDING_WORDS[command].intersection(words)
    )
    return COMMAND_JOBS[command] if begins else ""
