"""One run of a report: its recording and what lies beside it."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from twin.kernel.errors import InputRefused
from twin.kernel.files import read_json
from twin.kernel.recording.folder import recording_in
from twin.kernel.recording.reader import read
from twin.kernel.recording.recording import Recording
from twin.report.page.measures import Measure, measures
from twin.robot.experiment.recorded import recorded_fmus, recorded_name
from twin.studies.metrics.response import Curve
from twin.studies.paper.fig5_measures import settings

SUMMARY = "summary.json"


@dataclass(frozen=True)
class ReportRun:
    """A recording with a name that no other run of the report has."""

    label: str
    recording: Recording

    @property
    def name(self) -> str:
        """Of the experiment."""
        return recorded_name(self.recording.metadata, self.recording.path)

    @property
    def title(self) -> str:
        return self.recording.metadata.get("experiment", {}).get("title", self.name)

    @cached_property
    def values(self) -> dict[str, Any]:
        """The experiment as it was checked, keys with units."""
        return settings(self.recording)

    @property
    def origins(self) -> dict[str, str]:
        """Where each value comes from, by dotted key."""
        return self.recording.metadata.get("origins", {})

    @cached_property
    def fmus(self) -> dict[str, dict[str, Any]]:
        """What is recorded of each drive's FMUs, by `drive_1` or `drive_1.part`."""
        return recorded_fmus(self.recording.metadata, self.recording.path)

    @cached_property
    def sha256(self) -> str:
        """Of the recording's file."""
        with self.recording.path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()

    @cached_property
    def summary(self) -> dict[str, Any]:
        """The numbers that the run wrote beside its recording; empty if they are missing or no longer readable."""
        try:
            summary = read_json(self.recording.path.parent / SUMMARY)
        except InputRefused:
            return {}
        return summary if isinstance(summary, dict) else {}

    @cached_property
    def end(self) -> float:
        """Time of the last sample (s)."""
        return max(float(t[-1]) for t in self.times.values() if len(t))

    @cached_property
    def times(self) -> dict[str, Curve]:
        """Of the samples of each topic (s), (n,)."""
        return {topic: self.recording.time(topic) for topic in self.recording.streams}

    @cached_property
    def measures(self) -> list[Measure]:
        """See the function of this name."""
        return measures(self)

    @property
    def size(self) -> int:
        """Bytes of its samples."""
        return sum(stream.records.nbytes for _, stream in self.streams)

    @property
    def streams(self) -> list[tuple[str, Any]]:
        return list(self.recording.streams.items())

    def has(self, *keys: str) -> bool:
        """Whether it holds samples of all these series."""
        fields = self.recording.fields()
        return all(key in fields and len(self.recording.streams[key.rpartition(".")[0]].records) for key in keys)

    def column(self, key: str, column: int | None) -> Curve:
        """Samples of a series (n,), or of one column of it, as they lie in the memory: to be worked on, not kept."""
        topic, _, name = key.rpartition(".")
        values = self.recording.streams[topic].values[name]
        return values if column is None else values[:, column]

    def held(self, key: str, t: Curve) -> Curve:
        """Samples of a series as they held at times `t` (n,) in s; before its first sample, that one."""
        topic = key.rpartition(".")[0]
        # half a nanosecond: rounding of the recorded times
        place = self.times[topic].searchsorted(t + 5e-10, side="right") - 1
        return self.recording[key][place.clip(min=0)]


def report_runs(paths: Sequence[Path]) -> list[ReportRun]:
    """The runs meant by `paths`: folders, .mcap files, or results/EXPERIMENT for the latest.

    Runs of one experiment are told apart by the name of their folder.

    Raises:
        RecordingRefused: one is missing, empty, damaged or foreign.
        InputRefused: one holds no samples, is not of the robot, or is given twice.
    """
    recordings = [read(recording_in(path)) for path in paths]
    for path, recording in zip(paths, recordings, strict=True):
        if not any(len(stream.records) for stream in recording.streams.values()):
            note = f" ({recording.note})" if recording.note else ""
            raise InputRefused(f"{path}: holds no samples{note}; there is nothing to report, run it again")
        if "system" in recording.metadata:
            raise InputRefused(
                f"{path}: is of a system of FMUs (twin cosim), and the page is about the robot; twin export --csv, "
                "twin compare and viewers of MCAP show it"
            )
    places = [recording.path.resolve() for recording in recordings]
    twice = next((path for path, place in zip(paths, places, strict=True) if places.count(place) > 1), None)
    if twice is not None:
        raise InputRefused(f"{twice}: given twice; name each run once")
    names = [ReportRun("", recording).name for recording in recordings]
    runs = []
    for name, place, recording in zip(names, places, recordings, strict=True):
        alike = [other for other, its in zip(places, names, strict=True) if its == name]
        folder = place.parent.name
        apart = [other.parent.name for other in alike].count(folder) == 1
        label = name if len(alike) == 1 else f"{name} {folder}" if apart else f"{name} {place.parent}"
        runs.append(ReportRun(label, recording))
    return runs
