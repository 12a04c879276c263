"""The supervisor of a job in a guarded process: its limits and how it ended."""

import sys
import time
from collections.abc import Callable, Iterator
from itertools import groupby
from typing import Any

from twin.kernel.errors import ComponentFailed, InputRefused, TwinError, escape_controls
from twin.kernel.process.black_box import JobAccount, exit_phrase, failure_message
from twin.kernel.process.job import (
    MAX_WAIT_RATIO,
    MIN_ESTIMATE_TIME,
    STOP_ORDER,
    JobLimits,
    duration_text,
    rebuild_error,
)
from twin.kernel.process.process import GuardedProcess, process_for, resident_memory

POLL_INTERVAL = 0.05
"""How often (s) limits are looked at and progress is shown."""
STOP_TIMEOUT = 5.0
"""How long (s) a job that steps a system may take to stop by itself when asked to: it ends its recording."""
UNSTEPPED_STOP_TIMEOUT = 0.5
"""The same (s) before its first step. What is compiled cannot be interrupted, and there is nothing to lose."""


class JobFailure(ComponentFailed):
    """The job's process crashed, ended itself or was ended for a limit, after stepping had begun."""


class JobLoadFailure(InputRefused):
    """The same before the first step: a component could not even be made."""


def run_guarded(
    job: str,
    arguments: dict[str, Any],
    limits: JobLimits = JobLimits(),  # noqa: B008, it is frozen
    listen: Callable[[dict[str, Any]], None] = lambda note: None,
    show: Callable[[int, int], None] = lambda done, total: None,
) -> Any:
    """The result of `job`, run in a process of its own.

    Args:
        job: see `function_called`; it is called as `job(reporter, **arguments)`, see `Reporter`.
        arguments: what can be pickled.
        limits: the job is ended if it exceeds one.
        listen: called with every note of the job.
        show: called with (ticks done, ticks in all) while a system is being stepped.

    Returns:
        What the function returned, through JSON. An end without this is a failure, whatever the exit status.

    Raises:
        JobEnded, JobEndedLoading: in one sentence who, how, where, when, with which inputs, and what to do.
        TwinError: the job raised one: class, text and exit code are those.
        KeyboardInterrupt: Ctrl-C; the job has been asked to stop, and ended if it did not.
    """
    with process_for(job) as process:
        process.start(arguments)
        watch = Watchdog(process, limits)
        try:
            return _follow(process, watch, listen, show)
        except KeyboardInterrupt:
            process.order(STOP_ORDER)
            deadline = time.monotonic() + (STOP_TIMEOUT if watch.account.stepped else UNSTEPPED_STOP_TIMEOUT)
            while not process.gone and time.monotonic() < deadline:
                process.reports(POLL_INTERVAL)
            raise


def _follow(
    process: GuardedProcess,
    watch: "Watchdog",
    listen: Callable[[dict[str, Any]], None],
    show: Callable[[int, int], None],
) -> Any:
    while True:
        for report in process.reports(POLL_INTERVAL):
            watch.account.update(report)
            raise_failure(report)
            if "note" in report:
                listen(report["note"])
            elif "finished" in report:
                process.end()
                # whatever an FMU has printed is shown, and never obeyed
                sys.stderr.write("".join(f"{line}\n" for line in _printed_lines(process.output_tail)))
                return report["finished"]
        stepped = watch.account.stepped
        if stepped:
            show(process.box.mark()[0], stepped.last_tick)
        watch.raise_if_over()


def _printed_lines(printed: str) -> Iterator[str]:
    """The lines of it; one that comes several times in a row, as from each instance of an FMU, once."""
    for line, same in groupby(printed.splitlines()):
        count = len(list(same))
        yield escape_controls(line) + (f"  ({count} times)" if count > 1 and line.strip() else "")


def raise_failure(report: dict[str, Any]) -> None:
    """Raise what ended a job, if `report` says so.

    Raises:
        TwinError: of the class, text and exit code of the one that the job raised.
        KeyboardInterrupt: the job was interrupted.
    """
    if "failed" in report:
        raise rebuild_error(report["failed"])
    if "interrupted" in report:
        raise KeyboardInterrupt


class Watchdog:
    """Knows what a process is doing and for how long, and ends it at its limits.

    Attributes:
        account: the notes and progress of the job; the reader of the reports hands them to it.
        process, limits: what is watched.
    """

    def __init__(self, process: GuardedProcess, limits: JobLimits):
        self.account = JobAccount()
        self.process, self.limits = process, limits
        self._doing: object = None
        self._begin()
        self._stepped: object = None

    def raise_if_over(self) -> None:
        """Look once.

        Raises:
            JobEnded, JobEndedLoading: the process has ended without a word, or exceeded a limit and has been ended.
        """
        limits, process = self.limits, self.process
        if process.gone:
            raise self._failure(exit_phrase(process.end()))
        # what is compiled meanwhile gives a call its whole time again
        compiled = process.box.compile_time()
        doing = (process.box.mark(), process.box.call(), compiled)
        if doing != self._doing or not self.account.is_busy(process.box):
            self._doing = doing
            self._begin()
        elif self._is_over():
            raise self._failure(
                f"did not return within {limits.step:g} s",
                "If it is slow rather than stuck, raise --limit-step; else choose another one.",
            )
        if (seconds := self._expected_duration()) > limits.expected:
            raise self._failure(
                f"was at work when the whole run was seen to take about {duration_text(seconds)}",
                "--yes runs it anyway, --set duration_s=... shortens it; `twin drive check` measures the cost.",
            )
        for name, pid in self.account.helpers.items():
            if resident_memory(pid) > limits.memory:
                raise self._failure(
                    f"grew to the limit of {limits.memory / 1e6:g} MB of memory",
                    "It leaks: tell its maker; --limit-memory sets the limit.",
                    name,
                )
        if process.memory > limits.memory:
            raise self._failure(
                f"was at work when the process reached the limit of {limits.memory / 1e6:g} MB of memory",
                "`--isolate drive` shows which drive grows; --limit-memory sets the limit.",
            )
        if process.age - compiled > limits.wall:
            raise self._failure(
                f"was at work when the time limit of {limits.wall:g} s was over",
                "Simulate less, or raise --limit-wall.",
            )

    def _begin(self) -> None:
        """What is going on now has just begun."""
        self._since = self._looked = time.monotonic()
        self._used, self._waited = self.process.processor_time, 0.0

    def _is_over(self) -> bool:
        """Whether what is going on takes longer than a call may."""
        now, limit = time.monotonic(), self.limits.step
        if self.process.is_waiting:
            self._waited += now - self._looked
        self._looked = now
        if now - self._since <= limit:
            return False
        used = self.process.processor_time - self._used
        # nothing is known of the processor: the difference is no number
        return not used <= limit or self._waited > MAX_WAIT_RATIO * limit

    def _expected_duration(self) -> float:
        """How long the simulation takes as a whole (s), from what its ticks have taken; 0 if nothing can be said."""
        stepped, now = self.account.stepped, time.monotonic()
        if stepped is None:
            return 0.0
        tick = self.process.box.mark()[0]
        # what is compiled or loaded before the first step is no part of it
        if stepped is not self._stepped or tick == 0:
            self._stepped, self._first = stepped, now
        taken = now - self._first
        return taken * stepped.last_tick / tick if tick and taken > MIN_ESTIMATE_TIME else 0.0

    def _failure(self, manner: str, remedy: str | None = None, culprit: str | None = None) -> TwinError:
        """The error that tells of the end of the process; ends it first, so that nothing changes any more."""
        self.process.end()
        text = failure_message(self.account, self.process.box, manner, remedy, self.process.output_tail, culprit)
        return JobFailure(text) if self.account.stepped else JobLoadFailure(text)
