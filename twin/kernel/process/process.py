"""The parent's side of a guarded process: orders, reports, end.

A Python of our own: it finds this package and nothing that happens to lie in the folder where it is started.
"""

import contextlib
import json
import math
import os
import pickle
import selectors
import signal
import sys
import sysconfig
import time
from pathlib import Path
from subprocess import PIPE, Popen
from typing import Any

import twin
from twin.kernel.process.black_box import BlackBox

TAIL_BYTES = 8192
"""Bytes kept of what the process printed."""
THREAD_LIMITS = {"OPENBLAS_NUM_THREADS": "1"}
"""Environment of the process, where the user does not say otherwise. Processes that run side by side would start a
thread per core each; and sums would depend on how many cores there are, in the last bit of long vectors."""
_READ_BYTES = 65536


def module_command(module: str, *arguments: str) -> list[str]:
    """The command that runs `module` of this package, with `environment`."""
    # -P: the folder where a user happens to be is no place to import from
    return [sys.executable, "-P", "-m", module, *arguments]


def environment() -> dict[str, str]:
    """This process's environment, by which another Python finds the package that this one uses.

    What a drive starts there, scripts of its own perhaps, searches folders as Python does by itself.
    """
    home = str(Path(twin.__file__).parents[1])
    inherited = os.environ.get("PYTHONPATH", "").split(os.pathsep)
    # an empty entry is the current folder; site-packages are found anyway, and not before the standard library
    paths = [path for path in (home, *inherited) if path and path != sysconfig.get_path("purelib")]
    return {**os.environ, "PYTHONPATH": os.pathsep.join(paths)}


class GuardedProcess:
    """A process of its own group that runs one job; a context manager at whose exit nothing of it is left.

    Args:
        job: see `function_called`; imported at once by the process, it begins when `start` brings its arguments.
        helper: of a guarded process, that is this one: belongs to its group and prints where it prints.

    Attributes:
        pid: of the process.
        box: what it was doing.
        gone: it will report no more.
        ended: it has been ended.
    """

    def __init__(self, job: str, helper: bool = False):
        self.box = BlackBox()
        self.gone = False
        self._process = Popen(
            module_command("twin.kernel.process.child", str(self.box.fd), str(os.getpid())),
            stdin=PIPE,
            stdout=PIPE,
            stderr=None if helper else PIPE,
            pass_fds=[self.box.fd],
            env={**THREAD_LIMITS, **environment()},
            start_new_session=not helper,
        )
        self.pid = self._process.pid
        self._helper = helper
        self._reports = _fd(self._process.stdout)
        self._selector = selectors.DefaultSelector()
        for pipe in filter(None, (self._process.stdout, self._process.stderr)):
            self._selector.register(_fd(pipe), selectors.EVENT_READ)
        self._rest = self._tail = b""
        self._began = time.monotonic()
        self.order(job)

    def __enter__(self) -> "GuardedProcess":
        return self

    def __exit__(self, *failure: object) -> None:
        self.close()

    def close(self) -> None:
        """End it, if it has not ended, and give back what it needed here."""
        self.end()
        self._selector.close()
        for pipe in (self._process.stdin, self._process.stdout, self._process.stderr):
            if pipe is not None:
                with contextlib.suppress(BrokenPipeError):
                    pipe.close()
        self.box.close()

    @property
    def age(self) -> float:
        """Time since it was started (s)."""
        return time.monotonic() - self._began

    @property
    def processor_time(self) -> float:
        """How long it has been on a processor (s); infinity where the system does not tell."""
        return processor_time(self.pid)

    @property
    def is_waiting(self) -> bool:
        """Whether it is not even ready for a processor; so it is where the system does not tell."""
        try:
            # pid (name) state ..; a name may have brackets
            with open(f"/proc/{self.pid}/stat", "rb", buffering=0) as file:
                return not file.read().rpartition(b")")[2].lstrip().startswith(b"R")
        except OSError:
            return True

    @property
    def output_tail(self) -> str:
        """The last kilobytes of what it wrote to standard output and standard error."""
        return self._tail.decode(errors="replace")

    @property
    def memory(self) -> int:
        """Resident memory (bytes); 0 where the system does not tell."""
        return resident_memory(self.pid)

    @property
    def has_exit_status(self) -> bool:
        return self._process.returncode is not None

    def start(self, arguments: dict[str, Any]) -> None:
        """Let the job begin."""
        # every type arrives as it was; what comes back is JSON, because FMUs live there
        self.order(pickle.dumps(arguments).hex())

    def order(self, line: str) -> None:
        """Send a line; harmless if the reader has gone."""
        with contextlib.suppress(BrokenPipeError):
            os.write(_fd(self._process.stdin), line.encode() + b"\n")

    def reports(self, timeout: float) -> list[dict[str, Any]]:
        """What it has reported since the last call, waiting at most `timeout` (s) for something to happen."""
        lines: list[bytes] = []
        ready = self._selector.select(timeout)
        if not ready and not self.has_exit_status:
            self.gone |= self._is_zombie()
        for key, _ in ready:
            data = os.read(key.fd, _READ_BYTES)
            if not data:
                self._selector.unregister(key.fd)
                self.gone |= key.fd == self._reports
            elif key.fd == self._reports:
                *lines, self._rest = (self._rest + data).split(b"\n")
            else:
                self._tail = (self._tail + data)[-TAIL_BYTES:]
        return [json.loads(line) for line in lines]

    def _is_zombie(self) -> bool:
        """Whether it has ended, which its closed pipe does not tell while something it started holds that open.

        It is not waited for: until then its number, which is also that of its group, stays its own.
        """
        # macOS has it from Python 3.13 on; before, the limit on a step's time ends such a process
        if not hasattr(os, "waitid"):
            return False
        return os.waitid(os.P_PID, self.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT) is not None

    def end(self) -> int:
        """End it and everything it started; return its exit status, negative for a signal.

        A process that has ended by itself keeps the status it ended with.
        """
        if not self.has_exit_status:
            # not waited for yet, so its number cannot have gone to anybody else
            with contextlib.suppress(ProcessLookupError, PermissionError):
                (os.kill if self._helper else os.killpg)(self.pid, signal.SIGKILL)
            self._process.wait()
            while self._selector.get_map() and self._selector.select(0):
                self.reports(0)
        return self._process.returncode


def resident_memory(pid: int) -> int:
    """Of the process `pid` (bytes); 0 if it has ended or the system does not tell."""
    try:
        # asked several times a run; pathlib takes longer than the rest
        with open(f"/proc/{pid}/statm", "rb", buffering=0) as file:
            return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except OSError:
        return 0


def processor_time(pid: int) -> float:
    """How long the process `pid` has been on a processor (s); infinity where the system does not tell."""
    try:
        # Linux: the clock of a process is named after it (clock_getcpuclockid)
        return time.clock_gettime(cpu_clock(pid)) if sys.platform == "linux" else math.inf
    except OSError:
        return math.inf


def cpu_clock(pid: int) -> int:
    """The clock of the time that the process `pid` has been on a processor (linux/posix-timers.h: CPUCLOCK_SCHED)."""
    return ~pid << 3 | 2


def _fd(pipe: Any) -> int:
    return pipe.fileno()


_waiting: dict[str, GuardedProcess] = {}


def start_ahead(job: str) -> None:
    """Start a process that will be asked for `job`, if somebody asks."""
    _waiting[job] = GuardedProcess(job)


def claim_process(job: str) -> GuardedProcess | None:
    """The process that was started ahead for `job`, if one was; none waits any more."""
    found = _waiting.pop(job, None)
    end_waiting()
    return found


def process_for(job: str) -> GuardedProcess:
    """The process that was started ahead for `job`, or a new one; none waits any more."""
    return claim_process(job) or GuardedProcess(job)


def end_waiting() -> None:
    """End the processes that no job has asked for."""
    while _waiting:
        _waiting.popitem()[1].close()
