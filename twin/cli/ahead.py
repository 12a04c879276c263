"""Processes started before the command line is parsed, to import early the modules that a run needs."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress

from twin.kernel.process.job import core_count
from twin.report.explore import ANSWER_JOB
from twin.report.page import DRAW_JOB
from twin.studies.sweep import WORKER_JOB

RUN_JOB = "twin.robot.live.runs:recorded_runs"
COMMAND_JOBS = {"run": RUN_JOB, "report": DRAW_JOB, "sweep": WORKER_JOB, "explore": ANSWER_JOB}
_EXCLUDING_WORDS = {
    "run": {"--help", "--live", "--sweep", "none", "--isolate=none"},
    "report": {"--help", "--budget"},
    "explore": {"--help"},
    "sweep": {"--help", "show", "dask", "--engine=dask"},
}
"""Words of a command line that is served by another process, or needs no process."""
MAX_REPORT_WORDS = 6
"""Maximum number of words of a report whose picture is started ahead; more runs rarely have one."""


@contextmanager
def start_expected_job() -> Iterator[None]:
    """Start in advance the process (run, picture, sweep) that the words need, probably; it ends with the block."""
    job = _expected_job(sys.argv[1:])
    if not job:
        yield
        return
    # imported here: for other commands it would be half of their imports
    from twin.kernel.process.process import end_waiting, start_ahead

    # an error is reported when the process is needed
    with suppress(OSError):
        start_ahead(job)
    try:
        yield
    finally:
        end_waiting()


def _expected_job(words: list[str]) -> str:
    """Return the job (function name) that a command line will probably need; "" if it needs no process."""
    command, words = "".join(words[:1]), words[1:]
    # with a closed standard stream, the pipes would get its descriptor
    usual = os.name == "posix" and None not in (sys.stdin, sys.stdout, sys.stderr)
    # on one core, or with many runs, drawing is as fast in the command's own process
    alone = command == "report" and (core_count() == 1 or len(words) > MAX_REPORT_WORDS)
    begins = (
        usual and command in COMMAND_JOBS and words and not alone and not _EXCLUDING_WORDS[command].intersection(words)
    )
    return COMMAND_JOBS[command] if begins else ""
