"""Worker processes and who feeds them: a thread per process, so that each is watched closely and costs only itself."""

import json
import os
import queue
import tempfile
import threading
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from twin.errors import TwinError
from twin.guard.guard import POLL, JobDied, JobDiedLoading, Watch, raise_failure
from twin.guard.limits import Limits
from twin.guard.process import GuardedProcess
from twin.sweep.measures import Finding
from twin.sweep.plan import Task

JOB = "twin.sweep.worker:served"
Result = tuple[Task, dict[str, Any]]
"""A run and the facts of its `Finding`."""


class Worker:
    """A guarded process that runs what it is given; a context manager at whose exit nothing of it is left."""

    def __init__(self, arguments: dict[str, str], limits: Limits, folder: Path):
        orders = folder / f"orders_{threading.get_ident()}"
        orders.unlink(missing_ok=True)
        os.mkfifo(orders)
        # both ends, so that opening does not wait for the process, and a process that dies leaves no broken pipe
        self._orders = os.open(orders, os.O_RDWR)
        self._limits = limits
        self._process = GuardedProcess(JOB)
        self._watch = Watch(self._process, limits)
        self._process.start({**arguments, "orders": str(orders)})

    def __enter__(self) -> "Worker":
        return self

    def __exit__(self, *failure: object) -> None:
        self._process.close()
        os.close(self._orders)

    @property
    def tired(self) -> bool:
        """Whether it has grown so much that a fresh one is better than to charge a run with what others left."""
        return self._process.memory > 0.5 * self._limits.memory

    def facts(self, task: Task, stopping: threading.Event) -> dict[str, Any] | None:
        """Run `task`; None if `stopping` was set meanwhile.

        Raises:
            JobDied, JobDiedLoading: the process has ended, and who did it.
            TwinError: the job cannot go on, with any run.
        """
        order = {"run": task.run, "drive": task.drive, "settings": task.settings}
        os.write(self._orders, json.dumps(order).encode() + b"\n")
        while not stopping.is_set():
            for report in self._process.reports(POLL):
                self._watch.account.take(report)
                raise_failure(report)
                if "note" in report:
                    return report["note"]["finding"]
            self._watch.raise_if_over()
        return None


class Pool:
    """Runs `tasks` in `processes` processes.

    Args:
        arguments: of `twin.sweep.worker.served`, but for the orders. limits: of one process.
    """

    def __init__(self, tasks: Sequence[Task], processes: int, arguments: dict[str, str], limits: Limits):
        self._tasks = iter(tasks)
        self._count = len(tasks)
        self._processes = min(processes, len(tasks))
        self._arguments, self._limits = arguments, limits
        self._lock = threading.Lock()
        self._stopping = threading.Event()
        self._results: queue.SimpleQueue[Result | Exception] = queue.SimpleQueue()

    def results(self) -> Iterator[list[Result]]:
        """Every run once, in batches as they come.

        Raises:
            TwinError: no run can go on, say because the disk is full.
        """
        with tempfile.TemporaryDirectory(prefix="twin_sweep_") as folder:
            threads = [threading.Thread(target=self._feed, args=(Path(folder),)) for _ in range(self._processes)]
            for thread in threads:
                thread.start()
            try:
                while self._count:
                    batch = [self._next()]
                    while not self._results.empty():
                        batch.append(self._next())
                    self._count -= len(batch)
                    yield batch
            finally:
                self._stopping.set()
                for thread in threads:
                    thread.join()

    def _next(self) -> Result:
        result = self._results.get()
        if isinstance(result, Exception):
            raise result
        return result

    def _feed(self, folder: Path) -> None:
        """The life of a thread: one worker after the other, for as long as there are tasks."""
        try:
            task = self._claimed()
            while task is not None:
                with Worker(self._arguments, self._limits, folder) as worker:
                    task = self._fed(worker, task)
        except Exception as problem:
            self._results.put(problem)

    def _fed(self, worker: Worker, task: Task | None) -> Task | None:
        """The first task that `worker` has not been given, because it is dead or tired; None: there is none left."""
        while task is not None:
            try:
                facts = worker.facts(task, self._stopping)
            except (JobDied, JobDiedLoading) as death:
                self._results.put((task, _fatal(death)))
                return self._claimed()
            if facts is None:
                return None
            self._results.put((task, facts))
            task = self._claimed()
            if worker.tired:
                break
        return task

    def _claimed(self) -> Task | None:
        with self._lock:
            return None if self._stopping.is_set() else next(self._tasks, None)


def _fatal(death: TwinError) -> dict[str, Any]:
    return Finding("failed", str(death), {}, float("nan"), float("nan")).facts
