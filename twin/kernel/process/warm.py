"""Warm processes, which keep imports, compiled code and unpacked FMUs from one answer to the next."""

import queue
import threading
from collections.abc import Callable, Generator, Mapping, Sequence
from typing import Any, Generic, Self, TypeVar

from twin.kernel.process.guard import POLL_INTERVAL, Watchdog, raise_failure
from twin.kernel.process.job import JobLimits
from twin.kernel.process.process import GuardedProcess, process_for

BATCH_TIMEOUT = 0.1
"""Maximum time (s) that `Pool.answers` waits for a batch."""
MEMORY_SHARE = 0.5
"""Maximum share of the memory limit at the end of an answer. Above it the next answer gets a fresh process, so that it
is not charged for memory used before."""

Task = TypeVar("Task")
Answer = TypeVar("Answer")


class WarmProcess:
    """A guarded process that stays alive to do one job again and again; a context manager that ends it.

    A crash, a hang or a limit costs the answer in progress and nothing else: the next one gets a fresh process. `check`
    is called at least every `POLL_INTERVAL` s during an answer; an exception gives the answer up.
    """

    def __init__(self, job: str, limits: JobLimits, check: Callable[[], None] = lambda: None):
        self._job, self._limits, self._check = job, limits, check
        self._process: GuardedProcess | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *failure: object) -> None:
        self.close()

    def close(self) -> None:
        """End the warm process; a later answer gets a new process."""
        if self._process:
            self._process.close()
        self._process = None

    @property
    def fresh(self) -> bool:
        """Whether the next answer is the first one of a new process."""
        return self._process is None

    @property
    def memory(self) -> int:
        """Resident memory of the warm process (bytes); 0 without a process, or where the system does not report it."""
        return self._process.memory if self._process else 0

    def answer(self, arguments: Mapping[str, Any]) -> Any:
        """Run the job in the warm process, called with `arguments`, and return its result, through JSON.

        JobFailure, JobLoadFailure: the process ended, or exceeded a limit. TwinError: the job or `check` raised one.
        """
        if self._process is None:
            self._process = process_for(self._job)
            self._watch = Watchdog(self._process, self._limits)
        process = self._process
        process.start(dict(arguments))
        try:
            while True:
                for report in process.reports(POLL_INTERVAL):
                    self._watch.account.update(report)
                    raise_failure(report)
                    if "finished" in report:
                        if process.memory > MEMORY_SHARE * self._limits.memory:
                            self.close()
                        return report["finished"]
                self._watch.raise_if_over()
                self._check()
        except BaseException:
            self.close()
            raise


class _PoolShutdown(Exception):
    """Exception that the pool of processes has been closed."""


class Pool(Generic[Task, Answer]):
    """Pool of `count` reusable guarded processes, one thread each; a context manager that ends them, busy or not.

    A process starts with its first task; `ask` returns the answer to a task.
    """

    def __init__(self, count: int, job: str, limits: JobLimits, ask: Callable[[WarmProcess, Task], Answer]):
        self._job, self._limits, self._ask = job, limits, ask
        self._waiting: queue.SimpleQueue[tuple[Task, queue.SimpleQueue[Any]] | None] = queue.SimpleQueue()
        self._stopping = threading.Event()
        self._threads = [threading.Thread(target=self._serve) for _ in range(count)]

    def __enter__(self) -> Self:
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(self, *failure: object) -> None:
        self._stopping.set()
        for _ in self._threads:
            self._waiting.put(None)
        for thread in self._threads:
            thread.join()

    def answers(self, tasks: Sequence[Task]) -> Generator[list[tuple[Task, Answer]]]:
        """Distribute tasks; yield each with its answer, in batches as they complete, then raise `ask`'s exception."""
        done: queue.SimpleQueue[Any] = queue.SimpleQueue()
        for task in tasks:
            self._waiting.put((task, done))
        left = len(tasks)
        while left:
            batch = _batch(done)
            left -= len(batch)
            yield batch

    def _raise_if_stopping(self) -> None:
        if self._stopping.is_set():
            raise _PoolShutdown

    def _serve(self) -> None:
        """Answer tasks of the pool in one thread, which starts its own process, as processes die with their starter."""
        with WarmProcess(self._job, self._limits, self._raise_if_stopping) as process:
            while (item := self._waiting.get()) is not None and not self._stopping.is_set():
                task, done = item
                try:
                    done.put((task, self._ask(process, task)))
                except _PoolShutdown:
                    return
                # includes an interrupt of the process, which would be lost with this thread
                except BaseException as problem:
                    done.put(problem)
                    return


def _batch(done: "queue.SimpleQueue[Any]") -> list[Any]:
    """Return all answers that have arrived; raise an exception if it is the first to arrive."""
    batch: list[Any] = []
    try:
        found = done.get(timeout=BATCH_TIMEOUT)
        while not isinstance(found, BaseException):
            batch.append(found)
            found = done.get_nowait()
    except queue.Empty:
        return batch
    if not batch:
        raise found
    done.put(found)
    return batch
