"""`twin explore` as a program, for a browser."""

import os
import re
import signal
import subprocess
import sys
from pathlib import Path
from types import TracebackType

from twin.kernel.process.process import environment

READY = 60.0
"""How long (s) it may take to begin: compiled code may be missing."""


class Explorer:
    """The program, in a folder of its own; a context manager that ends it.

    Args:
        folder: where it is started.
        words: behind `twin explore`.
        port: 0: any that is free.

    Attributes:
        address: with the token, as it is printed.
        origin: of its pages.
    """

    def __init__(self, folder: Path, *words: str, port: int = 0):
        command = [sys.executable, "-m", "twin", "explore", *words, "--no-browser", "--port", str(port)]
        self.process = subprocess.Popen(
            command, cwd=folder, env=environment(), stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
        )
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        found = re.search(r"http://\S+", line)
        assert found, line + self.process.stdout.read()
        self.address = found.group()
        self.origin = self.address.partition("/?")[0]

    @property
    def port(self) -> int:
        return int(self.origin.rpartition(":")[2])

    def __enter__(self) -> "Explorer":
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.kill(signal.SIGINT)

    def kill(self, how: int = signal.SIGKILL) -> int:
        """End it; its exit code."""
        if self.process.poll() is None:
            os.kill(self.process.pid, how)
        code = self.process.wait(READY)
        assert self.process.stdout is not None
        self.process.stdout.close()
        return code
