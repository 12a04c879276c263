"""What is begun before the command line has been read, which takes as long as half of what a run has to import."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress

from twin.runs.guard.ahead import end_waiting, start_ahead

JOB = "twin.runs.guard.runs:recorded_runs"
"""Of `twin run`."""
_ELSEWHERE = {"--help", "--live", "--sweep", "none", "--isolate=none"}
"""Words of a command line of `twin run` that another process serves, or none."""


@contextmanager
def run_expected() -> Iterator[None]:
    """Start the process of a run, if the command line looks like one; it ends with the block if nobody has asked."""
    command, words = sys.argv[1:2], sys.argv[2:]
    # the pipes would get the numbers of streams that are closed
    usual = os.name == "posix" and None not in (sys.stdin, sys.stdout, sys.stderr)
    if usual and command == ["run"] and words and not _ELSEWHERE.intersection(words):
        # what is in the way is told when the process is needed
        with suppress(OSError):
            start_ahead(JOB)
    try:
        yield
    finally:
        end_waiting()
