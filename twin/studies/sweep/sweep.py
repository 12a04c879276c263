"""A sweep in progress: missing runs are made, every row is stored as it comes.

Engines of a sweep, and the local one: a thread per warm worker process; Ctrl-C.
"""

import json
import os
import queue
import signal
import tempfile
import threading
import time
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Any, Protocol

from twin.kernel.process.guard import POLL, JobEnded, JobEndedLoading, Watchdog, raise_failure
from twin.kernel.process.job import INTERRUPTED, JobLimits
from twin.kernel.process.process import GuardedProcess, process_for
from twin.studies.left_behind import ORDERS, SCRATCH, held_folder, hold
from twin.studies.sweep import SERVED
from twin.studies.sweep.measures import failure, within
from twin.studies.sweep.plan import SweepPlan, Task
from twin.studies.sweep.rows import ROWS, Columns, Row, RowFile, claim, columns_of
from twin.studies.sweep.statistics.ranking import USUAL_METRICS, best, value

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


RECORDINGS = "runs"
PAUSE = 0.05
"""s. Rows that come meanwhile are written and looked at together; one by one they take from the runs a tenth of the
processor's time."""


@dataclass(frozen=True)
class State:
    """How far a sweep is.

    Attributes:
        done, total: runs with a row, runs planned.
        failed: of those done, without metrics.
        began_with: runs that had a row before.
        elapsed: wall time since then (s).
        best: (metric, value, run) of the best run so far by the usual metric; None: there is none.
    """

    done: int
    total: int
    failed: int
    began_with: int
    elapsed: float
    best: tuple[str, float, int] | None

    @property
    def rate(self) -> float:
        """Runs per second; 0 as long as nothing can be said."""
        return (self.done - self.began_with) / self.elapsed if self.elapsed else 0.0

    @property
    def remaining(self) -> float | None:
        """Wall time to the end (s); None as long as nothing can be said."""
        return (self.total - self.done) / self.rate if self.rate else None


def run_sweep(
    plan: SweepPlan,
    folder: Path,
    engine: Engine,
    record: str = "none",
    limits: JobLimits = JobLimits(),  # noqa: B008, it is frozen
    show: Callable[[State], None] = lambda state: None,
) -> None:
    """Run what of `plan` has no row in `folder` yet.

    Args:
        engine: who runs them.
        record: "all", "failures" or "none"; recordings go to `folder`/runs/NUMBER.
        limits: of each worker process.
        show: called with the state at the beginning and after each batch of rows.

    Raises:
        InputRefused: the folder is another sweep's, or cannot be written.
        DiskFailed, RecordingFailed: the disk is full.
        KeyboardInterrupt: rows until then are kept; so they are with every other end.
    """
    claim(folder, plan)
    with RowFile(folder / ROWS) as rows:
        finished = {*rows.before.words("key").words}
        tasks = [task for task in plan.tasks if task.key not in finished]
        tally = _Tally(len(plan.tasks), rows.before)
        show(tally.state)
        if tasks:
            job = _job(plan, folder, record, limits)
            # closed at once when anything happens here: what an interrupted iterator holds would else live on
            with remembered(), closing(engine.results(job, tasks)) as batches:
                for batch in batches:
                    fresh = [_row(plan, task, facts) for task, facts in batch]
                    rows.add(fresh)
                    tally.take(columns_of(fresh))
                    state = tally.state
                    show(state)
                    raise_if_pressed()
                    if state.done < state.total:
                        time.sleep(PAUSE)


class _Tally:
    """Keeps up with rows, a batch at a time: to look at all of them after each would take ever longer."""

    def __init__(self, total: int, before: Columns):
        self._total, self._before, self._began = total, len(before), time.monotonic()
        self._done = self._failed = 0
        self._best: dict[str, tuple[float, int]] = {}
        self.take(before)

    def take(self, columns: Columns) -> None:
        self._done += len(columns)
        self._failed += columns.words("has_metrics").counts.get(False, 0)
        # of the same value the first run
        columns = columns.by_run()
        for metric in USUAL_METRICS:
            for row in best(columns, metric)[:1]:
                found = float(value(columns, metric)[row]), columns.run(row)
                self._best[metric] = min(found, self._best.get(metric, found))

    @property
    def state(self) -> State:
        found = next(((metric, *self._best[metric]) for metric in USUAL_METRICS if metric in self._best), None)
        elapsed = time.monotonic() - self._began
        return State(self._done, self._total, self._failed, self._before, elapsed, found)


@dataclass(frozen=True)
class SweepEstimate:
    """What runs cost.

    Attributes:
        start: from the start of a worker to the end of its first run (s).
        run: each further one (s).
        size: of each on the disk (bytes).
    """

    start: float
    run: float
    size: float

    def total(self, runs: int, processes: int) -> tuple[float, float]:
        """(wall time in s, bytes) of `runs` runs in `processes` processes that do not slow each other."""
        return self.start + self.run * -(-runs // processes), self.size * runs


def estimated(plan: SweepPlan, record: str, limits: JobLimits = JobLimits()) -> tuple[SweepEstimate, Row]:  # noqa: B008, it is frozen
    """What a run of `plan` costs, and the row of its first one, measured by running it twice and keeping nothing."""
    with held_folder(SCRATCH) as scratch:
        began = time.monotonic()
        job = _job(plan, scratch, record, limits)
        times, rows = [], []
        for batch in Pool(1).results(job, [plan.tasks[0]] * 2):
            times.append(time.monotonic() - began)
            rows += [_row(plan, task, facts) for task, facts in batch]
        size = sum(file.stat().st_size for file in scratch.rglob("*") if file.is_file())
    recorded = size if record == "all" else 0
    return SweepEstimate(times[0], times[-1] - times[0], recorded + len(str(rows[0]))), rows[0]


def _job(plan: SweepPlan, folder: Path, record: str, limits: JobLimits) -> Job:
    return Job(plan.experiment, folder / RECORDINGS, record, limits, plan.definition.claims or "")


def _row(plan: SweepPlan, task: Task, facts: dict[str, Any]) -> Row:
    return {
        "run": task.run,
        "key": task.key,
        "drive": task.drive,
        "parameters": task.parameters,
        **facts,
        "within_limits": within(facts["metrics"], plan.definition.limits),
    }


def state_text(state: State) -> str:
    """`12 of 64 runs  9.1/s  6 s left  1 failed  force_error_N 0.31 (run 7)`."""
    parts = [f"{state.done} of {state.total} runs"]
    if state.remaining is not None:
        parts += [f"{state.rate:.3g}/s", f"{time_text(state.remaining)} left"]
    if state.failed:
        parts.append(f"{state.failed} failed")
    if state.best:
        metric, number, run = state.best
        parts.append(f"{metric} {number:.3g} (run {run})")
    return "  ".join(parts)


def estimate_text(name: str, runs: int, processes: int, estimate: SweepEstimate, first: dict[str, Any]) -> str:
    """What `runs` runs will take, and what that was measured on."""
    seconds, size = estimate.total(runs, processes)
    many = "process" if processes == 1 else "processes"
    reason = f": {first['reason']}" if first["reason"] else ""
    return "\n".join([
        f"{name}  {runs:,} runs, about {time_text(seconds)} in {processes} {many}, {size_text(size)}",
        f"  measured on run 1, {first['status']}{reason}",
        f"  {estimate.run:.3f} s per run in a warm process, {estimate.start:.1f} s until its first one is over",
    ])  # fmt: skip


def time_text(seconds: float) -> str:
    """`45 s`, `12 min` or `3.5 h`."""
    if seconds < 100.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 6000.0 else f"{seconds / 3600:.1f} h"


def size_text(size: float) -> str:
    """Of `size` bytes: `9 kB`, `1.2 MB`."""
    return f"{size / 1e6:,.1f} MB" if size >= 1e6 else f"{max(1.0, size / 1e3):.0f} kB"
