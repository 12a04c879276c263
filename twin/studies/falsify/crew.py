"""Warm workers that are given one batch of runs after the other: each batch depends on what the one before came to."""

import threading
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from pathlib import Path
from queue import SimpleQueue
from typing import Any

from twin.runs.guard.limits import Limits
from twin.studies.sweep.plan import Task
from twin.studies.sweep.pool import Job, WorkerProcess

TRIAL = "twin.studies.falsify.trial:judged"


class Crew:
    """See `crew`."""

    def __init__(self, idle: "SimpleQueue[WorkerProcess]", threads: ThreadPoolExecutor, stopping: threading.Event):
        self._idle, self._threads, self._stopping = idle, threads, stopping
        self._count = 0

    def findings(self, files: Sequence[Path]) -> list[dict[str, Any]]:
        """What the experiments in `files` come to, in their order, whoever ran them: facts of `RunFinding`."""
        return list(self._threads.map(self._finding, files))

    def _finding(self, file: Path) -> dict[str, Any]:
        worker = self._idle.get()
        try:
            facts = worker.facts(Task(0, "", None, {}, (str(file.absolute()),)), self._stopping)
            return facts or {}
        finally:
            self._idle.put(worker)


@contextmanager
def crew(folder: Path, processes: int, limits: Limits = Limits()) -> Iterator[Crew]:  # noqa: B008, it is frozen
    """`processes` warm workers, which end when the block does.

    Args:
        folder: where the files are that they run.
        limits: of each worker.
    """
    job = Job(folder, folder, "none", limits, "", trial=TRIAL)
    idle: SimpleQueue[WorkerProcess] = SimpleQueue()
    stopping = threading.Event()
    with ExitStack() as ends:
        for _ in range(processes):
            worker = WorkerProcess(job)
            ends.callback(worker.close)
            idle.put(worker)
        threads = ends.enter_context(ThreadPoolExecutor(processes))
        # before the pool waits for its threads: what runs then is given up
        ends.callback(stopping.set)
        yield Crew(idle, threads, stopping)
