"""Execution of a sweep: missing runs are made, and every row is stored as it arrives."""

import time
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from twin.kernel.process.job import JobLimits
from twin.studies.stale_files import held_folder
from twin.studies.sweep.columns import Columns, Row, columns_of
from twin.studies.sweep.engine import Engine, Job, LocalEngine
from twin.studies.sweep.interrupts import defer_interrupts, raise_interrupt
from twin.studies.sweep.measures import meets_limits
from twin.studies.sweep.plan import SweepPlan, Task
from twin.studies.sweep.rows import ROWS_FILE, RowFile
from twin.studies.sweep.statistics.ranking import USUAL_METRICS, ranked_rows, value
from twin.studies.sweep.stored import claim

RECORDINGS_FOLDER = "runs"
BATCH_PAUSE = 0.05
"""Pause between batches of rows (s); writing and showing them one by one would cost the runs a tenth of the CPU."""


@dataclass(frozen=True)
class SweepState:
    """Progress of a running sweep.

    Attributes:
        done, total: number of runs with a row, and of planned runs.
        failed: number of done runs without metrics.
        began_with: number of runs that had a row at the start.
        elapsed: wall time since the start (s).
        best: (metric, value, run) of the best run so far by the default metric; None if no run has that metric.
    """

    done: int
    total: int
    failed: int
    began_with: int
    elapsed: float
    best: tuple[str, float, int] | None

    @property
    def rate(self) -> float:
        return (self.done - self.began_with) / self.elapsed if self.elapsed else 0.0

    @property
    def remaining(self) -> float | None:
        """Estimated wall time to the end of the sweep (s); None while unknown."""
        return (self.total - self.done) / self.rate if self.rate else None


def run_sweep(
    plan: SweepPlan,
    folder: Path,
    engine: Engine,
    record: str = "none",
    limits: JobLimits = JobLimits(),  # noqa: B008, it is frozen
    show: Callable[[SweepState], None] = lambda state: None,
) -> None:
    """Make the runs of a sweep that have no row in the folder yet, and store each row as it arrives.

    Args:
        record: runs to record, see `Job`; recordings are written to `folder`/runs/NUMBER.
        show: progress callback, called at the start and after each batch of rows.

    Raises:
        InputRefused: the folder belongs to another sweep, or cannot be written.
        DiskError, RecordingFailed: the disk is full.
        KeyboardInterrupt: Ctrl-C. Rows written before are kept, as with every other exception.
    """
    claim(folder, plan)
    with RowFile(folder / ROWS_FILE) as rows:
        finished = {*rows.before.categorical("key").categories}
        tasks = [task for task in plan.tasks if task.key not in finished]
        tally = _Tally(len(plan.tasks), rows.before)
        show(tally.state)
        if tasks:
            job = _job(plan, folder, record, limits)
            # Closed on any exception: an interrupted generator would otherwise keep its processes alive.
            with defer_interrupts(), closing(engine.results(job, tasks)) as batches:
                for batch in batches:
                    fresh = [_row(plan, task, facts) for task, facts in batch]
                    rows.add(fresh)
                    tally.add(columns_of(fresh))
                    state = tally.state
                    show(state)
                    raise_interrupt()
                    if state.done < state.total:
                        time.sleep(BATCH_PAUSE)


class _Tally:
    """Summary of a sweep's rows, updated per batch, because rescanning all rows would take quadratic time."""

    def __init__(self, total: int, before: Columns):
        self._total, self._before, self._began = total, len(before), time.monotonic()
        self._done = self._failed = 0
        self._best: dict[str, tuple[float, int]] = {}
        self.add(before)

    def add(self, columns: Columns) -> None:
        self._done += len(columns)
        self._failed += columns.categorical("has_metrics").counts.get(False, 0)
        # Among equal values the first run wins.
        columns = columns.by_run()
        for metric in USUAL_METRICS:
            for row in ranked_rows(columns, metric)[:1]:
                found = float(value(columns, metric)[row]), columns.run_number(row)
                self._best[metric] = min(found, self._best.get(metric, found))

    @property
    def state(self) -> SweepState:
        found = next(((metric, *self._best[metric]) for metric in USUAL_METRICS if metric in self._best), None)
        elapsed = time.monotonic() - self._began
        return SweepState(self._done, self._total, self._failed, self._before, elapsed, found)


@dataclass(frozen=True)
class SweepEstimate:
    """Estimated cost: a worker's start and first run (s), each further run (s), disk space per run (bytes)."""

    start: float
    run: float
    size: float

    def total(self, runs: int, processes: int) -> tuple[float, float]:
        """Return (wall time (s), bytes) of many runs in several processes that do not slow each other."""
        return self.start + self.run * -(-runs // processes), self.size * runs


def measure_cost(plan: SweepPlan, record: str, limits: JobLimits = JobLimits()) -> tuple[SweepEstimate, Row]:  # noqa: B008, it is frozen
    """Measure the cost of a sweep's run by making the first run twice; return the estimate and the run's row."""
    with held_folder() as scratch:
        began = time.monotonic()
        job = _job(plan, scratch, record, limits)
        times, rows = [], []
        for batch in LocalEngine(1).results(job, [plan.tasks[0]] * 2):
            times.append(time.monotonic() - began)
            rows += [_row(plan, task, facts) for task, facts in batch]
        size = sum(file.stat().st_size for file in scratch.rglob("*") if file.is_file())
    recorded = size if record == "all" else 0
    return SweepEstimate(times[0], times[-1] - times[0], recorded + len(str(rows[0]))), rows[0]


def _job(plan: SweepPlan, folder: Path, record: str, limits: JobLimits) -> Job:
    return Job(plan.experiment, folder / RECORDINGS_FOLDER, record, limits, plan.definition.claims or "")


def _row(plan: SweepPlan, task: Task, facts: dict[str, Any]) -> Row:
    return {
        "run": task.run,
        "key": task.key,
        "drive": task.drive,
        "parameters": task.parameters,
        **facts,
        "within_limits": meets_limits(facts["metrics"], plan.definition.limits),
    }


def state_text(state: SweepState) -> str:
    """Format the progress of a sweep: `12 of 64 runs  9.1/s  6 s left  1 failed  force_error_N 0.31 (run 7)`."""
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
    """Format the estimated time and disk space of a sweep, and the measured run behind the estimate."""
    seconds, size = estimate.total(runs, processes)
    many = "process" if processes == 1 else "processes"
    reason = f": {first['reason']}" if first["reason"] else ""
    return "\n".join([
        f"{name}  {runs:,} runs, about {time_text(seconds)} in {processes} {many}, {size_text(size)}",
        f"  measured on run 1, {first['status']}{reason}",
        f"  {estimate.run:.3f} s per run in a warm process, {estimate.start:.1f} s until its first one is over",
    ])  # fmt: skip


def time_text(seconds: float) -> str:
    """Format a duration: `45 s`, `12 min` or `3.5 h`."""
    if seconds < 100.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 6000.0 else f"{seconds / 3600:.1f} h"


def size_text(size: float) -> str:
    """Format a number of bytes: `9 kB`, `1.2 MB`."""
    return f"{size / 1e6:,.1f} MB" if size >= 1e6 else f"{max(1.0, size / 1e3):.0f} kB"
