"""A Dask cluster as a user starts it: processes of their own, on the loopback interface."""

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from distributed import Client

CLUSTER = ("--host", "127.0.0.1", "--no-dashboard")


@dataclass
class Running:
    """A scheduler at a port that stays its own, and its workers.

    Attributes:
        root: the repository. folder: for caches, workers and what they print.
    """

    root: Path
    folder: Path
    scheduler: subprocess.Popen[bytes] | None = None
    workers: list[subprocess.Popen[bytes]] = field(default_factory=list)

    def __post_init__(self) -> None:
        with closing(socket.socket()) as free:
            free.bind(("127.0.0.1", 0))
            self.port = free.getsockname()[1]

    @property
    def address(self) -> str:
        return f"tcp://127.0.0.1:{self.port}"

    @property
    def cache(self) -> Path:
        """What the workers have as TWIN_CACHE."""
        return self.folder / "cache"

    def begin(self, workers: int) -> None:
        """Start the scheduler and so many workers, and wait for them."""
        self.scheduler = self._process("scheduler", "--port", str(self.port), *CLUSTER)
        self._wait_for_port()
        self.workers = [self.worker() for _ in range(workers)]
        if workers:
            self.wait(workers)

    def wait(self, workers: int) -> None:
        """Until there are so many workers."""
        with Client(self.address, timeout=60, set_as_default=False) as client:
            client.wait_for_workers(workers, timeout=60)

    def _wait_for_port(self) -> None:
        deadline = time.monotonic() + 60
        while True:
            try:
                socket.create_connection(("127.0.0.1", self.port), 1.0).close()
                return
            except OSError:
                assert time.monotonic() < deadline, (self.folder / "scheduler.log").read_text()
                time.sleep(0.05)

    def worker(self, *before: Path) -> subprocess.Popen[bytes]:
        """One more, whose Python imports from the folders `before` all others."""
        own = ("--nthreads", "1", "--no-nanny", "--local-directory", str(self.folder / "scratch"))
        return self._process("worker", self.address, *own, *CLUSTER, before=before)

    def end(self) -> None:
        for process in filter(None, (*self.workers, self.scheduler)):
            kill(process)
        self.workers, self.scheduler = [], None

    def _process(self, role: str, *arguments: str, before: tuple[Path, ...] = ()) -> subprocess.Popen[bytes]:
        paths = os.pathsep.join(map(str, (*before, self.root)))
        with (self.folder / f"{role}.log").open("ab") as log:
            return subprocess.Popen(
                [sys.executable, "-m", f"distributed.cli.dask_{role}", *arguments],
                env={**os.environ, "PYTHONPATH": paths, "TWIN_CACHE": str(self.cache)},
                stdout=log,
                stderr=log,
                cwd=self.folder,
            )


@contextmanager
def running(root: Path, folder: Path, workers: int) -> Iterator[Running]:
    """A cluster of `workers` workers; nothing of it is left in the end."""
    cluster = Running(root, folder)
    try:
        cluster.begin(workers)
        yield cluster
    finally:
        cluster.end()


def kill(process: subprocess.Popen[bytes]) -> None:
    """As the machine does that runs out of memory or power."""
    process.send_signal(signal.SIGKILL)
    process.wait()
