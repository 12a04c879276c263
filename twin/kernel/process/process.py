"""A guarded process, seen from its parent: start, orders, reports, end.

Its Python interpreter finds this package, and does not import modules from the folder where it is started.
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
"""Number of bytes kept of the output of the process."""
THREAD_LIMITS = {"OPENBLAS_NUM_THREADS": "1"}
"""Environment defaults of the process. Parallel processes would otherwise start a thread per core each, and the last
bit of sums over long vectors would depend on the number of cores."""
_READ_BYTES = 65536


def module_command(module: str, *arguments: str) -> list[str]:
    """Return the command line that runs `module` of this package in a new Python process, with `environment`."""
    # -P: do not import from the current folder
    return [sys.executable, "-P", "-m", module, *arguments]


def environment() -> dict[str, str]:
    """Return this process's environment variables, extended so that Python scripts of a drive find this package."""
    home = str(Path(twin.__file__).parents[1])
    inherited = os.environ.get("PYTHONPATH", "").split(os.pathsep)
    # an empty entry is the current folder; site-packages are found anyway, and not before the standard library
    paths = [path for path in (home, *inherited) if path and path != sysconfig.get_path("purelib")]
    return {**os.environ, "PYTHONPATH": os.pathsep.join(paths)}


class GuardedProcess:
    """A process in its own process group that runs one job; a context manager that ends the whole group.

    It imports the job (see `load_function`) immediately and calls it after `start`. A `helper` of a guarded process,
    the current one, shares its group and output. Once `gone`, it sends no more reports.
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
        self.end()
        self._selector.close()
        for pipe in (self._process.stdin, self._process.stdout, self._process.stderr):
            if pipe is not None:
                with contextlib.suppress(BrokenPipeError):
                    pipe.close()
        self.box.close()

    @property
    def age(self) -> float:
        """Time since the start of the guarded process (s)."""
        return time.monotonic() - self._began

    @property
    def processor_time(self) -> float:
        return processor_time(self.pid)

    @property
    def is_waiting(self) -> bool:
        """Whether the guarded process is neither running nor ready to run; true where that is not reported."""
        try:
            # the format is "pid (name) state ..", and a name may contain brackets
            with open(f"/proc/{self.pid}/stat", "rb", buffering=0) as file:
                return not file.read().rpartition(b")")[2].lstrip().startswith(b"R")
        except OSError:
            return True

    @property
    def output_tail(self) -> str:
        """The last kilobytes that the guarded process wrote to standard output and standard error."""
        return self._tail.decode(errors="replace")

    @property
    def memory(self) -> int:
        return resident_memory(self.pid)

    @property
    def has_exit_status(self) -> bool:
        return self._process.returncode is not None

    def start(self, arguments: dict[str, Any]) -> None:
        """Begin the job of the guarded process with `arguments`."""
        # pickle preserves all types on the way in; results return as JSON, because FMUs run there and are not trusted
        self.order(pickle.dumps(arguments).hex())

    def order(self, line: str) -> None:
        """Send a line of text to the guarded process; no effect if it has gone."""
        with contextlib.suppress(BrokenPipeError):
            os.write(_fd(self._process.stdin), line.encode() + b"\n")

    def reports(self, timeout: float) -> list[dict[str, Any]]:
        """Return the guarded process's reports since the last call, after waiting at most `timeout` (s) for news."""
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
        """Whether the process has ended, even while a process that it started keeps its pipe open."""
        # macOS has waitid from Python 3.13 on; before, the limit on a step's time ends such a process
        if not hasattr(os, "waitid"):
            return False
        # not reaped, so that its pid, which is also the id of its group, is not reused
        return os.waitid(os.P_PID, self.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT) is not None

    def end(self) -> int:
        """End the process and all that it started; return its exit status (its own if ended), negative for a signal."""
        if not self.has_exit_status:
            # not reaped yet, so its pid cannot have been reused
            with contextlib.suppress(ProcessLookupError, PermissionError):
                (os.kill if self._helper else os.killpg)(self.pid, signal.SIGKILL)
            self._process.wait()
            while self._selector.get_map() and self._selector.select(0):
                self.reports(0)
        return self._process.returncode


def resident_memory(pid: int) -> int:
    """Return the resident memory of the process `pid` (bytes); 0 if it has ended or the system does not report it."""
    try:
        # called several times a run; pathlib would take longer than the rest
        with open(f"/proc/{pid}/statm", "rb", buffering=0) as file:
            return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except OSError:
        return 0


def processor_time(pid: int) -> float:
    """Return the processor time of the process `pid` (s); infinity where the system does not report it."""
    try:
        # Linux: the id of the clock follows from the pid (clock_getcpuclockid)
        return time.clock_gettime(cpu_clock(pid)) if sys.platform == "linux" else math.inf
    except OSError:
        return math.inf


def cpu_clock(pid: int) -> int:
    """Return the id of the processor-time clock of the process `pid` (linux/posix-timers.h: CPUCLOCK_SCHED)."""
    return ~pid << 3 | 2


def _fd(pipe: Any) -> int:
    return pipe.fileno()


_waiting: dict[str, GuardedProcess] = {}


def start_ahead(job: str) -> None:
    """Start a process for `job` in advance, before it is known whether it will be needed."""
    _waiting[job] = GuardedProcess(job)


def claim_process(job: str) -> GuardedProcess | None:
    """Return the process started in advance for `job`, or None; end all others started in advance."""
    found = _waiting.pop(job, None)
    end_waiting()
    return found


def process_for(job: str) -> GuardedProcess:
    """Return the process started in advance for `job`, or a new one; end all others started in advance."""
    return claim_process(job) or GuardedProcess(job)


def end_waiting() -> None:
    """End all processes started in advance that were not claimed."""
    while _waiting:
        _waiting.popitem()[1].close()
