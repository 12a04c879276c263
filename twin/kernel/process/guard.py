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
"""Interval (s) between checks of the limits and updates of the progress."""
STOP_TIMEOUT = 5.0
"""Timeout (s) for a job that steps a system to stop by itself on request and to finish its recording."""
UNSTEPPED_STOP_TIMEOUT = 0.5
"""The same timeout (s) before the first step. Compilation cannot be interrupted, and no data would be lost."""


class JobFailure(ComponentFailed):
    """Error that a job failed after stepping had begun: its process crashed, exited or was ended for a limit."""


class JobLoadFailure(InputRefused):
    """Error that a job failed before its first step: a component could not be created."""


def run_guarded(
    job: str,
    arguments: dict[str, Any],
    limits: JobLimits = JobLimits(),  # noqa: B008, it is frozen
    listen: Callable[[dict[str, Any]], None] = lambda note: None,
    show: Callable[[int, int], None] = lambda done, total: None,
) -> Any:
    """Run `job` in a guarded process and return its result.

    Args:
        job: function name, see `load_function`; called as `job(reporter, **arguments)`, see `Reporter`.
        arguments: picklable.
        listen: callback for each note of the job.
        show: callback for progress, (ticks done, total ticks), while a system is being stepped.

    Returns:
        Return value of the function, through JSON. An end without it is a failure, whatever the exit status.

    Raises:
        JobFailure, JobLoadFailure: names the component, function, time, inputs and remedy in one message.
        TwinError: the job raised one; class, text and exit code are the same.
        KeyboardInterrupt: Ctrl-C; the job was asked to stop, and ended after a timeout.
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
                for report in process.reports(POLL_INTERVAL):
                    if "note" in report:
                        listen(report["note"])
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
                # show the output of FMUs, with control characters escaped
                sys.stderr.write("".join(f"{line}\n" for line in _printed_lines(process.output_tail)))
                return report["finished"]
        if stepped := watch.account.stepped:
            show(process.box.mark()[0], stepped.last_tick)
        watch.raise_if_over()


def _printed_lines(printed: str) -> Iterator[str]:
    """Yield the lines that a job printed; merge repeated lines, as from each instance of an FMU, into one."""
    for line, same in groupby(printed.splitlines()):
        count = len(list(same))
        yield escape_controls(line) + (f"  ({count} times)" if count > 1 and line.strip() else "")


def raise_failure(report: dict[str, Any]) -> None:
    """Raise the error (same class, text and exit code) or interrupt that a job's `report` describes, if any."""
    if "failed" in report:
        raise rebuild_error(report["failed"])
    if "interrupted" in report:
        raise KeyboardInterrupt


class Watchdog:
    """Supervisor of a process: tracks the running call and its duration, and ends the process at its limits.

    `account` has notes and progress of the job; the reader of the reports must update it.
    """

    def __init__(self, process: GuardedProcess, limits: JobLimits):
        self.account = JobAccount()
        self.process, self.limits = process, limits
        self._doing: object = None
        self._stepped: object = None
        self._begin()

    def raise_if_over(self) -> None:
        """Check all limits of the process once; JobFailure, JobLoadFailure: it has ended, or was ended for a limit."""
        limits, process = self.limits, self.process
        if process.gone:
            raise self._failure(exit_phrase(process.end()))
        # a compilation in between restarts the time of the call
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
                    "It leaks memory: report it to its vendor; --limit-memory sets the limit.",
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
        """Restart the timer of the call that is running."""
        self._since = self._looked = time.monotonic()
        self._used, self._waited = self.process.processor_time, 0.0

    def _is_over(self) -> bool:
        """Whether the running call exceeds the time limit of a call."""
        now, limit = time.monotonic(), self.limits.step
        if self.process.is_waiting:
            self._waited += now - self._looked
        self._looked = now
        if now - self._since <= limit:
            return False
        used = self.process.processor_time - self._used
        # negated, so that it is true where the processor time is unknown (NaN)
        return not used <= limit or self._waited > MAX_WAIT_RATIO * limit

    def _expected_duration(self) -> float:
        """Estimate the duration of the whole simulation (s) from its ticks so far; 0 if unknown."""
        stepped, now = self.account.stepped, time.monotonic()
        if stepped is None:
            return 0.0
        tick = self.process.box.mark()[0]
        # time for compiling or loading before the first step does not count
        if stepped is not self._stepped or tick == 0:
            self._stepped, self._first = stepped, now
        taken = now - self._first
        return taken * stepped.last_tick / tick if tick and taken > MIN_ESTIMATE_TIME else 0.0

    def _failure(self, manner: str, remedy: str | None = None, culprit: str | None = None) -> TwinError:
        """End the supervised process, so that its state is final, and return the error about its end."""
        self.process.end()
        text = failure_message(self.account, self.process.box, manner, remedy, self.process.output_tail, culprit)
        return JobFailure(text) if self.account.stepped else JobLoadFailure(text)
