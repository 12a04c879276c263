"""What happens in a Dask worker: runs, each in a guarded child process, so that no FMU can harm the worker itself."""

import functools
import json
import shutil
import tempfile
import threading
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from distributed import Scheduler, SchedulerPlugin, Worker, WorkerPlugin, get_worker

from twin.kernel.errors import InputRefused, disk_refusals
from twin.kernel.files import read_bytes
from twin.kernel.fmi.variable import MOST_BYTES
from twin.robot.experiment.drive_files import FILE, FOLDERS, MAPPING, completed, shelved
from twin.robot.experiment.source import RETAINED, read_source, source_text
from twin.robot.places import located
from twin.studies.sweep.dask.cluster import difference, refusal, versions
from twin.studies.sweep.plan import Task
from twin.studies.sweep.sweep import Job, WorkerProcess


class Bundle:
    """The experiment at a path, and what its runs add to it as they are packed.

    Attributes:
        experiment: its path in the bundle.
        contents: of files, by their paths in the bundle.
        originals: path in the bundle -> path on the machine it was packed on, for sentences.

    Raises:
        InputRefused: a file cannot be read, or is not what it should be.
    """

    def __init__(self, experiment: Path):
        self.experiment = f"{experiment.stem}.toml"
        self.contents: dict[str, bytes] = {}
        self.originals: dict[str, str] = {}
        self._folder = experiment.resolve().parent
        self._names: dict[Path, str] = {}
        # most runs of a sweep share their drives and settings
        self._shelved = functools.cache(lambda drive: self._drive(Path(shelved(drive, self._folder))))
        self._setting = functools.cache(self._packed_setting)
        self._put_toml(self.experiment, experiment, ())

    def packed(self, task: Task) -> Task:
        """`task` as it travels: no more than its run needs, drive and settings by paths in the bundle.

        Raises:
            InputRefused: as for the experiment.
        """
        drive = None if task.drive is None else self._shelved(task.drive)
        return Task(task.run, "", drive, {}, tuple(map(self._setting, task.settings)))

    def _packed_setting(self, text: str) -> str:
        if not text.endswith('"'):
            return text
        key, _, value = text.partition("=")
        return f"{key}={json.dumps(self._packed(tuple(key.split('.')), json.loads(value), self._folder))}"

    def _packed(self, key: tuple[str, ...], value: Any, folder: Path) -> Any:
        """`value` with each file that it names packed, and named anew.

        Args:
            key: of the value in an experiment, a part for each table.
            folder: from which its files are looked up.
        """
        if isinstance(value, dict):
            return {name: self._packed((*key, name), inner, folder) for name, inner in value.items()}
        if isinstance(value, (list, tuple)):
            return tuple(self._packed(key, each, folder) for each in value)
        if not isinstance(value, str):
            return value
        match key:
            case _ if "parameters" in key:
                return FILE + self._file(located(value.removeprefix(FILE), folder)) if value.startswith(FILE) else value
            case (*_, "parts", _, "fmu"):
                return self._fmu(value, folder)
            case ("drive", *_, "fmu"):
                return self._drive(located(value, folder))
            case (role, "fmu") if role in RETAINED:
                return self._drive(located(value, folder))
            case (role, "python") if role in RETAINED:
                # its file alone, not what that imports from beside it
                file, _, kind = value.rpartition(":")
                return f"{self._file(located(file, folder), 'python')}:{kind}"
            case ("contact", "body"):
                return self._body(value)
        return value

    def _drive(self, path: Path) -> str:
        """The name of the drive at `path`: an FMU, a mapping, or a folder with one of them."""
        mapping = path / MAPPING if path.is_dir() else path
        if not (mapping.suffix == ".toml" and mapping.is_file()):
            return self._fmu(str(path), path.parent)
        name, new = self._named(path)
        if new:
            inside = f"{name}/{MAPPING}" if path.is_dir() else name
            self._put_toml(inside, mapping, ("drive",))
        return name

    def _fmu(self, name: str, folder: Path) -> str:
        """The name of the FMU, or of the folder with one, that is called `name` in `folder`."""
        path = located(name, folder)
        name, new = self._named(path)
        if new:
            archive = Path(completed({"parts": {"it": {"fmu": str(path)}}}, folder)["parts"]["it"]["fmu"])
            self._put(f"{name}/{archive.name}" if path.is_dir() else name, archive.read_bytes(), archive)
        return name

    def _file(self, path: Path, shelf: str = "fmus") -> str:
        name, new = self._named(path, shelf)
        if new:
            self._put(name, read_bytes(path, MOST_BYTES), path)
        return name

    def _body(self, name: str) -> str:
        if name.endswith(".toml"):
            path = located(name, self._folder)
            name = inside = self._named(path, "bodies")[0]
        else:
            shelves = [located(shelf, self._folder) / f"{name}.toml" for shelf in FOLDERS]
            path = next((file for file in shelves if file.is_file()), shelves[0])
            inside = f"{FOLDERS[0]}/{name}.toml"
        self._put_toml(inside, path, ("contact",))
        return name

    def _named(self, path: Path, shelf: str = "fmus") -> tuple[str, bool]:
        """(the name in the bundle of `path`, whether it is new), the same from wherever in the bundle it is looked up.

        Names are looked up in all folders above, so no mapping needs a way to what it names.
        """
        new = path not in self._names
        return self._names.setdefault(path, f"{shelf}/{len(self._names)}/{path.name}"), new

    def _put_toml(self, inside: str, path: Path, key: tuple[str, ...]) -> None:
        """Pack the TOML file at `path`, which stands for the table `key` of an experiment, with the files it names."""
        source = read_source(path)
        source.values = self._packed(key, source.values, path.resolve().parent)
        self._put(inside, source_text(source).encode(), path.absolute())

    def _put(self, inside: str, content: bytes, original: Path) -> None:
        self.contents[inside], self.originals[inside] = content, str(original)


def laid_out(contents: Mapping[str, bytes], folder: Path) -> None:
    """Write `contents`, by their paths, into `folder`."""
    for inside, content in contents.items():
        path = folder / inside
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)


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
