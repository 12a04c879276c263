"""Engines of a sweep, and the local one, whose runs live in warm processes of this machine."""

import functools
from collections.abc import Generator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from twin.kernel.process.guard import JobFailure, JobLoadFailure
from twin.kernel.process.job import JobLimits
from twin.kernel.process.warm import Pool, WarmProcess
from twin.studies.sweep import WORKER_JOB
from twin.studies.sweep.interrupts import raise_interrupt
from twin.studies.sweep.measures import failure
from twin.studies.sweep.plan import Task, text_settings

Result = tuple[Task, dict[str, Any]]
"""A run and the facts of its `RunFinding`."""


@dataclass(frozen=True)
class Job:
    """Data that all runs of a sweep have in common.

    Attributes:
        experiment: its file.
        recordings: the folder in which a run's recording gets a folder of its own.
        record: which runs are recorded, "all", "failures" or "none".
        claims: "fig4" or "", see `SweepFile`.
        limits: of each worker process.
        trial: function that runs a run and returns its `RunFinding`, "module:function"; called like the default.
        here: the working directory of all runs.
        files: drive and texts of a run -> `files_digest`, without which a worker runs nothing; empty: not checked.
    """

    experiment: Path
    recordings: Path
    record: str
    limits: JobLimits
    claims: str
    trial: str = "twin.studies.sweep.worker:trial"
    here: Path = field(default_factory=Path.cwd)
    files: Mapping[tuple[str | None, tuple[str, ...]], str] = field(default_factory=dict)

    def arguments(self, task: Task, record: str) -> dict[str, Any]:
        """Arguments of `twin.studies.sweep.worker.run_task` for a run."""
        return {
            "here": str(self.here),
            "experiment": str(self.here / self.experiment),
            "folder": str(self.here / self.recordings / f"{task.run:06d}"),
            "claims": self.claims,
            "trial": self.trial,
            "drive": task.drive,
            "settings": task.settings,
            "record": record,
            "files": self.files[task.drive, text_settings(task.settings)] if self.files else "",
        }


class Engine(Protocol):
    """Runs runs somewhere. It may be used again when one sweep is over."""

    def results(self, job: Job, tasks: Sequence[Task]) -> Generator[list[Result]]:
        """Yield every one of `tasks` exactly once, in any order, in batches as they come.

        A run that fails, crashes or hangs is a result like any other; a result never depends on where, in which order
        or after which others its run was made. Closing the generator ends everything it started; runs in progress are
        lost. Ctrl-C is raised within 0.1 s, see `raise_interrupt`.

        Raises:
            TwinError: no run can go on, for example because the disk is full or the cluster is gone.
            KeyboardInterrupt: Ctrl-C.
        """


class LocalEngine:
    """An `Engine` of `processes` processes on this machine."""

    def __init__(self, processes: int):
        self._processes = processes

    def results(self, job: Job, tasks: Sequence[Task]) -> Generator[list[Result]]:
        """See `Engine`."""
        with run_pool(job, min(self._processes, len(tasks))) as pool:
            for batch in pool.answers(tasks):
                if batch:
                    yield batch
                else:
                    raise_interrupt()


def run_pool(job: Job, processes: int) -> Pool[Task, dict[str, Any]]:
    """Return a pool of processes for runs; the answers are those of `run_facts`."""
    return Pool(processes, WORKER_JOB, job.limits, functools.partial(run_facts, job))


def run_facts(job: Job, process: WarmProcess, task: Task) -> dict[str, Any]:
    """Return the facts of the `RunFinding` of `task`.

    A process may die because earlier runs damaged its memory: then the run is repeated in a fresh one, so that it never
    depends on those before it. A failure that has to be recorded is repeated, too, with the recorder.

    Raises:
        TwinError: no run of the job can go on.
    """
    record = job.record
    while True:
        fresh = process.fresh
        try:
            facts: dict[str, Any] = process.answer(job.arguments(task, record))
        except (JobFailure, JobLoadFailure) as ended:
            if fresh and record != "failures":
                return failure(str(ended))
            record = "all" if record == "failures" else record
        else:
            return facts
