"""The part of a sweep in a Dask worker: warm child processes make its runs, so that no FMU can harm the worker."""

import threading
from collections.abc import Sequence
from typing import Any

from distributed import Scheduler, SchedulerPlugin, Worker, WorkerPlugin, get_worker

from twin.kernel.errors import InputRefused
from twin.kernel.process.warm import WarmProcess
from twin.studies.sweep import WORKER_JOB
from twin.studies.sweep.dask.cluster import difference, refusal, versions
from twin.studies.sweep.engine import Job, run_facts
from twin.studies.sweep.plan import Task
from twin.studies.sweep.stored import SWEEP_FILE

RunFacts = tuple[int, dict[str, Any]]
"""(run number, its `run_fields`)."""


class _SweepEnd(Exception):
    """Exception that ends the runs of a sweep in a cluster worker: the sweep or the worker has ended."""


class SweepPlugin(WorkerPlugin):
    """Dask worker plugin with one warm process per thread, also installed on workers that join later."""

    def __init__(self, name: str, job: Job):
        self.name, self._job, self._versions = name, job, versions()

    def setup(self, worker: Worker) -> None:
        """Prepare a cluster worker for the sweep and compare its versions; called by Dask."""
        self._who = f"worker {worker.address}"
        self._difference = difference(self._who, versions(), self._versions)
        sweep = self._job.here / self._job.recordings.parent
        unseen = [path for path in (self._job.here, sweep / SWEEP_FILE) if not path.exists()]
        if unseen and not self._difference:
            self._difference = f"{self._who} does not see {unseen[0]}, and needs a folder that all machines share"
        self._stopping, self._lock = threading.Event(), threading.Lock()
        self._processes: dict[int, tuple[threading.Lock, WarmProcess]] = {}

    def teardown(self, worker: Worker) -> None:
        """End the worker's processes of the sweep, even during a run; called by Dask at the end of sweep or worker."""
        self._stopping.set()
        with self._lock:
            for guard, process in self._processes.values():
                with guard:
                    process.close()

    def results(self, tasks: Sequence[Task]) -> list[RunFacts]:
        """Make runs in this worker and return their fields, fewer if the sweep ends; refuse unlike machines, files."""
        if self._difference:
            raise InputRefused(refusal(self._difference))
        with self._lock:
            if self._stopping.is_set():
                return []
            # A child process dies with the thread that started it.
            own = threading.Lock(), WarmProcess(WORKER_JOB, self._job.limits, self._raise_if_stopping)
            guard, process = self._processes.setdefault(threading.get_ident(), own)
        found: list[RunFacts] = []
        try:
            for task in tasks:
                with guard:
                    self._raise_if_stopping()
                    found.append((task.run, run_facts(self._job, process, task)))
        except _SweepEnd:
            pass
        except InputRefused as problem:
            raise InputRefused(f"{self._who}: {problem}") from None
        return found

    def _raise_if_stopping(self) -> None:
        if self._stopping.is_set():
            raise _SweepEnd


class EndPlugin(SchedulerPlugin):
    """Dask scheduler plugin that ends a sweep in all workers when its client is gone, for example killed."""

    def __init__(self, name: str, client: str):
        self.name, self._client = name, client

    def remove_client(self, scheduler: Scheduler, client: str) -> None:
        """End the sweep if the removed client was its own; called by Dask."""
        if client == self._client:
            scheduler.remove_plugin(self.name)
            if self.name in scheduler.worker_plugins:
                scheduler.loop.add_callback(scheduler.unregister_worker_plugin, None, self.name)


def run_tasks(name: str, tasks: Sequence[Task]) -> list[RunFacts]:
    plugin = get_worker().plugins[name]
    assert isinstance(plugin, SweepPlugin)
    return plugin.results(tasks)
