"""Jobs: functions that another process calls by name, their limits and their outcomes.

It is named, because what it imports is loaded there.
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
"""Order to a job's process: interrupt it."""
LONG_RUN_DURATION = 3600.0
"""Time (s) beyond which a run starts only after a question."""
MIN_ESTIMATE_TIME = 10.0
"""How long (s) what is stepped is watched before anything is said of how long it will take."""
MAX_WAIT_RATIO = 4.0
"""How many times longer than on a processor a call may wait for something else, which may want a processor itself."""
INTERRUPT_EXIT_CODE, TERMINATE_EXIT_CODE = 130, 143
"""Exit codes of a command that Ctrl-C, or SIGTERM, has ended."""
INTERRUPT_RETRY_DELAY = 0.01
"""s. By then the finaliser is over: interrupted within it once more, the program would lose that one, too."""
_termination_signals: list[int] = []
"""Signals of the kind SIGTERM that this process got."""


def load_function(name: str) -> Callable[..., Any]:
    """The function "module:function"."""
    module, _, function = name.partition(":")
    found: Callable[..., Any] = getattr(importlib.import_module(module), function)
    return found


@dataclass(frozen=True)
class JobLimits:
    """Limits that the supervisor enforces by ending the job.

    Attributes:
        step: longest time of one call into a component (s): on the clock, and of that much on a processor, so that a
            busy machine makes no call look slow; a call that waits for something else may take `MAX_WAIT_RATIO` times as
            long. Code that calls no FMU, a compilation say, has no such limit.
        wall: longest time of the whole job (s), less that in which it compiles.
        memory: most resident memory (bytes); watched where the system has /proc, so on Linux.
        expected: longest time that all ticks of one simulation may be expected to take (s), from what they have taken.
    """

    step: float = 10.0
    wall: float = math.inf
    memory: float = 4e9
    expected: float = math.inf


def core_count() -> int:
    """Processors this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def duration_text(seconds: float) -> str:
    """`14 minutes`, `2.3 days`."""
    for name, length in (("years", 365.25 * 86400.0), ("days", 86400.0), ("hours", 3600.0)):
        if seconds >= 2.0 * length:
            return f"{seconds / length:.2g} {name}"
    return f"{seconds / 60.0:.0f} minutes" if seconds >= 90.0 else f"{seconds:.0f} s"


def failure_report(problem: Exception) -> list[Any]:
    """What `rebuild_error` makes an error of again: module and class, text, exit code."""
    if isinstance(problem, OSError):
        return failure_report(NotWritten(os_error_message(problem)))
    if not isinstance(problem, TwinError):
        return failure_report(internal_error())
    kind = type(problem)
    return [kind.__module__, kind.__qualname__, str(problem), problem.exit_code]


def rebuild_error(report: list[Any]) -> TwinError:
    """The error of a `failure_report`: of the same class, with the same text and exit code.

    What else the error carried is left out: code that needs it runs in the process itself.
    """
    module, name, text, exit_code = report
    kind = getattr(importlib.import_module(module), name, TwinError) if module.startswith("twin.") else TwinError
    # not called: what its __init__ wants is in the text already
    error: TwinError = kind.__new__(kind, text)
    error.exit_code = exit_code
    return error


@contextlib.contextmanager
def handle_termination() -> Iterator[None]:
    """Within the block SIGTERM and SIGHUP end this process as Ctrl-C does, with another exit code; for a main thread.

    A SIGHUP that is ignored stays so: `nohup`.
    """

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
    """Exit code of, and word for, what has interrupted this process: Ctrl-C, or SIGTERM."""
    return (TERMINATE_EXIT_CODE, "terminated") if _termination_signals else (INTERRUPT_EXIT_CODE, "interrupted")


def retry_lost_interrupts() -> None:
    """From now on an interrupt that cannot be caught where it arrives comes again a moment later.

    Compiling is full of such places: each piece of machine code is kept and let go by finalisers and callbacks.
    """
    before = sys.unraisablehook

    def hear(lost: "sys.UnraisableHookArgs") -> None:
        if issubclass(lost.exc_type, KeyboardInterrupt):
            again = threading.Timer(INTERRUPT_RETRY_DELAY, interrupt_main)
            again.daemon = True
            again.start()
        else:
            before(lost)

    sys.unraisablehook = hear


def interrupt_main() -> None:
    """Raise KeyboardInterrupt in the main thread; to be called by another one."""
    if sys.platform == "win32":
        _thread.interrupt_main()
    else:
        # a real signal, because it also ends a system call that waits
        signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGINT)


def recording_status(folder: Path | None) -> str:
    """A sentence about the recording in `folder` (None: there is no folder yet)."""
    # the supervisor loads no numerics unless something goes wrong
    from twin.kernel.recording.folder import PARTIAL_SUFFIX, RECORDING_FILE
    from twin.kernel.recording.reader import last_time

    if folder is not None and (folder / RECORDING_FILE).exists():
        return f"The recording is complete: {relative_path(folder / RECORDING_FILE)}."
    if folder is None or not (partial := folder / f"{RECORDING_FILE}{PARTIAL_SUFFIX}").exists():
        return "Nothing was recorded."
    return f"Recorded until then: {relative_path(partial)} ({last_time(partial) or 0.0:.3f} s)."


def interrupt_message(folder: Path) -> str:
    """What Ctrl-C has left in the `folder` of a run; it goes if that is nothing."""
    from twin.kernel.recording.folder import PARTIAL_SUFFIX, RECORDING_FILE

    whole, partial = folder / RECORDING_FILE, folder / f"{RECORDING_FILE}{PARTIAL_SUFFIX}"
    if partial.exists():
        go_on = f"twin run --from {relative_path(folder)} goes on"
        return f"interrupted; recorded until then: {relative_path(partial)}; {go_on}"
    if whole.exists():
        return f"interrupted; the recording is complete: {relative_path(whole)}"
    # whatever else is in it stays
    with contextlib.suppress(OSError):
        folder.rmdir()
    return "interrupted before the first step; nothing is recorded"


def relative_path(path: Path) -> Path:
    """`path` relative to the current folder, if it lies below."""
    return path.relative_to(Path.cwd()) if path.is_relative_to(Path.cwd()) else path
