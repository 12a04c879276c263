"""Jobs: functions that another process calls by name, their limits and their outcomes.

The name, rather than the function, is passed, because the other process then loads only the job's own imports.
"""

import _thread
import contextlib
import importlib
import math
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from twin.kernel.errors import NotWritten, TwinError, internal_error, os_error_message

STOP_ORDER = "stop"
"""Order that interrupts a job's process."""
LONG_RUN_DURATION = 3600.0
"""Expected duration (s) above which a run asks for confirmation before it starts."""
MIN_ESTIMATE_TIME = 10.0
"""Observation time (s) before the duration of a simulation is estimated."""
MAX_WAIT_RATIO = 4.0
"""Maximum ratio of a call's waiting time to its limit of processor time; the call may wait for another process that
needs the processor itself."""
INTERRUPT_EXIT_CODE, TERMINATE_EXIT_CODE = 130, 143
"""Exit codes of a command ended by Ctrl-C, or by SIGTERM."""
INTERRUPT_RETRY_DELAY = 0.01
"""Delay (s) after which a lost interrupt is repeated; the finaliser that lost it has ended by then."""
_termination_signals: list[int] = []
"""Termination signals (SIGTERM, SIGHUP) that this process has received."""


def load_function(name: str) -> Callable[..., Any]:
    """Import and return a function by its name "module:function"."""
    module, _, function = name.partition(":")
    found: Callable[..., Any] = getattr(importlib.import_module(module), function)
    return found


@dataclass(frozen=True)
class JobLimits:
    """Maximum time (s) and memory of a guarded job, enforced by its supervisor.

    Attributes:
        step: one call into a component, in wall time and in processor time, so that a busy machine makes no call look
            slow; a call that waits may take `MAX_WAIT_RATIO` times as long. Code outside FMU calls, such as a
            compilation, has no such limit.
        wall: the whole job, excluding compilation.
        memory: resident memory (bytes); checked where the system has /proc, i.e. on Linux.
        expected: expected duration of all ticks of one simulation, extrapolated from the ticks so far.
    """

    step: float = 10.0
    wall: float = math.inf
    memory: float = 4e9
    expected: float = math.inf


def core_count() -> int:
    """Return the number of processor cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def duration_text(seconds: float) -> str:
    """Format a duration: `14 minutes`, `2.3 days`."""
    for name, length in (("years", 365.25 * 86400.0), ("days", 86400.0), ("hours", 3600.0)):
        if seconds >= 2.0 * length:
            return f"{seconds / length:.2g} {name}"
    return f"{seconds / 60.0:.0f} minutes" if seconds >= 90.0 else f"{seconds:.0f} s"


def failure_report(problem: Exception) -> list[Any]:
    """Serialise an exception for another process: module, class, text, exit code; see `rebuild_error`."""
    if isinstance(problem, OSError):
        return failure_report(NotWritten(os_error_message(problem)))
    if not isinstance(problem, TwinError):
        return failure_report(internal_error())
    kind = type(problem)
    return [kind.__module__, kind.__qualname__, str(problem), problem.exit_code]


def rebuild_error(report: list[Any]) -> TwinError:
    """Restore an error of another process from its `failure_report`: class, text and exit code, no other attributes."""
    module, name, text, exit_code = report
    kind = getattr(importlib.import_module(module), name, TwinError) if module.startswith("twin.") else TwinError
    # bypass __init__, whose arguments are already part of the text
    error: TwinError = kind.__new__(kind, text)
    error.exit_code = exit_code
    return error


@contextlib.contextmanager
def handle_termination() -> Iterator[None]:
    """Make SIGTERM and an unignored SIGHUP end the block like Ctrl-C, with another exit code; main thread only."""

    def end(number: int, frame: object) -> None:
        _termination_signals.append(number)
        raise KeyboardInterrupt

    if threading.current_thread() is not threading.main_thread():
        yield
        return
    numbers = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]
    ending = [number for number in numbers if signal.getsignal(number) is not signal.SIG_IGN]
    before = {number: signal.signal(number, end) for number in ending}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def interruption() -> tuple[int, str]:
    """Return the exit code and the participle for the signal that ended this process: Ctrl-C or SIGTERM."""
    return (TERMINATE_EXIT_CODE, "terminated") if _termination_signals else (INTERRUPT_EXIT_CODE, "interrupted")


def retry_lost_interrupts() -> None:
    """Repeat interrupts (Ctrl-C) that arrive where they cannot be caught, from now on, after a short delay.

    Compiling has many such places: finalisers and callbacks manage each piece of machine code.
    """
    before = sys.unraisablehook

    def on_unraisable(lost: "sys.UnraisableHookArgs") -> None:
        if issubclass(lost.exc_type, KeyboardInterrupt):
            again = threading.Timer(INTERRUPT_RETRY_DELAY, interrupt_main)
            again.daemon = True
            again.start()
        else:
            before(lost)

    sys.unraisablehook = on_unraisable


def interrupt_main() -> None:
    """Raise KeyboardInterrupt in the main thread, from another thread."""
    if sys.platform == "win32":
        _thread.interrupt_main()
    else:
        # a real signal, because it also interrupts a blocking system call
        signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGINT)


def recording_status(folder: Path | None) -> str:
    """Describe the recording in `folder` in one sentence (None if there is no folder yet)."""
    # imported here: the supervisor loads no numerical packages unless something fails
    from twin.kernel.recording.folder import PARTIAL_SUFFIX, RECORDING_FILE
    from twin.kernel.recording.reader import last_time

    if folder is not None and (folder / RECORDING_FILE).exists():
        return f"The recording is complete: {relative_path(folder / RECORDING_FILE)}."
    if folder is None or not (partial := folder / f"{RECORDING_FILE}{PARTIAL_SUFFIX}").exists():
        return "Nothing was recorded."
    return f"Recorded until then: {relative_path(partial)} ({last_time(partial) or 0.0:.3f} s)."


def interrupt_message(folder: Path, continuing: str = "twin run") -> str:
    """Return the message after Ctrl-C about the recording in the `folder` of a run; remove an empty folder.

    `continuing` is the command that continues the run.
    """
    from twin.kernel.recording.folder import PARTIAL_SUFFIX, RECORDING_FILE

    if (partial := folder / f"{RECORDING_FILE}{PARTIAL_SUFFIX}").exists():
        command = f"{continuing} --from {relative_path(folder)}"
        return f"interrupted; recorded until then: {relative_path(partial)}; continue with: {command}"
    if (whole := folder / RECORDING_FILE).exists():
        return f"interrupted; the recording is complete: {relative_path(whole)}"
    # other files in the folder stay
    with contextlib.suppress(OSError):
        folder.rmdir()
    return "interrupted before the first step; nothing is recorded"


def relative_path(path: Path) -> Path:
    """Return `path` relative to the current folder if it is below that folder, else unchanged."""
    return path.relative_to(Path.cwd()) if path.is_relative_to(Path.cwd()) else path
