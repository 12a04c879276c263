"""A warm worker process, and another one as soon as that has died or grown."""

import json
import os
import tempfile
import threading
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from twin.runs.guard.ahead import process_for
from twin.runs.guard.guard import POLL, JobEnded, JobEndedLoading, Watch, raise_failure
from twin.runs.guard.process import GuardedProcess
from twin.studies.left_behind import ORDERS, hold
from twin.studies.sweep import SERVED
from twin.studies.sweep.engine import Job
from twin.studies.sweep.measures import failure
from twin.studies.sweep.plan import Task


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
        self._watch = Watch(self._process, self._job.limits)
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
