"""The runs of a report: recordings and the files beside them; the outcome in a sentence, and every claim behind it.

One run is drawn in the panels and colours that the caption of Fig. 4 names: height, pressing force, F_x and F_y.
"""

import hashlib
import json
import math
from collections.abc import Callable, Container, Iterable, Sequence
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
from twin.robot.run.hold import HoldRequest
from twin.robot.run.measures import (
    HEADLINE,
    LARGE_OVERSHOOT,
    MEASURES,
    NO_FORCE_LOOP,
    NOT_FOR_TASKS,
    OF_A_FORCE,
    TABLE,
    Values,
    first_measures,
    fixed,
    unmeasured,
)
from twin.robot.run.view import BelievedRun, RunView, held_samples, outcome_of
from twin.studies.figure import Axes, picture
from twin.studies.metrics.requirement import FIG5
from twin.studies.metrics.requirement import MEASURES as SERIES_OF_MEASURES
from twin.studies.metrics.response import Curve, first_time, rms
from twin.studies.metrics.standing import JUDGED, one_run_each
from twin.studies.paper import fig4_measures
from twin.studies.paper.claim import ClaimFinding, judged
from twin.studies.paper.fig4 import OWN, PAPERS, QUALITY, failed, fig4_score, tally
from twin.studies.paper.fig4 import standing as claims_standing
from twin.studies.paper.fig5 import Fig5Score, fig5_score
from twin.studies.paper.fig5_measures import settings, trip_time

MM = 1e3
KEYS = (
    *(MEASURES[key].text for key in HEADLINE), "error since the first touch", "largest force", "lateral error",
    "the estimated position", "largest motor speed",
)  # fmt: skip
"""Names of measures, the one that says most about a run first."""
SCORED = (*JUDGED, "force_error", "lateral_error")
"""Keys of the measures for which smaller is better."""
MOST_BOXED_NUMBERS, MOST_BOXED_OF_SEVERAL = 4, 3
"""Key numbers of a run, and of each of several: they stand side by side above the player."""


class RunMeasure(NamedTuple):
    """A number about a run; `true` is judged, `believed` is the robot's own. NaN if there is none, for a `reason`.

    Infinity: it never happened. `short` is its name in a verdict on several runs, "" where less is not better.
    `digits` after the point are shown in sentences and boxes; None to show four significant digits.
    """

    text: str
    unit: str
    true: float
    believed: float = math.nan
    short: str = ""
    reason: str = ""
    digits: int | None = None

    @property
    def shown(self) -> str:
        """The true value as in the verdict: `0.094 N`, or "none"."""
        if self.digits is None or not math.isfinite(self.true):
            return number(self.true, self.unit) or "none"
        return f"{fixed(self.true, self.digits)} {self.unit}".rstrip()

    @property
    def name(self) -> str:
        """Short name, with the reason if the value does not exist."""
        return (self.short or self.text) + (f", {self.reason}" if math.isnan(self.true) else "")


def number(value: float, unit: str = "") -> str:
    """`value` with four digits; `never` for infinity, "" for NaN."""
    if math.isnan(value):
        return ""
    return f"{value:.4g} {unit}".rstrip() if math.isfinite(value) else "never"


def outcome(run: "ReportRun") -> str:
    """Return the first measures in a sentence; "" if no force was held."""
    values = run.outcome
    if not values or values["hold_error"].value is None:
        return ""
    large = (values["hold_overshoot"].value or 0.0) > LARGE_OVERSHOOT
    first = "; ".join(first_measures(values))
    return f"Overshoot beyond {100.0 * LARGE_OVERSHOOT:g} %: {first}" if large else f"{first[0].upper()}{first[1:]}"


def measures(run: "ReportRun") -> list[RunMeasure]:
    """All measures that `run` holds the series for, the force first."""
    found = _of_the_table(run)
    if run.has("plant.F_ee_B"):
        found += _force(run)
    if run.has("plant.p_B"):
        found += _path(run)
    if run.has(*(f"drive/{joint}.omega_m" for joint in (1, 2, 3))):
        found += _drives(run)
    if run.has("monitor.tripped"):
        found.append(RunMeasure("safety monitor tripped at", "s", trip_time(run.recording)))
    return found


def scored(run: "ReportRun") -> dict[str, float]:
    """What is judged of the truth, by short name; only what has a number, or never happened."""
    return {m.short: m.true for m in run.measures if m.short and not math.isnan(m.true)}


def key_measures(runs: Sequence["ReportRun"]) -> list[list[RunMeasure]]:
    """Return the key numbers of each run: the first of `KEYS` that all runs have.

    Where a force is held, a first measure without a value is among them, as chatter that is too small to be reported.
    """
    found = [{name: m for m in run.measures for name in (m.short, m.text) if name and _is_key(m, run)} for run in runs]
    shared = [name for name in KEYS if all(name in own for own in found)][
        : MOST_BOXED_NUMBERS if len(runs) == 1 else MOST_BOXED_OF_SEVERAL
    ]
    return [[own[name] for name in shared] for own in found]


def _is_key(measure: RunMeasure, run: "ReportRun") -> bool:
    held = bool(run.outcome) and run.outcome["hold_error"].value is not None
    missing = held and measure.text in KEYS[: len(HEADLINE)] and measure.reason != NOT_FOR_TASKS
    return missing or not math.isnan(measure.true)


def unscored(run: "ReportRun", asked: Container[str]) -> dict[str, list[str]]:
    """Why measures are not there: what is missing -> their short names.

    Args:
        asked: short names of the measures that are wanted besides those that a series is missing for.
    """
    wanted = {"its tasks": FIG5} | SERIES_OF_MEASURES if run.values.get("task") else SERIES_OF_MEASURES
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


def _of_the_table(run: "ReportRun") -> list[RunMeasure]:
    """Return the measures of `twin.robot.run.measures`, true and, for a force, by the robot's own force."""
    found = []
    for measure in TABLE if run.outcome else ():
        one = run.outcome[measure.key]
        # the robot has these by its own force, too
        own = run.believed_outcome.get(measure.key) if measure.key in OF_A_FORCE else None
        if one.value is None and measure.key not in HEADLINE:
            continue
        true, believed = (
            math.nan if v is None else measure.unit.per_SI * v for v in (one.value, own.value if own else None)
        )
        short = measure.text if measure.key in SCORED else ""
        found.append(RunMeasure(measure.text, measure.unit.text, true, believed, short, one.reason, measure.digits))
    return found


def _force(run: "ReportRun") -> list[RunMeasure]:
    t = run.times["plant"]
    F_z = -run.recording["plant.F_ee_B"][:, 2]
    # not the force's z component: pulling sideways on a tilted surface has one, too
    touching = (run.recording["plant.F_n"] if run.has("plant.F_n") else F_z) > 0.0
    found = [RunMeasure("first touch at", "s", first_time(t, touching))]
    if np.any(touching) and run.has("controller.F_z"):
        believed = run.held("controller.F_z", t)
        text = "error of the estimated force in contact, rms"
        found.append(RunMeasure(text, "N", rms((believed - F_z)[touching]), short="the estimated force"))
    return found


def _path(run: "ReportRun") -> list[RunMeasure]:
    t, p_B = run.times["plant"], run.recording["plant.p_B"]
    found = []
    if run.has("controller.p_ref_B"):
        off = MM * (p_B - run.held("controller.p_ref_B", t))
        across = np.hypot(off[:, 0], off[:, 1])
        found.append(RunMeasure("horizontal distance from the reference, largest", "mm", float(across.max())))
    if run.has("estimator.p_B"):
        error = np.linalg.norm(run.held("estimator.p_B", t) - p_B, axis=1)
        found.append(
            RunMeasure("error of the estimated position, rms", "mm", MM * rms(error), short="the estimated position")
        )
    return found


def _drives(run: "ReportRun") -> list[RunMeasure]:
    worst = max(float(np.abs(run.recording[f"drive/{joint}.omega_m"]).max()) for joint in (1, 2, 3))
    return [RunMeasure("largest motor speed", "rad/s", worst)]


SUMMARY = "summary.json"


@dataclass(frozen=True)
class ReportRun:
    """A recording with a name that no other run of the report has."""

    label: str
    recording: Recording

    @property
    def name(self) -> str:
        """Of the experiment, or of the file of a system."""
        if "system" in self.recording.metadata:
            return Path(self.recording.metadata["system"]["file"]).stem
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
    def outcome(self) -> Values:
        """Its measures by key; empty without a true force."""
        return self._measured(self.recording)

    @cached_property
    def believed_outcome(self) -> Values:
        """Measures of the held force by the controller's own force."""
        return self._measured(BelievedRun(self.recording)) if self.has("controller.F_z") else {}

    def _measured(self, run: RunView) -> Values:
        if not self.has("plant.F_ee_B"):
            return {}
        if not self.recording.complete:
            return unmeasured("the run ended early")
        found = outcome_of(run, HoldRequest.recorded(self.values))
        return found.measures if found else {}

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
        return self.recording[key][held_samples(self.times[key.rpartition(".")[0]], t)]


def report_runs(paths: Sequence[Path]) -> list[ReportRun]:
    """The runs meant by `paths`: folders, .mcap files, or results/EXPERIMENT for the latest.

    Runs of one experiment are distinguished by the name of their folder.

    Raises:
        RecordingRefused: one is missing, empty, damaged or foreign.
        InputRefused: one holds no samples, or is given twice.
    """
    recordings = [read(recording_in(path)) for path in paths]
    for path, recording in zip(paths, recordings, strict=True):
        if not any(len(stream.records) for stream in recording.streams.values()):
            note = f" ({recording.note})" if recording.note else ""
            raise InputRefused(f"{path}: holds no samples{note}; there is nothing to report, run it again")
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


FIG4 = "fig4"
"""How the names of experiments begin that follow the paper's Fig. 4."""
IMPERFECT = "fig4_imperfect"
"""How those begin of a robot and a scale that are not symmetrical."""
ON_TRUTH = "Judged on the true contact force, force-position run"


@dataclass(frozen=True)
class RunGroup:
    """Claims that belong together: of a figure, or of one task."""

    title: str
    findings: tuple[ClaimFinding, ...]
    name: str = PAPERS


@dataclass(frozen=True)
class PageVerdict:
    """How the runs went.

    Attributes:
        headline: one sentence.
        good: whether all is well; None if nothing was judged, or claims are among it that are known not to hold.
        remarks: what one has to know besides, worst first.
        groups: claims that were judged, empty if the runs are none that the paper says anything about.
        fig4, fig5: what the paper's picture is drawn from, if it applies.
    """

    headline: str
    good: bool | None
    remarks: tuple[str, ...]
    groups: tuple[RunGroup, ...]
    fig4: fig4_measures.Fig4Runs | None
    fig5: Fig5Score | None


def verdict(runs: Sequence[ReportRun]) -> PageVerdict:
    """Judge `runs`: Fig. 4 if there is one with force control and one without, Fig. 5 every run of tasks."""
    pair, why_not = _fig4_runs(runs)
    with_tasks = [run.recording for run in runs if run.values.get("task") and run.has("controller.task")]
    fig5 = fig5_score(with_tasks) if with_tasks else None
    groups: list[RunGroup] = []
    if pair is not None:
        score = fig4_score(pair)
        groups.append(RunGroup("The paper's Fig. 4, judged as the paper does, on estimates", score.claims))
        groups.append(RunGroup(ON_TRUTH, score.quality, OWN))
    elif len(runs) == 1 and (run := _force_position_run(runs[0])) is not None:
        # what we ask of the true force concerns this run alone
        groups.append(
            RunGroup(ON_TRUTH, tuple(judged(claim, fig4_measures.Fig4Runs(run, run)) for claim in QUALITY), OWN)
        )
    if fig5 is not None:
        labels = {run.recording.path: run.label for run in runs}
        for task in fig5.tasks:
            whose = f" of {labels[task.run.recording.path]}" if len(with_tasks) > 1 else ""
            groups.append(
                RunGroup(f"Task {task.name}{whose}: {task.manner}; {task.drive} on {task.body}", task.findings)
            )
    deviations, alarms = (
        _texts_by_run(runs, lambda run: (*run.recording.deviations, *run.recording.other_parts)),
        _texts_by_run(runs, _alarms),
    )
    findings = [finding for group in groups for finding in group.findings]
    remarks = [
        *(beside(runs) if len(runs) > 2 else ()),
        *alarms[1:],
        *deviations,
        *why_not,
    ]
    remarks += _texts_by_run(runs, _faults)
    holds, of = tally(findings)
    good: bool | None = None
    if failed(findings) or alarms:
        good = False
    elif of and holds == of:
        good = True
    return PageVerdict(_headline(runs, groups, alarms), good, tuple(filter(None, remarks)), tuple(groups), pair, fig5)


def _headline(runs: Sequence[ReportRun], groups: Sequence[RunGroup], alarms: Sequence[str]) -> str:
    # of more than two the page would begin with a paragraph: they are remarks
    clauses = [*alarms[:1], *not_scored(runs), *(beside(runs) if len(runs) == 2 else ())]
    for name in dict.fromkeys(group.name for group in groups):
        findings = [finding for group in groups if group.name == name for finding in group.findings]
        _, of = tally(findings)
        failing = [finding.claim.text for finding in findings if finding.verdict == "fails"]
        if failing:
            named = f": {failing[0]}" if len(failing) == 1 else ""
            clauses.append(f"{len(failing)} of {of} {name} {'fails' if len(failing) == 1 else 'fail'}{named}")
        elif of:
            clauses.append(claims_standing(findings, name))
    if len(runs) == 1 and (held := outcome(runs[0])):
        return "; ".join([held, *clauses])
    who = "The run is" if len(runs) == 1 else f"All {len(runs)} runs are"
    return "; ".join(clauses) or f"{who} complete, without failure or trip; no claim applies"


def beside(runs: Sequence[ReportRun]) -> list[str]:
    """Compare each run with the first, in a sentence; empty for one run."""
    first = runs[0]
    return [
        one_run_each((run.label, first.label), (run.outcome, first.outcome), (run.values, first.values))
        for run in runs[1:]
    ]


def not_scored(runs: Sequence[ReportRun]) -> list[str]:
    """What a run cannot be judged by although another one is, or because it lacks a series: it may hide a loss."""
    known = {name for run in runs for name in scored(run)}
    return [
        f"not scored{f' of {run.label}' if len(runs) > 1 else ''}: {', '.join(names)} ({why})"
        for run in runs
        for why, names in unscored(run, known).items()
    ]


def _fig4_runs(runs: Sequence[ReportRun]) -> tuple[fig4_measures.Fig4Runs | None, list[str]]:
    """The runs of Fig. 4, and what is to be said if one of the two is missing, or if they do not reach its end."""
    asked = [run for run in runs if _is_fig4(run, "force_position") or _is_fig4(run, "position")]
    ideal, imperfect = ([run for run in asked if run.name.startswith(IMPERFECT) == is_so] for is_so in (False, True))
    if not asked:
        return None, []
    # without the ideal ones, the imperfect runs are all there is
    pair, pair_in_x = _pair(ideal or imperfect), _pair(imperfect)
    if not pair:
        return None, ["Fig. 4 is scored on two runs, one with force control and one without: report those two together"]
    try:
        return fig4_measures.fig4_runs(*pair, *pair_in_x), []
    except InputRefused as problem:
        return None, [str(problem)]


def _pair(runs: Sequence[ReportRun]) -> list[Recording]:
    """The one with force control and the one without; empty if there is not exactly one of each."""
    modes = [[run.recording for run in runs if _is_fig4(run, mode)] for mode in ("force_position", "position")]
    return [one for mode in modes for one in mode] if [len(mode) for mode in modes] == [1, 1] else []


def _force_position_run(run: ReportRun) -> fig4_measures.Fig4Run | None:
    """Of Fig. 4; None if it is another, or none that can be judged."""
    if not _is_fig4(run, "force_position"):
        return None
    try:
        return fig4_measures.checked_run(run.recording)
    except InputRefused:
        return None


def _is_fig4(run: ReportRun, mode: str) -> bool:
    """Whether `run` follows the paper's Fig. 4 in a mode of the controller."""
    asked = run.name.startswith(FIG4) and run.values.get("controller", {}).get("mode") == mode
    return asked and run.has("controller.F_z", "plant.F_ee_B", "estimator.p_B", "scale.F_z")


def _texts_by_run(runs: Sequence[ReportRun], texts: Callable[[ReportRun], Iterable[str]]) -> list[str]:
    """`texts` of every run, of several under their names."""
    return [f"{run.label}: {text}" if len(runs) > 1 else text for run in runs for text in texts(run)]


def _alarms(run: ReportRun) -> list[str]:
    """What is wrong with a run: it is not whole, a component failed, the monitor tripped."""
    note = run.recording.note
    texts = [f"{note[0].upper()}{note[1:]}"] if note else []
    serious = [event for event in run.recording.events if event.level in ("error", "fatal")]
    return texts + [f"{event.text} ({event.time:.3f} s)" for event in serious]


def _faults(run: ReportRun) -> list[str]:
    return [f"injected on purpose: {json.dumps(fault)}" for fault in run.values.get("fault", ())]


def draw_one_run(run: fig4_measures.Fig4Run, path: Path) -> None:
    """Write the picture to `path` (PNG): the robot's own estimates coloured, the truth dotted."""
    with picture(path, 12, 7.5, by_hand=True) as figure:
        (height, force), (x, y) = figure.subplots(2, 2, sharex=True)
        # a layout that is worked out draws everything twice
        figure.subplots_adjust(left=0.075, right=0.99, top=0.96, bottom=0.07, hspace=0.12, wspace=0.2)
        height.plot(run.t, 1e3 * run.z_cmd, color=fig4_measures.FP_REFERENCE, lw=1.2, label="after the force loop")
        height.plot(run.t, 1e3 * run.z_ref, color=fig4_measures.PRE_DEFINE, lw=1.6, label="pre-defined")
        height.plot(run.t, 1e3 * run.z, color=fig4_measures.FP_BASED, lw=1.6, label="estimated")
        _dotted(height, run.t_plant, 1e3 * run.true_z)
        height.set_ylabel("z position (mm)")
        force.plot(
            run.t, run.recording["controller.F_z_ref"], color=fig4_measures.PRE_DEFINE, lw=1.6, label="reference"
        )
        force.plot(run.t, run.F_z, color=fig4_measures.FP_BASED, lw=1.6, label="estimated")
        _dotted(force, run.t_plant, run.true_F_z)
        force.set_ylabel("F_z, pressing (N)")
        for axes, axis, letter in ((x, 0, "x"), (y, 1, "y")):
            axes.plot(run.t, run.F_ee_B[:, axis], color=fig4_measures.FP_BASED, lw=0.9, label="estimated")
            _dotted(axes, run.t_plant, run.true_F_ee_B[:, axis])
            axes.set(ylabel=f"F_{letter} (N)", xlabel="time (s)")
        for axes, letter in zip((height, force, x, y), "ABCD", strict=True):
            axes.set_title(letter, loc="left", fontweight="bold")
            axes.legend()


def _dotted(axes: Axes, t: Curve, values: Curve) -> None:
    axes.plot(t, values, color=fig4_measures.TRUTH, lw=0.9, ls=":", label="true")
