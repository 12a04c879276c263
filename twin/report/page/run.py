"""Runs of a report: recordings, the files next to them, and their measures."""

import hashlib
import math
from collections.abc import Container, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from twin.kernel.errors import InputRefused
from twin.kernel.files import read_json
from twin.kernel.recording.folder import recording_in
from twin.kernel.recording.reader import Recording, read
from twin.report.page.panels import MM, PanelRun
from twin.robot.experiment.recorded import recorded_fmus, recorded_name
from twin.robot.run.hold import HoldRequest
from twin.robot.run.measures import (
    FORCE_KEYS,
    HEADLINE_KEYS,
    LARGE_OVERSHOOT,
    MEASURE_ROWS,
    NO_FORCE_LOOP,
    NOT_FOR_TASKS,
    ROWS_BY_KEY,
    Values,
    first_measures,
    fixed_point,
    missing_measures,
)
from twin.robot.run.view import BelievedRun, RunView, outcome_of
from twin.studies.metrics.required_series import FIG5_SERIES
from twin.studies.metrics.required_series import MEASURE_SERIES as SERIES_OF_MEASURES
from twin.studies.metrics.response import first_time, rms
from twin.studies.metrics.standing import COMPARED_MEASURES
from twin.studies.paper.task_run import settings, trip_time

SUMMARY_FILE = "summary.json"
KEY_MEASURES = (
    *(ROWS_BY_KEY[key].text for key in HEADLINE_KEYS), "error since the first touch", "largest force", "lateral error",
    "the estimated position", "largest motor speed",
)  # fmt: skip
"""Names of key measures, the most important first."""
SCORED_MEASURES = (*COMPARED_MEASURES, "force_error", "lateral_error")
"""Keys of the measures with "smaller is better"."""
MAX_BOXED_NUMBERS, MAX_BOXED_PER_RUN = 4, 3
"""Maximum number of key numbers of a single run, and of each of several: they are side by side above the player."""


class RunMeasure(NamedTuple):
    """A measure of a run; `true` is judged, `believed` is the robot's own. NaN if missing, for a `reason`.

    Infinity: the event never happened. `short` is its name in a verdict on several runs, "" if smaller is not better.
    `digits` after the decimal point are shown in sentences and boxes; None to show four significant digits.
    """

    text: str
    unit: str
    true: float
    believed: float = math.nan
    short: str = ""
    reason: str = ""
    digits: int | None = None

    @property
    def true_text(self) -> str:
        """True value of the measure as text of the verdict: `0.094 N`; "none" if missing."""
        if self.digits is None or not math.isfinite(self.true):
            return number_text(self.true, self.unit) or "none"
        return f"{fixed_point(self.true, self.digits)} {self.unit}".rstrip()

    @property
    def name(self) -> str:
        """Short name of the measure, with the reason if the value is missing."""
        return (self.short or self.text) + (f", {self.reason}" if math.isnan(self.true) else "")


def number_text(value: float, unit: str = "") -> str:
    """Format a number with four significant digits; `never` for infinity, "" for NaN."""
    if math.isnan(value):
        return ""
    return f"{value:.4g} {unit}".rstrip() if math.isfinite(value) else "never"


class ReportRun(PanelRun):
    """A recorded run with a label that is unique in the report."""

    def __init__(self, label: str, recording: Recording):
        # a system of FMUs has no experiment
        super().__init__(recording, {} if "system" in recording.metadata else settings(recording))
        self.label, self.recording = label, recording

    @property
    def name(self) -> str:
        """Name of the run's experiment, or of the system's file."""
        return _name_of(self.recording)

    @property
    def title(self) -> str:
        return self.recording.metadata.get("experiment", {}).get("title", self.name)

    @property
    def origins(self) -> dict[str, str]:
        """Stated source of each value of the experiment, by dotted key."""
        return self.recording.metadata.get("origins", {})

    @cached_property
    def fmus(self) -> dict[str, dict[str, Any]]:
        """Recorded descriptions of each drive's FMUs, by `drive_1` or `drive_1.part`."""
        return recorded_fmus(self.recording.metadata, self.recording.path)

    @cached_property
    def sha256(self) -> str:
        with self.recording.path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()

    @cached_property
    def summary(self) -> dict[str, Any]:
        """Numbers that the run wrote next to its recording; empty if missing or unreadable."""
        try:
            summary = read_json(self.recording.path.parent / SUMMARY_FILE)
        except InputRefused:
            return {}
        return summary if isinstance(summary, dict) else {}

    @cached_property
    def outcome(self) -> Values:
        """Measures of the run's true held force, by key; empty without a true force."""
        return self._measure(self.recording)

    @cached_property
    def believed_outcome(self) -> Values:
        """Measures of the held force as estimated by the controller; empty without a controller."""
        return self._measure(BelievedRun(self.recording)) if self.has("controller.F_z") else {}

    def _measure(self, run: RunView) -> Values:
        if not self.has("plant.F_ee_B"):
            return {}
        if not self.recording.complete:
            return missing_measures("the run ended early")
        found = outcome_of(run, HoldRequest.from_values(self.values))
        return found.measures if found else {}

    @cached_property
    def measures(self) -> list[RunMeasure]:
        return measures(self)

    @property
    def size(self) -> int:
        """Size of the run's recorded samples (bytes)."""
        return sum(stream.records.nbytes for stream in self.recording.streams.values())


def _name_of(recording: Recording) -> str:
    if "system" in recording.metadata:
        return Path(recording.metadata["system"]["file"]).stem
    return recorded_name(recording.metadata, recording.path)


def report_runs(paths: Sequence[Path]) -> list[ReportRun]:
    """Read the runs at `paths` (results/EXPERIMENT: latest); labels of one experiment's runs include their folder."""
    recordings = [read(recording_in(path)) for path in paths]
    for path, recording in zip(paths, recordings, strict=True):
        if not any(len(stream.records) for stream in recording.streams.values()):
            note = f" ({recording.note})" if recording.note else ""
            raise InputRefused(f"{path}: holds no samples{note}; there is nothing to report, run it again")
    places = [recording.path.resolve() for recording in recordings]
    twice = next((path for path, place in zip(paths, places, strict=True) if places.count(place) > 1), None)
    if twice is not None:
        raise InputRefused(f"{twice}: given twice; name each run once")
    names = [_name_of(recording) for recording in recordings]
    runs = []
    for name, place, recording in zip(names, places, recordings, strict=True):
        alike = [other for other, its in zip(places, names, strict=True) if its == name]
        folder = place.parent.name
        apart = [other.parent.name for other in alike].count(folder) == 1
        label = name if len(alike) == 1 else f"{name} {folder}" if apart else f"{name} {place.parent}"
        runs.append(ReportRun(label, recording))
    return runs


def outcome_text(run: ReportRun) -> str:
    """Describe the first measures of a held force in a sentence; "" if no force was held."""
    values = run.outcome
    if not values or values["hold_error"].value is None:
        return ""
    large = (values["hold_overshoot"].value or 0.0) > LARGE_OVERSHOOT
    first = "; ".join(first_measures(values))
    return f"Overshoot beyond {100.0 * LARGE_OVERSHOOT:g} %: {first}" if large else f"{first[0].upper()}{first[1:]}"


def measures(run: ReportRun) -> list[RunMeasure]:
    """Return all measures of a run whose series it has, the force first."""
    found = _table_measures(run)
    if run.has("plant.F_ee_B"):
        found += _force(run)
    if run.has("plant.p_B"):
        found += _path(run)
    drives = [f"drive/{joint}.omega_m" for joint in (1, 2, 3)]
    if run.has(*drives):
        worst = max(float(np.abs(run.recording[key]).max()) for key in drives)
        found.append(RunMeasure("largest motor speed", "rad/s", worst))
    if run.has("monitor.tripped"):
        found.append(RunMeasure("safety monitor tripped at", "s", trip_time(run.recording)))
    return found


def scored_values(run: ReportRun) -> dict[str, float]:
    """Return a run's true values of scored measures by short name; infinity for events that never happened, no NaN."""
    return {m.short: m.true for m in run.measures if m.short and not math.isnan(m.true)}


def key_measures(runs: Sequence[ReportRun]) -> list[list[RunMeasure]]:
    """Return the key numbers of each run for the report: the first of `KEY_MEASURES` that all runs have.

    The hold error without a value counts too, and if a force is held, the other first measures, such as chatter below
    the reporting threshold.
    """
    found = [{name: m for m in run.measures for name in (m.short, m.text) if name and _is_key(m, run)} for run in runs]
    shared = [name for name in KEY_MEASURES if all(name in own for own in found)][
        : MAX_BOXED_NUMBERS if len(runs) == 1 else MAX_BOXED_PER_RUN
    ]
    return [[own[name] for name in shared] for own in found]


def _is_key(measure: RunMeasure, run: ReportRun) -> bool:
    held = bool(run.outcome) and run.outcome["hold_error"].value is not None
    named = KEY_MEASURES[: len(HEADLINE_KEYS) if held else 1]
    missing = measure.text in named and measure.reason not in (NOT_FOR_TASKS, NO_FORCE_LOOP)
    return missing or not math.isnan(measure.true)


def unscored_reasons(run: ReportRun, asked: Container[str]) -> dict[str, list[str]]:
    """Return why measures are missing, reason -> short names: those without a series, and those `asked` for."""
    wanted = {"its tasks": FIG5_SERIES} | SERIES_OF_MEASURES if run.values.get("task") else SERIES_OF_MEASURES
    lost = {name: [series for series in needs if not run.has(series)] for name, needs in wanted.items()}
    missing = dict.fromkeys(series for needs in lost.values() for series in needs)
    found = {f"no {', '.join(missing)}": [name for name, series in lost.items() if series]} if missing else {}
    known = {name for names in found.values() for name in names}
    for measure in run.measures:
        # a run under position control has no force to hold
        if (
            measure.reason not in ("", NO_FORCE_LOOP)
            and math.isnan(measure.true)
            and measure.short in asked
            and measure.short not in known
        ):
            found.setdefault(measure.reason, []).append(measure.short)
    return found


def _table_measures(run: ReportRun) -> list[RunMeasure]:
    """Return a run's measures of `twin.robot.run.measures`, true and, for a force, as estimated by the robot."""
    found = []
    for measure in MEASURE_ROWS if run.outcome else ():
        one = run.outcome[measure.key]
        # only measures of the force exist for the robot's own estimate too
        own = run.believed_outcome.get(measure.key) if measure.key in FORCE_KEYS else None
        if one.value is None and measure.key not in HEADLINE_KEYS:
            continue
        true, believed = (
            math.nan if v is None else measure.unit.per_SI * v for v in (one.value, own.value if own else None)
        )
        short = measure.text if measure.key in SCORED_MEASURES else ""
        found.append(RunMeasure(measure.text, measure.unit.text, true, believed, short, one.reason, measure.digits))
    return found


def _force(run: ReportRun) -> list[RunMeasure]:
    t = run.time("plant")
    F_z = -run.recording["plant.F_ee_B"][:, 2]
    # not the force's z component, which pulling sideways on a tilted surface has too
    touching = (run.recording["plant.F_n"] if run.has("plant.F_n") else F_z) > 0.0
    found = [RunMeasure("first touch at", "s", first_time(t, touching))]
    if np.any(touching) and run.has("controller.F_z"):
        believed = run.values_at("controller.F_z", t)
        text = "error of the estimated force in contact, rms"
        found.append(RunMeasure(text, "N", rms((believed - F_z)[touching]), short="the estimated force"))
    return found


def _path(run: ReportRun) -> list[RunMeasure]:
    t, p_B = run.time("plant"), run.recording["plant.p_B"]
    found = []
    if run.has("controller.p_ref_B"):
        off = MM * (p_B - run.values_at("controller.p_ref_B", t))
        across = np.hypot(off[:, 0], off[:, 1])
        found.append(RunMeasure("horizontal distance from the reference, largest", "mm", float(across.max())))
    if run.has("estimator.p_B"):
        error = np.linalg.norm(run.values_at("estimator.p_B", t) - p_B, axis=1)
        found.append(
            RunMeasure("error of the estimated position, rms", "mm", MM * rms(error), short="the estimated position")
        )
    return found
