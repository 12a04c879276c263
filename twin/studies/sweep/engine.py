"""Engines that run the runs of a sweep: the protocol, and the local engine with warm processes on this machine."""

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
"""A run and its `run_fields`."""


@dataclass(frozen=True)
class Job:
    """Data shared by all runs of a sweep, as sent to its worker processes.

    Attributes:
        recordings: folder for the recordings, one subfolder per run.
        record: runs to record, "all", "failures" or `"none"`.
        claims: "fig4" or "", see `SweepFile`.
        trial: function that makes a run and returns its `run_fields`, "module:function"; same signature as the default.
        here: working directory of all runs.
        files: (drive, text settings) of a run -> expected `files_digest`; a worker refuses runs whose files differ.
            Empty to skip the check.
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
    """Interface of an executor of a sweep's runs, reusable for several sweeps."""

    def results(self, job: Job, tasks: Sequence[Task]) -> Generator[list[Result]]:
        """Make each run of a sweep exactly once and yield the results in batches as they arrive, in any order.

        A run that fails, crashes or hangs yields a result like any other; a result never depends on the process, the
        order or the preceding runs. Closing the generator ends everything it started; runs in progress are lost. Ctrl-C
        is raised within 0.1 s, see `raise_interrupt`.

        Raises:
            TwinError: no run can continue, for example because the disk is full or the cluster is gone.
            KeyboardInterrupt: Ctrl-C.
        """


class LocalEngine:
    def __init__(self, processes: int):
        self._processes = processes

    def results(self, job: Job, tasks: Sequence[Task]) -> Generator[list[Result]]:
        with run_pool(job, min(self._processes, len(tasks))) as pool:
            for batch in pool.answers(tasks):
                if batch:
                    yield batch
                else:
                    raise_interrupt()


def run_pool(job: Job, processes: int) -> Pool[Task, dict[str, Any]]:
    return Pool(processes, WORKER_JOB, job.limits, functools.partial(run_facts, job))


def run_facts(job: Job, process: WarmProcess, task: Task) -> dict[str, Any]:
    """Make one run of a sweep in a worker process and return the fields of its row.

    A process may die because earlier runs damaged its memory: the run is then repeated in a fresh process, so that its
    result never depends on those earlier runs. A failure that must be recorded is also repeated, with the recorder.
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
