"""The verdict of a report: the outcome in a sentence, and every claim behind it.

One run in the panels and colours that the caption of Fig. 4 names: height, pressing force, F_x and F_y.
"""

import json
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from twin.kernel.errors import InputRefused
from twin.kernel.recording.reader import Recording
from twin.report.page.run import ReportRun, outcome, scored, unscored
from twin.studies.figure import Axes, picture
from twin.studies.metrics.requirement import standing
from twin.studies.metrics.response import Curve
from twin.studies.paper.claim import ClaimFinding, judged
from twin.studies.paper.fig4 import QUALITY, failed, fig4_score, tally
from twin.studies.paper.fig4 import standing as claims_standing
from twin.studies.paper.fig4_measures import (
    FP_BASED,
    FP_REFERENCE,
    PRE_DEFINE,
    TRUTH,
    Fig4Run,
    Fig4Runs,
    checked_run,
    fig4_runs,
)
from twin.studies.paper.fig5 import Fig5Score, fig5_score

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


@dataclass(frozen=True)
class PageVerdict:
    """How the runs went.

    Attributes:
        headline: one sentence.
        good: whether all is well; None if there was nothing to judge.
        remarks: what one has to know besides, worst first.
        groups: claims that were judged, empty if the runs are none that the paper says anything about.
        fig4, fig5: what the paper's picture is drawn from, if it applies.
    """

    headline: str
    good: bool | None
    remarks: tuple[str, ...]
    groups: tuple[RunGroup, ...]
    fig4: Fig4Runs | None
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
        groups.append(RunGroup(ON_TRUTH, score.quality))
    elif len(runs) == 1 and (run := _force_position_run(runs[0])) is not None:
        # what we ask of the true force concerns this run alone
        groups.append(RunGroup(ON_TRUTH, tuple(judged(claim, Fig4Runs(run, run)) for claim in QUALITY)))
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
        *(outcome(run) for run in runs if len(runs) == 1 and findings),
        *why_not,
    ]
    remarks += _texts_by_run(runs, _faults)
    good = None if not findings and not alarms else not failed(findings) and not alarms
    return PageVerdict(_headline(runs, findings, alarms), good, tuple(filter(None, remarks)), tuple(groups), pair, fig5)


def _headline(runs: Sequence[ReportRun], findings: Sequence[ClaimFinding], alarms: Sequence[str]) -> str:
    # of more than two the page would begin with a paragraph: they are remarks
    clauses = [*alarms[:1], *not_scored(runs), *(beside(runs) if len(runs) == 2 else ())]
    _, of = tally(findings)
    failing = [finding.claim.text for finding in findings if finding.verdict == "fails"]
    if failing:
        named = f": {failing[0]}" if len(failing) == 1 else ""
        clauses.append(f"{len(failing)} of {of} claims {'fails' if len(failing) == 1 else 'fail'}{named}")
    elif of:
        clauses.append(claims_standing(findings))
    outcomes = [outcome(run) for run in runs]
    if not clauses and len(runs) == 1 and outcomes[0]:
        return outcomes[0]
    who = "The run is" if len(runs) == 1 else f"All {len(runs)} runs are"
    return "; ".join(clauses) or f"{who} complete, without failure or trip; no claim applies"


def beside(runs: Sequence[ReportRun]) -> list[str]:
    """In what each run but the first is better or worse than the first; nothing of one run."""
    return [standing(scored(run), scored(runs[0])).sentence(run.label, runs[0].label) for run in runs[1:]]


def not_scored(runs: Sequence[ReportRun]) -> list[str]:
    """What a run cannot be judged by although another one is, or because it lacks a series: it may hide a loss."""
    known = {name for run in runs for name in scored(run)}
    return [
        f"not scored{f' of {run.label}' if len(runs) > 1 else ''}: {', '.join(names)} ({why})"
        for run in runs
        for why, names in unscored(run, known).items()
    ]


def _fig4_runs(runs: Sequence[ReportRun]) -> tuple[Fig4Runs | None, list[str]]:
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
        return fig4_runs(*pair, *pair_in_x), []
    except InputRefused as problem:
        return None, [str(problem)]


def _pair(runs: Sequence[ReportRun]) -> list[Recording]:
    """The one with force control and the one without; empty if there is not exactly one of each."""
    modes = [[run.recording for run in runs if _is_fig4(run, mode)] for mode in ("force_position", "position")]
    return [one for mode in modes for one in mode] if [len(mode) for mode in modes] == [1, 1] else []


def _force_position_run(run: ReportRun) -> Fig4Run | None:
    """Of Fig. 4; None if it is another, or none that can be judged."""
    if not _is_fig4(run, "force_position"):
        return None
    try:
        return checked_run(run.recording)
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


def draw_one_run(run: Fig4Run, path: Path) -> None:
    """Write the picture to `path` (PNG): the robot's own estimates coloured, the truth dotted."""
    with picture(path, 12, 7.5, by_hand=True) as figure:
        (height, force), (x, y) = figure.subplots(2, 2, sharex=True)
        # a layout that is worked out draws everything twice
        figure.subplots_adjust(left=0.075, right=0.99, top=0.96, bottom=0.07, hspace=0.12, wspace=0.2)
        height.plot(run.t, 1e3 * run.z_cmd, color=FP_REFERENCE, lw=1.2, label="after the force loop")
        height.plot(run.t, 1e3 * run.z_ref, color=PRE_DEFINE, lw=1.6, label="pre-defined")
        height.plot(run.t, 1e3 * run.z, color=FP_BASED, lw=1.6, label="estimated")
        _dotted(height, run.t_plant, 1e3 * run.true_z)
        height.set_ylabel("z position (mm)")
        force.plot(run.t, run.recording["controller.F_z_ref"], color=PRE_DEFINE, lw=1.6, label="reference")
        force.plot(run.t, run.F_z, color=FP_BASED, lw=1.6, label="estimated")
        _dotted(force, run.t_plant, run.true_F_z)
        force.set_ylabel("F_z, pressing (N)")
        for axes, axis, letter in ((x, 0, "x"), (y, 1, "y")):
            axes.plot(run.t, run.F_ee_B[:, axis], color=FP_BASED, lw=0.9, label="estimated")
            _dotted(axes, run.t_plant, run.true_F_ee_B[:, axis])
            axes.set(ylabel=f"F_{letter} (N)", xlabel="time (s)")
        for axes, letter in zip((height, force, x, y), "ABCD", strict=True):
            axes.set_title(letter, loc="left", fontweight="bold")
            axes.legend()


def _dotted(axes: Axes, t: Curve, values: Curve) -> None:
    axes.plot(t, values, color=TRUTH, lw=0.9, ls=":", label="true")
