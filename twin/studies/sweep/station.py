"""A warm worker process, and another one as soon as that has died or grown."""

import json
import os
import tempfile
import threading
from pathlib import Path
from typing import Any

from twin.errors import TwinError
from twin.runs.guard.guard import POLL, JobEnded, JobEndedLoading, Watch, raise_failure
from twin.runs.guard.process import GuardedProcess
from twin.studies.sweep.engine import Job
from twin.studies.sweep.measures import Finding
from twin.studies.sweep.plan import Task

JOB = "twin.studies.sweep.worker:served"


class Station:
    """Runs one run after the other in a guarded process; a context manager at whose exit nothing of it is left.

    Args:
        job: what the runs have in common.
    """

    def __init__(self, job: Job):
        self._job = job
        self._worker: _Worker | None = None

    def __enter__(self) -> "Station":
        return self

    def __exit__(self, *failure: object) -> None:
        self._leave()

    @property
    def memory(self) -> int:
        """Resident memory of the process (bytes); 0 if there is none, or the system does not tell."""
        return self._worker.memory if self._worker else 0

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
            fresh = self._worker is None
            worker = self._worker = self._worker or _Worker(self._job)
            try:
                facts = worker.facts(task, record, stopping)
            except (JobEnded, JobEndedLoading) as failure:
                self._leave()
                if fresh and record != "failures":
                    return _fatal(failure)
                record = "all" if record == "failures" else record
            else:
                # a fresh process is better than to charge a run with what others left in this one
                if worker.memory > 0.5 * self._job.limits.memory:
                    self._leave()
                return facts

    def _leave(self) -> None:
        if self._worker:
            self._worker.close()
            self._worker = None


class _Worker:
    def __init__(self, job: Job):
        self._folder = tempfile.TemporaryDirectory(prefix="twin_sweep_")
        orders = Path(self._folder.name) / "orders"
        os.mkfifo(orders)
        # both ends, so that opening does not wait for the process, and a process that dies leaves no broken pipe
        self._orders = os.open(orders, os.O_RDWR)
        self._process = GuardedProcess(JOB)
        self._watch = Watch(self._process, job.limits)
        self._process.start({**job.arguments, "orders": str(orders)})

    def close(self) -> None:
        self._process.close()
        os.close(self._orders)
        self._folder.cleanup()

    @property
    def memory(self) -> int:
        return self._process.memory

    def facts(self, task: Task, record: str, stopping: threading.Event) -> dict[str, Any] | None:
        """As `Station.facts`.

        Raises:
            JobEnded, JobEndedLoading: the process has ended, and who did it.
        """
        order = {"run": task.run, "drive": task.drive, "settings": task.settings, "record": record}
        os.write(self._orders, json.dumps(order).encode() + b"\n")
        while not stopping.is_set():
            for report in self._process.reports(POLL):
                self._watch.account.take(report)
                raise_failure(report)
                if "note" in report:
                    return report["note"]["finding"]
            self._watch.raise_if_over()
        return None


def _fatal(failure: TwinError) -> dict[str, Any]:
    return Finding("failed", str(failure), {}, float("nan"), float("nan")).facts
