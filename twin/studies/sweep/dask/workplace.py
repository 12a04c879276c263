"""What happens in a Dask worker: runs, each in a guarded child process, so that no FMU can harm the worker itself.

A place is what one sweep has in one worker: its files and, for each thread that runs for it, a warm process.
"""

import shutil
import socket
import tempfile
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from twin.runs.guard.limits import Limits
from twin.studies.sweep.dask import depot
from twin.studies.sweep.dask.parcel import Label, Order
from twin.studies.sweep.dask.versions import versions
from twin.studies.sweep.engine import Job
from twin.studies.sweep.plan import Task
from twin.studies.sweep.station import Station

IDLE = 60.0
"""Seconds after which a place without runs is given up: whoever began the sweep may have died without a word."""


@dataclass(frozen=True)
class Errand:
    """What all runs of a sweep have in common, for whichever worker gets one.

    Attributes:
        sweep: tells it from all others. versions: of whoever sends it. label: of its files.
        record, limits, claims, reuse: see `twin.studies.sweep.engine.Job`.
    """

    sweep: str
    versions: dict[str, str]
    label: Label
    record: str
    limits: Limits
    claims: str
    reuse: str = ""


@dataclass(frozen=True)
class Yield:
    """What became of a run: its number, the facts of its `Finding`, the files of its recording by name."""

    run: int
    facts: dict[str, Any]
    files: dict[str, bytes]


@dataclass(frozen=True)
class Reply:
    """Of a worker to runs that it was given.

    Attributes:
        versions: its own, if they differ: it has run nothing. missing: SHA-256 that it needs first: likewise.
        yields: else of every run; of fewer if it was told to leave.
    """

    address: str
    versions: dict[str, str] | None = None
    missing: tuple[str, ...] = ()
    yields: tuple[Yield, ...] = ()


@dataclass(frozen=True)
class Survey:
    """A worker before a sweep: which machine and depot it shares with others, its versions, what it has not."""

    depot: tuple[str, str]
    versions: dict[str, str]
    missing: tuple[str, ...]


def survey(digests: Sequence[str]) -> Survey:
    """This worker, asked for `digests`."""
    return Survey((socket.gethostname(), str(depot.home())), versions(), tuple(depot.missing(digests)))


def ran(errand: Errand, orders: Sequence[Order]) -> Reply:
    """Run `orders` one after the other.

    Raises:
        TwinError: no run can go on, say because the disk is full.
    """
    from distributed import get_worker

    worker = get_worker()
    address = worker.address
    if versions() != errand.versions:
        return Reply(address, versions=versions())
    with _lock:
        place = _places.get(errand.sweep)
        if place is None:
            if gone := depot.missing(errand.label.files.values()):
                return Reply(address, missing=tuple(gone))
            place = _places[errand.sweep] = Place(errand, worker.local_directory)
    return Reply(address, yields=tuple(place.ran(orders)))


def leave(sweep: str) -> None:
    """Give up the place of `sweep`, if there is one; its processes end, whatever they are doing."""
    with _lock:
        place = _places.pop(sweep, None)
    if place:
        place.close()


class Place:
    """What a sweep has in this worker, in a folder of its own in `home`."""

    def __init__(self, errand: Errand, home: str):
        self._label = errand.label
        self._scratch = tempfile.TemporaryDirectory(prefix="twin_place_", dir=home)
        # resolved: sentences about files in it are to be recognised
        folder = Path(self._scratch.name).resolve()
        self._files, self._recordings = folder / "files", folder / "runs"
        depot.lay_out(errand.label.files, self._files)
        self._job = Job(
            self._files / errand.label.experiment,
            self._recordings,
            errand.record,
            errand.limits,
            errand.claims,
            errand.reuse,
        )
        self._stopping = threading.Event()
        self._lock = threading.Lock()
        self._stations: dict[int, tuple[threading.Lock, Station]] = {}
        self._busy = 0
        self._timer: threading.Timer | None = None
        self._sweep = errand.sweep

    def ran(self, orders: Sequence[Order]) -> list[Yield]:
        """What became of `orders`; of fewer if the place is given up meanwhile."""
        with self._lock:
            self._busy += 1
            if self._timer:
                self._timer.cancel()
            # a station's process dies with the thread that started it, so each thread has its own
            guard, station = self._stations.setdefault(threading.get_ident(), (threading.Lock(), Station(self._job)))
        yields: list[Yield] = []
        try:
            for run, drive, settings in orders:
                task = Task(run, "", drive and str(self._files / drive), {}, settings)
                with guard:
                    facts = None if self._stopping.is_set() else station.facts(task, self._stopping)
                if facts is None:
                    break
                yields.append(Yield(run, facts | {"reason": self._as_sent(facts["reason"])}, self._recording(run)))
        finally:
            with self._lock:
                self._busy -= 1
                if not self._busy and not self._stopping.is_set():
                    self._timer = threading.Timer(IDLE, leave, (self._sweep,))
                    self._timer.daemon = True
                    self._timer.start()
        return yields

    def close(self) -> None:
        """End its processes and remove its files."""
        self._stopping.set()
        with self._lock:
            if self._timer:
                self._timer.cancel()
            stations = list(self._stations.values())
        for guard, station in stations:
            with guard:
                station.__exit__()
        self._scratch.cleanup()

    def _as_sent(self, reason: str) -> str:
        """`reason` with the names that files have where they come from."""
        for inside, original in self._label.originals.items():
            reason = reason.replace(str(self._files / inside), original)
        return reason

    def _recording(self, run: int) -> dict[str, bytes]:
        """The files that a run has left; they are gone from here then."""
        folder = self._recordings / f"{run:06d}"
        if not folder.is_dir():
            return {}
        files = {file.name: file.read_bytes() for file in sorted(folder.iterdir()) if file.is_file()}
        shutil.rmtree(folder)
        return files


_lock = threading.Lock()
_places: dict[str, Place] = {}
