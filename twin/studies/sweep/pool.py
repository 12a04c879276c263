"""Engines of a sweep, and the local one: a thread per warm worker process; Ctrl-C."""

import json
import os
import queue
import signal
import tempfile
import threading
from collections.abc import Generator, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Any, Protocol

from twin.kernel.process.guard import POLL, JobEnded, JobEndedLoading, Watchdog, raise_failure
from twin.kernel.process.job import INTERRUPTED, JobLimits
from twin.kernel.process.process import GuardedProcess, process_for
from twin.studies.left_behind import ORDERS, hold
from twin.studies.sweep import SERVED
from twin.studies.sweep.measures import failure
from twin.studies.sweep.plan import Task

HEAR = 0.1
"""Longest time (s) that a sweep waits for anything before it asks whether Ctrl-C was pressed."""
PATIENCE = 3
"""So many times Ctrl-C in one sweep end the process, whatever it is doing."""


class _Presses:
    """Those of one sweep: one entry each. To append is one step; a counter would lose one that falls into the other."""

    def __init__(self) -> None:
        self.noted: list[int] = []
        self.raised = False

    def note(self, number: int, frame: FrameType | None) -> None:
        self.noted.append(number)
        if len(self.noted) >= PATIENCE:
            # what this process has started ends with it; rows are written as they come
            os.write(2, b"\ninterrupted; finished runs are kept\n")
            os._exit(INTERRUPTED)


_presses = _Presses()


@contextmanager
def remembered() -> Iterator[None]:
    """Meanwhile Ctrl-C is noted, and `raise_if_pressed` says so; the third one ends the process.

    Elsewhere than in the main thread there is no Ctrl-C, and nothing to remember. Nor is there where it was ignored or
    somebody else, a notebook's kernel say, has an answer of his own.

    Raises:
        KeyboardInterrupt: at the end, if it was pressed and not raised yet.
    """
    global _presses
    if not _ours() or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield
        return
    _presses = _Presses()
    signal.signal(signal.SIGINT, _presses.note)
    try:
        yield
        raise_if_pressed()
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)
        _presses = _Presses()


def raise_if_pressed() -> None:
    """Raise KeyboardInterrupt if Ctrl-C was pressed; once in a sweep, so that nothing disturbs its end."""
    if _ours() and _presses.noted and not _presses.raised:
        _presses.raised = True
        raise KeyboardInterrupt


def _ours() -> bool:
    return threading.current_thread() is threading.main_thread()


Result = tuple[Task, dict[str, Any]]
"""A run and the facts of its `Finding`."""


@dataclass(frozen=True)
class Job:
    """What all runs of a sweep have in common.

    Attributes:
        experiment: its file.
        recordings: the folder in which a run's recording gets a folder of its own.
        record: of which runs, "all", "failures" or "none".
        claims: "fig4" or "", see `Definition`.
        limits: of each worker process.
        trial: who runs a run and says what it comes to, "module:function"; called like the default.
    """

    experiment: Path
    recordings: Path
    record: str
    limits: JobLimits
    claims: str
    trial: str = "twin.studies.sweep.worker:trial"

    @property
    def arguments(self) -> dict[str, str]:
        """Of `twin.studies.sweep.worker.served`, but for the orders; absolute, because an FMU may change the folder."""
        return {
            "experiment": str(self.experiment.absolute()),
            "folder": str(self.recordings.absolute()),
            "claims": self.claims,
            "trial": self.trial,
        }


class Engine(Protocol):
    """Runs runs somewhere. It may be used again when one sweep is over."""

    def results(self, job: Job, tasks: Sequence[Task]) -> Generator[list[Result]]:
        """Every one of `tasks` exactly once, in any order, in batches as they come.

        A run that fails, crashes or hangs is a result like any other; what comes out of a run must not depend on where,
        in which order or after which others it is run. Closing the iterator ends everything that it began; runs that
        are under way then are lost. A caller that waits here asks `raise_if_pressed` at least every `HEAR` seconds.

        Raises:
            TwinError: no run can go on, say because the disk is full or the cluster is gone.
            KeyboardInterrupt: Ctrl-C.
        """


class WorkerProcess:
    """Runs one run after the other in a guarded process, of which nothing is left when it is closed.

    Args:
        job: what the runs have in common.
    """

    def __init__(self, job: Job):
        self._job = job
        self._process: GuardedProcess | None = None
        self._ends = ExitStack()

    def close(self) -> None:
        """End the process; the next run gets a fresh one."""
        self._ends.close()
        self._process = None

    @property
    def memory(self) -> int:
        """Resident memory of the process (bytes); 0 if there is none, or the system does not tell."""
        return self._process.memory if self._process else 0

    def facts(self, task: Task, stopping: threading.Event) -> dict[str, Any] | None:
        """The facts of the `Finding` that `task` comes to; None if `stopping` was set meanwhile.

        A process that dies may do so of what earlier runs did to its memory: then the run gets another chance in a
        fresh one. So what becomes of a run never depends on those before it. A failure that is to be recorded is known
        to be one only after that, and gets another chance for the recorder to be there.

        Raises:
            TwinError: the job cannot go on, with any run.
        """
        record = self._job.record
        while True:
            fresh = self._process is None
            process = self._process or self._started()
            try:
                facts = self._answer(process, task, record, stopping)
            except (JobEnded, JobEndedLoading) as ended:
                self.close()
                if fresh and record != "failures":
                    return failure(str(ended))
                record = "all" if record == "failures" else record
            else:
                # a fresh process is better than to charge a run with what others left in this one
                if process.memory > 0.5 * self._job.limits.memory:
                    self.close()
                return facts

    def _started(self) -> GuardedProcess:
        orders = Path(self._ends.enter_context(tempfile.TemporaryDirectory(prefix=ORDERS))) / "orders"
        # both ends, so that a process that dies leaves no broken pipe
        self._orders = hold(orders)
        self._ends.callback(os.close, self._orders)
        self._process = self._ends.enter_context(process_for(SERVED))
        self._watch = Watchdog(self._process, self._job.limits)
        self._process.start({**self._job.arguments, "orders": str(orders)})
        return self._process

    def _answer(
        self, process: GuardedProcess, task: Task, record: str, stopping: threading.Event
    ) -> dict[str, Any] | None:
        order = {"run": task.run, "drive": task.drive, "settings": task.settings, "record": record}
        os.write(self._orders, json.dumps(order).encode() + b"\n")
        while not stopping.is_set():
            for report in process.reports(POLL):
                self._watch.account.take(report)
                raise_failure(report)
                if "note" in report:
                    return report["note"]["finding"]
            self._watch.raise_if_over()
        return None


class Pool:
    """An `Engine` of `processes` processes on this machine."""

    def __init__(self, processes: int):
        self._processes = processes

    def results(self, job: Job, tasks: Sequence[Task]) -> Generator[list[Result]]:
        """See `Engine`."""
        waiting: queue.SimpleQueue[Task] = queue.SimpleQueue()
        for task in tasks:
            waiting.put(task)
        done: queue.SimpleQueue[Result | Exception] = queue.SimpleQueue()
        stopping = threading.Event()

        def work() -> None:
            try:
                with closing(WorkerProcess(job)) as worker, suppress(queue.Empty):
                    while not stopping.is_set():
                        task = waiting.get_nowait()
                        if (facts := worker.facts(task, stopping)) is not None:
                            done.put((task, facts))
            except Exception as problem:
                done.put(problem)

        threads = [threading.Thread(target=work) for _ in range(min(self._processes, len(tasks)))]
        for thread in threads:
            thread.start()
        try:
            left = len(tasks)
            while left:
                batch = _batch(done)
                left -= len(batch)
                yield batch
        finally:
            stopping.set()
            for thread in threads:
                thread.join()


def _batch(done: "queue.SimpleQueue[Result | Exception]") -> list[Result]:
    """All that has come since the last call, at least one; what is finished comes before a failure is raised."""
    batch: list[Result] = []
    while not batch or not done.empty():
        try:
            result = done.get(timeout=HEAR)
        except queue.Empty:
            raise_if_pressed()
            continue
        if not isinstance(result, Exception):
            batch.append(result)
        elif not batch:
            raise result
        else:
            done.put(result)
            break
    return batch
