"""What happens in a Dask worker: runs, each in a guarded child process, so that no FMU can harm the worker itself;
and what has to be the same on two machines for a run to give the same bits there."""

import functools
import hashlib
import platform
import shutil
import socket
import sys
import tempfile
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import twin
from twin.studies.sweep.dask import file_store
from twin.studies.sweep.dask.bundle import Manifest
from twin.studies.sweep.plan import Task
from twin.studies.sweep.pool import Job, WorkerProcess

PACKAGES = ("numba", "llvmlite", "numpy", "fmpy")


@functools.cache
def versions() -> dict[str, str]:
    """Of this process, by what a user would call it.

    twin's is followed by a hash of its files: in a clone the number stays while the code changes.
    """
    return {
        "twin": f"{_version('twin')} (files {_digest(Path(twin.__file__).parent)})",
        "Python": f"{sys.version_info.major}.{sys.version_info.minor}",
        **{package: _version(package) for package in PACKAGES},
        "machine": f"{platform.system()} {platform.machine()}",
    }


def difference(who: str, theirs: Mapping[str, str], ours: Mapping[str, str]) -> str:
    """`tcp://10.0.0.5:4001 has numba 0.59.1, this machine has 0.61.0`; "" if they are the same."""
    told = [
        f"{what} {theirs.get(what, 'none')}, this machine has {own}"
        for what, own in ours.items()
        if theirs.get(what) != own
    ]
    return f"{who} has {'; and '.join(told)}" if told else ""


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "none"


def _digest(folder: Path) -> str:
    content = hashlib.sha256()
    for file in sorted(folder.rglob("*.py")):
        content.update(f"{file.relative_to(folder).as_posix()}\0".encode())
        content.update(file.read_bytes())
    return content.hexdigest()[:8]


IDLE = 60.0
"""Seconds after which a runner without runs is closed: whoever began the sweep may have died without a word."""


@dataclass(frozen=True)
class SweepJob:
    """What all runs of a sweep have in common, for whichever worker gets one.

    Attributes:
        sweep: tells it from all others.
        versions: of whoever sends it.
        manifest: of its files.
        job: as on the machine that sends it; paths are the runner's own.
    """

    sweep: str
    versions: dict[str, str]
    manifest: Manifest
    job: Job


@dataclass(frozen=True)
class RunResult:
    """What became of a run: its number, the facts of its `Finding`, the files of its recording by name."""

    run: int
    facts: dict[str, Any]
    files: dict[str, bytes]


@dataclass(frozen=True)
class Reply:
    """Of a worker.

    Attributes:
        store: which machine and `file_store` it shares with others.
        address: of the worker, if it was given runs.
        versions: its own, if they differ: it has run nothing.
        missing: SHA-256 that it needs first: likewise.
        results: else of every run; of fewer if the runner was closed.
    """

    store: tuple[str, str]
    versions: dict[str, str] | None
    missing: tuple[str, ...]
    address: str = ""
    results: tuple[RunResult, ...] = ()


def lack(sweep: SweepJob) -> Reply:
    """What keeps this worker from runs of `sweep`: other versions, or files."""
    differ = versions() != sweep.versions
    missing = () if differ else tuple(file_store.missing(sweep.manifest.files.values()))
    return Reply((socket.gethostname(), str(file_store.home())), versions() if differ else None, missing)


def run_tasks(sweep: SweepJob, tasks: Sequence[Task]) -> Reply:
    """Run `tasks` one after the other.

    Raises:
        TwinError: no run can go on, say because the disk is full.
    """
    from distributed import get_worker

    worker = get_worker()
    with _lock:
        runner = _runners.get(sweep.sweep)
        if runner is None:
            reply = replace(lack(sweep), address=worker.address)
            if reply.versions or reply.missing:
                return reply
            runner = _runners[sweep.sweep] = Runner(sweep, worker.local_directory)
    return Reply(("", ""), None, (), worker.address, tuple(runner.results(tasks)))


def close_runner(sweep: str) -> None:
    """Close the runner of `sweep`, if there is one; its processes end, whatever they are doing."""
    with _lock:
        runner = _runners.pop(sweep, None)
    if runner:
        runner.close()


class Runner:
    """What a sweep has in this worker: its files in a folder of its own in `home`, a warm process for each thread."""

    def __init__(self, sweep: SweepJob, home: str):
        self._sweep, self._manifest = sweep.sweep, sweep.manifest
        self._scratch = tempfile.TemporaryDirectory(prefix="twin_runner_", dir=home)
        # resolved: sentences about files in it are to be recognised
        folder = Path(self._scratch.name).resolve()
        self._files, self._recordings = folder / "files", folder / "runs"
        file_store.lay_out(sweep.manifest.files, self._files)
        experiment = self._files / sweep.manifest.experiment
        self._job = replace(sweep.job, experiment=experiment, recordings=self._recordings)
        self._stopping = threading.Event()
        self._lock = threading.Lock()
        self._processes: dict[int, tuple[threading.Lock, WorkerProcess]] = {}
        self._busy = 0
        self._timer: threading.Timer | None = None

    def results(self, tasks: Sequence[Task]) -> list[RunResult]:
        """What became of `tasks`; of fewer if the runner is closed meanwhile."""
        with self._lock:
            self._busy += 1
            if self._timer:
                self._timer.cancel()
            # a process dies with the thread that started it, so each thread has its own
            guard, process = self._processes.setdefault(
                threading.get_ident(), (threading.Lock(), WorkerProcess(self._job))
            )
        results: list[RunResult] = []
        try:
            for task in tasks:
                here = replace(task, drive=task.drive and str(self._files / task.drive))
                with guard:
                    facts = None if self._stopping.is_set() else process.facts(here, self._stopping)
                if facts is None:
                    break
                reason = facts["reason"]
                # the names that files have where they come from
                for inside, original in self._manifest.originals.items():
                    reason = reason.replace(str(self._files / inside), original)
                results.append(RunResult(task.run, facts | {"reason": reason}, self._recording(task.run)))
        finally:
            with self._lock:
                self._busy -= 1
                if not self._busy and not self._stopping.is_set():
                    self._timer = threading.Timer(IDLE, close_runner, (self._sweep,))
                    self._timer.daemon = True
                    self._timer.start()
        return results

    def close(self) -> None:
        """End its processes and remove its files."""
        self._stopping.set()
        with self._lock:
            if self._timer:
                self._timer.cancel()
            processes = list(self._processes.values())
        for guard, process in processes:
            with guard:
                process.close()
        self._scratch.cleanup()

    def _recording(self, run: int) -> dict[str, bytes]:
        """The files that a run has left; they are gone from here then."""
        folder = self._recordings / f"{run:06d}"
        if not folder.is_dir():
            return {}
        files = {file.name: file.read_bytes() for file in sorted(folder.iterdir()) if file.is_file()}
        shutil.rmtree(folder)
        return files


_lock = threading.Lock()
_runners: dict[str, Runner] = {}
