"""One run of a report: its recording and the files beside it."""

import hashlib
import math
from collections.abc import Callable, Container, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from twin.kernel.errors import InputRefused
from twin.kernel.files import read_json
from twin.kernel.recording.folder import recording_in
from twin.kernel.recording.reader import Recording, read
from twin.robot.experiment.recorded import recorded_fmus, recorded_name
from twin.studies.metrics.requirement import FIG5, MEASURES, OF_A_CONSTANT_FORCE
from twin.studies.metrics.response import Curve, first_time, overshoot, rms, settling_time
from twin.studies.paper.fig5_measures import settings, trip_time

BAND = 0.05
"""Share of the reference within which a force has settled, as in the paper's Fig. 4."""
MM = 1e3
KEYS = (
    "force error", "largest pressing force", "settling", "settled force error", "distance from the path",
    "the estimated position", "largest motor speed",
)  # fmt: skip
"""Names of measures, the one that says most about a run first."""
END = "force at the end, mean of the last second"


class RunMeasure(NamedTuple):
    """A number about a run; `true` is judged, `believed` is what the robot would say. NaN: there is none.

    Infinity: it never happened. `short` is its name in a verdict on several runs, "" where less is not better.
    """

    text: str
    unit: str
    true: float
    believed: float = math.nan
    short: str = ""


def number(value: float, unit: str = "") -> str:
    """`value` with four digits; `never` for infinity, "" for NaN."""
    if math.isnan(value):
        return ""
    return f"{value:.4g} {unit}".rstrip() if math.isfinite(value) else "never"


def outcome(run: "ReportRun") -> str:
    """What a constant force came to, as half a sentence; "" where no force was asked for."""
    found = {measure.text: measure for measure in run.measures}
    settled = next((measure for text, measure in found.items() if text.startswith("within ")), None)
    if settled is None:
        return ""
    band = settled.text.removesuffix(" to the end from")
    when = f"stays {band} from {number(settled.true, 's')} on" if math.isfinite(settled.true) else f"never stays {band}"
    return f"The true force {when} and ends at {number(found[END].true, 'N')}"


def measures(run: "ReportRun") -> list[RunMeasure]:
    """All measures that `run` holds the series for, the force first."""
    found: list[RunMeasure] = []
    if run.has("plant.F_ee_B"):
        found += _force(run)
    if run.has("plant.p_B"):
        found += _path(run)
    if run.has(*(f"drive/{joint}.{name}" for joint in (1, 2, 3) for name in ("omega_m", "tau_motor"))):
        found += _drives(run)
    if run.has("monitor.tripped"):
        found.append(RunMeasure("safety monitor tripped at", "s", trip_time(run.recording)))
    return found


def scored(run: "ReportRun") -> dict[str, float]:
    """What is judged of the truth, by short name; only what has a number, or never happened."""
    return {m.short: m.true for m in run.measures if m.short and not math.isnan(m.true)}


def key_measures(runs: Sequence["ReportRun"]) -> list[list[RunMeasure]]:
    """Of each run the three that say most: the first of `KEYS` that all of them have; fewer if there are not three."""
    found = [
        {name: m for m in run.measures for name in (m.short, m.text) if name and not math.isnan(m.true)} for run in runs
    ]
    shared = [name for name in KEYS if all(name in own for own in found)][:3]
    return [[own[name] for name in shared] for own in found]


def unscored(run: "ReportRun", asked: Container[str]) -> dict[str, list[str]]:
    """Why measures are not there: what is missing -> their short names.

    Args:
        asked: short names of the measures that are wanted besides those that a series is missing for.
    """
    has_tasks = bool(run.values.get("task"))
    wanted = {"its tasks": FIG5} | MEASURES if has_tasks else MEASURES
    lost = {name: [series for series in needs if not run.has(series)] for name, needs in wanted.items()}
    if has_tasks:
        lost = {name: series for name, series in lost.items() if name not in OF_A_CONSTANT_FORCE}
    missing = dict.fromkeys(series for needs in lost.values() for series in needs)
    found = {f"no {', '.join(missing)}": [name for name, series in lost.items() if series]} if missing else {}
    # a run under position control has no force error to lose
    idle = not missing and not np.any(run.recording["controller.triggered"])
    there = {*scored(run), "its tasks", *(("force error",) if idle else ())}
    if others := [name for name, series in lost.items() if not series and name in asked and name not in there]:
        found[_why_not(run)] = others
    return found


def _why_not(run: "ReportRun") -> str:
    """Why a run that holds all series has no measure of its force."""
    touches = run.has("plant.F_ee_B") and np.any(run.recording["plant.F_ee_B"][:, 2] < 0.0)
    return "no constant force was asked for" if touches else "it never touched"


def _force(run: "ReportRun") -> list[RunMeasure]:
    t = run.times["plant"]
    F_z = -run.recording["plant.F_ee_B"][:, 2]
    # not the force's z component: pulling sideways on a tilted surface has one, too
    touching = (run.recording["plant.F_n"] if run.has("plant.F_n") else F_z) > 0.0
    believed = run.held("controller.F_z", t) if run.has("controller.F_z") else np.full_like(t, math.nan)
    found = [
        RunMeasure("first touch at", "s", first_time(t, touching)),
        RunMeasure("largest pressing force", "N", float(F_z.max()), float(believed.max())),
    ]
    if not np.any(touching):
        return found
    if run.has("controller.triggered") and np.any(on := run.held("controller.triggered", t) > 0.0):
        lead = max(0.0, first_time(t, touching) - first_time(t, on))
        found.insert(1, RunMeasure("force loop on before the first touch for", "s", lead))
    found.append(
        RunMeasure(
            "error of the estimated force in contact, rms",
            "N",
            rms((believed - F_z)[touching]),
            short="the estimated force",
        )
    )
    if run.has(*MEASURES["force error"]):
        found += _force_error(run, t, F_z, believed)
    if not run.has("controller.F_z_ref") or run.values.get("task"):
        return found
    return found + _regulation(t, F_z, believed, run.held("controller.F_z_ref", t), touching)


def _force_error(run: "ReportRun", t: Curve, F_z: Curve, believed: Curve) -> list[RunMeasure]:
    """The `force_error` of `twin.robot.run.outcome`: off the reference, force loop on, from the first touch on."""
    on = (run.held("controller.triggered", t) > 0.0) & np.logical_or.accumulate(F_z > 0.0)
    if not np.any(on):
        return []
    F_z_ref = run.held("controller.F_z_ref", t)
    text = "rms of F_z off its reference, force loop on, from the first touch on"
    return [RunMeasure(text, "N", rms((F_z - F_z_ref)[on]), rms((believed - F_z_ref)[on]), short="force error")]


def _regulation(t: Curve, F_z: Curve, believed: Curve, F_z_ref: Curve, touching: np.ndarray) -> list[RunMeasure]:
    """How well a constant force is reached and kept; the second half of the contact is what has settled."""
    target = float(F_z_ref[-1])
    if target <= 0.0:
        return []
    contact = np.flatnonzero(touching)
    late = contact[len(contact) // 2 :]

    def both(text: str, unit: str, of: Callable[[Curve], float], short: str = "") -> RunMeasure:
        return RunMeasure(text, unit, of(F_z), of(believed), short)

    return [
        both(f"within {100.0 * BAND:g} % of {target:g} N to the end from", "s",
             lambda F: settling_time(t, F, target, BAND * target), "settling"),
        both("overshoot of the force", "%", lambda F: 100.0 * overshoot(F, target), "overshoot"),
        both(END, "N", lambda F: float(np.mean(F[t >= t[-1] - 1.0]))),
        both(f"rms of {target:g} N - F_z, second half of the contact", "N", lambda F: rms(F[late] - F_z_ref[late]),
             "settled force error"),
    ]  # fmt: skip


def _path(run: "ReportRun") -> list[RunMeasure]:
    t, p_B = run.times["plant"], run.recording["plant.p_B"]
    found = []
    if run.has("controller.p_ref_B"):
        off = MM * (p_B - run.held("controller.p_ref_B", t))
        across = np.hypot(off[:, 0], off[:, 1])
        found += [
            RunMeasure(
                "horizontal distance from the reference, rms", "mm", rms(across), short="distance from the path"
            ),
            RunMeasure("horizontal distance from the reference, largest", "mm", float(across.max())),
        ]
    if run.has("estimator.p_B"):
        error = np.linalg.norm(run.held("estimator.p_B", t) - p_B, axis=1)
        found.append(
            RunMeasure("error of the estimated position, rms", "mm", MM * rms(error), short="the estimated position")
        )
    return found


def _drives(run: "ReportRun") -> list[RunMeasure]:
    worst = {
        name: max(float(np.abs(run.recording[f"drive/{joint}.{name}"]).max()) for joint in (1, 2, 3))
        for name in ("omega_m", "tau_motor")
    }
    return [
        RunMeasure("largest motor speed", "rad/s", worst["omega_m"]),
        RunMeasure("largest motor torque", "N m", worst["tau_motor"]),
    ]


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
    def measures(self) -> list[RunMeasure]:
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

    Runs of one experiment are distinguished by the name of their folder.

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
                f"{path}: records a system of FMUs (twin cosim), and the page shows the robot; use twin export "
                "--csv, twin compare or an MCAP viewer"
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
