"""Guarded processes forked from one that has imported what they need, where each would import for half a second.

`python -m tests.warm FD` is the process that they are forked from. It does nothing else, so each begins as a fresh one
does, and hands them over: they become children of the tests' process, which waits for them as for its own.
"""

import ctypes
import fcntl
import importlib
import json
import os
import socket
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from typing import Any

from twin.kernel.process import child
from twin.kernel.process.process import THREAD_LIMITS, environment, module_command

IMPORTED = (
    "twin.robot.live.runs", "twin.kernel.process.reporter", "twin.robot.assembly.isolated_drive",
    "twin.studies.sweep.worker",
    "twin.studies.check.job", "twin.report.page.picture", "tests.kernel.process.jobs",
    "twin.studies.qualify.qualification", "twin.studies.qualify.text", "scipy.linalg", "scipy.optimize",
    "scipy.stats", "lxml.etree",
)  # fmt: skip
GUARDED = module_command(child.__name__)
_PR_SET_CHILD_SUBREAPER = 36
_MOST = 1 << 16


class WarmStart:
    """Takes the place of `subprocess.Popen` where guarded processes are started."""

    def __init__(self) -> None:
        self._env = _lasting({**THREAD_LIMITS, **environment()})
        self._source: socket.socket | None = None

    def __call__(self, command: Sequence[str], **settings: Any) -> Any:
        """`subprocess.Popen(command, **settings)`; a `Forked` where that makes no difference but in time."""
        guarded = list(command[: len(GUARDED)]) == GUARDED
        if sys.platform != "linux" or not guarded or _lasting(settings["env"]) != self._env:
            return subprocess.Popen(command, **settings)
        if self._source is None:
            # what our children leave behind becomes ours
            ctypes.CDLL(None).prctl(_PR_SET_CHILD_SUBREAPER, 1)
            self._source, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
            with theirs:
                source = module_command(__name__, str(theirs.fileno()))
                subprocess.Popen(source, pass_fds=[theirs.fileno()], env=settings["env"])
        return Forked(self._source, command[len(GUARDED) :], **settings)


class Forked:
    """A forked process, as far as `subprocess.Popen` is used for guarded ones."""

    def __init__(
        self,
        source: socket.socket,
        arguments: Sequence[str],
        stderr: int | None,
        pass_fds: Sequence[int],
        start_new_session: bool,
        **usual: Any,
    ):
        self.returncode: int | None = None
        orders, self.stdin = _pipe()
        self.stdout, reports = _pipe(reading=True)
        # a helper tells who started it
        self.stderr: Any = None
        told = 2
        if stderr == subprocess.PIPE:
            self.stderr, told = _pipe(reading=True)
        begun, theirs = os.pipe()
        asked = {
            "arguments": list(arguments),
            "folder": os.getcwd(),
            "session": start_new_session,
            "parent": os.getpid(),
            "numbers": [0, 1, 2, *pass_fds],
        }
        socket.send_fds(source, [json.dumps(asked).encode()], [theirs, orders, reports, told, *pass_fds])
        for fd in {theirs, orders, reports, told} - {2}:
            os.close(fd)
        with open(begun, "rb") as answer:
            self.pid = int(answer.read())

    def wait(self) -> int:
        if self.returncode is None:
            self.returncode = os.waitstatus_to_exitcode(os.waitpid(self.pid, 0)[1])
        return self.returncode


def _pipe(reading: bool = False) -> tuple[Any, Any]:
    """The end that is read and the one that is written; ours, a file, is the former if `reading`."""
    read, write = os.pipe()
    return (open(read, "rb", 0), write) if reading else (read, open(write, "wb", 0))


def _lasting(env: Mapping[str, str]) -> dict[str, str]:
    """The variables that are the same in all tests, unless one changes them."""
    return {name: value for name, value in env.items() if name != "PYTEST_CURRENT_TEST"}


def main() -> None:
    """Fork a process whenever one is asked for, until nobody is left to ask."""
    source = socket.socket(fileno=int(sys.argv[1]))
    for module in IMPORTED:
        importlib.import_module(module)
    while True:
        asked, fds, *_ = socket.recv_fds(source, _MOST, 16)
        if not asked:
            return
        between = os.fork()
        if not between:
            if os.fork():
                os._exit(0)
            source.close()
            _begin(fds, **json.loads(asked))
        os.waitpid(between, 0)
        for fd in fds:
            os.close(fd)


def _begin(
    fds: Sequence[int], arguments: Sequence[str], folder: str, session: bool, parent: int, numbers: Sequence[int]
) -> None:
    """What the system does for a process that is started, then what that does."""
    above = max(*fds, *numbers) + 1
    begun, *given = [fcntl.fcntl(fd, fcntl.F_DUPFD_CLOEXEC, above) for fd in fds]
    os.closerange(3, above)
    for fd, number in zip(given, numbers, strict=True):
        os.dup2(fd, number)
        os.close(fd)
    os.chdir(folder)
    if session:
        os.setsid()
    while os.getppid() != parent:
        time.sleep(0.0005)
    os.write(begun, str(os.getpid()).encode())
    os.close(begun)
    sys.argv[1:] = arguments
    child.main()


if __name__ == "__main__":
    main()
