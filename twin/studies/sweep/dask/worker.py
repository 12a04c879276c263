"""What happens in a Dask worker: runs, each in a guarded child process, so that no FMU can harm the worker itself."""

import shutil
import tempfile
import threading
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from distributed import Scheduler, SchedulerPlugin, Worker, WorkerPlugin, get_worker

from twin.kernel.errors import InputRefused, disk_refusals
from twin.studies.sweep.dask.bundle import Bundle, laid_out
from twin.studies.sweep.dask.cluster import difference, refusal, versions
from twin.studies.sweep.plan import Task
from twin.studies.sweep.pool import Job, WorkerProcess

FILES = "twin_runner_"
"""Beginning of the name of the folder, below the worker's own, that holds the files of a sweep."""


class RunResult(NamedTuple):
    """What became of a run: its number, the facts of its `Finding`, the files of its recording by name."""

    run: int
    facts: dict[str, Any]
    files: dict[str, bytes]


class SweepPlugin(WorkerPlugin):
    """What a sweep has in each worker, also in one that joins later: its files, and a warm process for each thread.

    Args:
        name: tells the sweep from all others.
        job: what its runs have in common, as on the machine that sends it.
        bundle: its files.
    """

    def __init__(self, name: str, job: Job, bundle: Bundle):
        self.name, self._job, self._versions = name, job, versions()
        self._experiment, self._contents, self._originals = bundle.experiment, bundle.contents, bundle.originals

    def setup(self, worker: Worker) -> None:
        """Called by Dask in its worker."""
        self._difference = difference(f"worker {worker.address}", versions(), self._versions)
        self._home = worker.local_directory
        self._scratch: tempfile.TemporaryDirectory[str] | None = None
        self._stopping, self._lock = threading.Event(), threading.Lock()
        self._processes: dict[int, tuple[threading.Lock, WorkerProcess]] = {}

    def teardown(self, worker: Worker) -> None:
        """Called by Dask when the sweep or the worker ends: end the processes, whatever they do, remove the files."""
        self._stopping.set()
        with self._lock:
            for guard, process in self._processes.values():
                with guard:
                    process.close()
            if self._scratch:
                self._scratch.cleanup()

    def results(self, tasks: Sequence[Task]) -> list[RunResult]:
        """What became of `tasks`; of fewer if the sweep ends meanwhile.

        Raises:
            InputRefused: this worker is not like the machine that sends them, or its disk takes no files.
            TwinError: no run can go on.
        """
        if self._difference:
            raise InputRefused(refusal(self._difference))
        with self._lock:
            if self._stopping.is_set():
                return []
            if self._scratch is None:
                with disk_refusals(self._home, kind=InputRefused):
                    self._scratch = tempfile.TemporaryDirectory(prefix=FILES, dir=self._home)
                    laid_out(self._contents, Path(self._scratch.name))
                # needs no memory any more
                self._contents = {}
            # resolved: sentences about files in it are to be recognised
            folder = Path(self._scratch.name).resolve()
            job = replace(self._job, experiment=folder / self._experiment, recordings=folder / "runs")
            # a process dies with the thread that started it, so each thread has its own
            guard, process = self._processes.setdefault(threading.get_ident(), (threading.Lock(), WorkerProcess(job)))
        results: list[RunResult] = []
        for task in tasks:
            here = replace(task, drive=task.drive and str(folder / task.drive))
            with guard:
                facts = None if self._stopping.is_set() else process.facts(here, self._stopping)
            if facts is None:
                break
            reason = facts["reason"]
            # the names that files have where they come from
            for inside, original in self._originals.items():
                reason = reason.replace(str(folder / inside), original)
            results.append(RunResult(task.run, facts | {"reason": reason}, _taken(job.recordings / f"{task.run:06d}")))
        return results


class EndPlugin(SchedulerPlugin):
    """Ends a sweep in all workers when its client is gone, which may have died without a word.

    Args:
        name: of the sweep.
        client: the name that Dask has for the client.
    """

    def __init__(self, name: str, client: str):
        self.name, self._client = name, client

    def remove_client(self, scheduler: Scheduler, client: str) -> None:
        """Called by Dask."""
        if client == self._client:
            scheduler.remove_plugin(self.name)
            if self.name in scheduler.worker_plugins:
                scheduler.loop.add_callback(scheduler.unregister_worker_plugin, None, self.name)


def run_tasks(name: str, tasks: Sequence[Task]) -> list[RunResult]:
    """Run `tasks` of the sweep `name`, one after the other, in a Dask worker; see `SweepPlugin.results`."""
    plugin = get_worker().plugins[name]
    assert isinstance(plugin, SweepPlugin)
    return plugin.results(tasks)


def _taken(folder: Path) -> dict[str, bytes]:
    """The files in `folder`, which is gone then."""
    if not folder.is_dir():
        return {}
    files = {file.name: file.read_bytes() for file in sorted(folder.iterdir()) if file.is_file()}
    shutil.rmtree(folder)
    return files
