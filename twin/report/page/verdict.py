"""Verdict on the runs of a report: a headline, and the claims that support it."""

import json
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

from twin.kernel.errors import InputRefused
from twin.kernel.recording.reader import Recording
from twin.report.page.run import ReportRun, outcome_text, scored_values, unscored_reasons
from twin.robot.run.measures import ROWS_BY_KEY
from twin.studies.metrics.standing import compare_single_runs
from twin.studies.paper import fig4_measures
from twin.studies.paper.claim import OWN_CHECKS, PAPER_CLAIMS, ClaimFinding, judge_claim, keys_with_verdict, tally
from twin.studies.paper.claim import standing_text as claims_standing
from twin.studies.paper.fig4 import QUALITY_CLAIMS, fig4_score
from twin.studies.paper.fig5 import Fig5Score, fig5_score

FIG4_PREFIX = "fig4"
"""Name prefix of experiments that follow the paper's Fig. 4."""
IMPERFECT_PREFIX = "fig4_imperfect"
"""Name prefix of experiments with a misaligned robot and scale."""
TRUTH_TITLE = "Judged on the true contact force, force-position run"


@dataclass(frozen=True)
class RunGroup:
    """Judged claims of the paper about one figure or one task."""

    title: str
    findings: tuple[ClaimFinding, ...]
    name: str = PAPER_CLAIMS


@dataclass(frozen=True)
class PageVerdict:
    """Verdict of the report on its runs: headline, remarks (worst first) and judged claims, empty without any.

    `good`: all claims hold; None if nothing was judged, or if claims are expected not to hold. `fig4` and `fig5` are
    data of the paper's picture, None if it does not apply.
    """

    headline: str
    good: bool | None
    remarks: tuple[str, ...]
    groups: tuple[RunGroup, ...]
    fig4: fig4_measures.Fig4Runs | None
    fig5: Fig5Score | None


def verdict(runs: Sequence[ReportRun]) -> PageVerdict:
    """Judge runs by the paper's claims: Fig. 4 for runs with and without force control, Fig. 5 for runs of tasks."""
    pair, why_not = _fig4_runs(runs)
    with_tasks = [run.recording for run in runs if run.values.get("task") and run.has("controller.task")]
    fig5 = fig5_score(with_tasks) if with_tasks else None
    groups: list[RunGroup] = []
    if pair is not None:
        score = fig4_score(pair)
        groups.append(RunGroup("The paper's Fig. 4, judged as the paper does, on estimates", score.claims))
        groups.append(RunGroup(TRUTH_TITLE, score.quality, OWN_CHECKS))
    elif len(runs) == 1 and (run := _force_position_run(runs[0])) is not None:
        # twin's own checks of the true force need this run only
        quality = tuple(judge_claim(claim, fig4_measures.Fig4Runs(run, run)) for claim in QUALITY_CLAIMS)
        groups.append(RunGroup(TRUTH_TITLE, quality, OWN_CHECKS))
    if fig5 is not None:
        labels = {run.recording.path: run.label for run in runs}
        for task in fig5.tasks:
            whose = f" of {labels[task.path]}" if len(with_tasks) > 1 else ""
            title = f"Task {task.name}{whose}: {task.manner}; {task.drive} on {task.body}"
            groups.append(RunGroup(title, task.findings))
    deviations = _texts_by_run(runs, lambda run: (*run.recording.deviations, *run.recording.other_parts))
    alarms = _texts_by_run(runs, _alarms)
    findings = [finding for group in groups for finding in group.findings]
    remarks = [*(comparison_sentences(runs) if len(runs) > 2 else ()), *alarms[1:], *deviations, *why_not]
    remarks += _texts_by_run(runs, _faults)
    holds, of = tally(findings)
    good: bool | None = None
    if keys_with_verdict(findings, "fails") or alarms:
        good = False
    elif of and holds == of:
        good = True
    return PageVerdict(_headline(runs, groups, alarms), good, tuple(filter(None, remarks)), tuple(groups), pair, fig5)


def _headline(runs: Sequence[ReportRun], groups: Sequence[RunGroup], alarms: Sequence[str]) -> str:
    # comparisons of more than two runs would make the headline a paragraph: they are remarks
    clauses = [*alarms[:1], *unscored_sentences(runs), *(comparison_sentences(runs) if len(runs) == 2 else ())]
    for name in dict.fromkeys(group.name for group in groups):
        findings = [finding for group in groups if group.name == name for finding in group.findings]
        _, of = tally(findings)
        failing = [finding.claim.text for finding in findings if finding.verdict == "fails"]
        if failing:
            named = f": {failing[0]}" if len(failing) == 1 else ""
            clauses.append(f"{len(failing)} of {of} {name} {'fails' if len(failing) == 1 else 'fail'}{named}")
        elif of:
            clauses.append(claims_standing(findings, name))
    if len(runs) == 1 and (held := outcome_text(runs[0])):
        return "; ".join([held, *clauses])
    who = "The run is" if len(runs) == 1 else f"All {len(runs)} runs are"
    return "; ".join(clauses) or f"{who} complete, without failure or trip; no claim applies"


def comparison_sentences(runs: Sequence[ReportRun]) -> list[str]:
    """Compare the measures of each run with the first run's, a sentence each; empty for one run."""
    first = runs[0]
    return [
        compare_single_runs((run.label, first.label), (run.outcome, first.outcome), (run.values, first.values))
        for run in runs[1:]
    ]


def unscored_sentences(runs: Sequence[ReportRun]) -> list[str]:
    """Describe the hold error and the measures that a run lacks although another has them, or for want of a series."""
    # a missing measure may hide a loss
    known = {ROWS_BY_KEY["hold_error"].text, *(name for run in runs for name in scored_values(run))}
    return [
        f"not scored{f' of {run.label}' if len(runs) > 1 else ''}: {', '.join(names)} ({why})"
        for run in runs
        for why, names in unscored_reasons(run, known).items()
    ]


def _fig4_runs(runs: Sequence[ReportRun]) -> tuple[fig4_measures.Fig4Runs | None, list[str]]:
    """Return the runs of Fig. 4, or None and a message if one of the two is missing or they are too short."""
    asked = [run for run in runs if _is_fig4(run, "force_position") or _is_fig4(run, "position")]
    ideal, imperfect = (
        [run for run in asked if run.name.startswith(IMPERFECT_PREFIX) == is_so] for is_so in (False, True)
    )
    if not asked:
        return None, []
    # without aligned runs, use the misaligned ones
    pair, pair_in_x = _pair(ideal or imperfect), _pair(imperfect)
    if not pair:
        return None, ["Fig. 4 is scored on two runs, one with force control and one without: report those two together"]
    try:
        return fig4_measures.fig4_runs(*pair, *pair_in_x), []
    except InputRefused as problem:
        return None, [str(problem)]


def _pair(runs: Sequence[ReportRun]) -> list[Recording]:
    """Return the recordings of Fig. 4 with and without force control; empty unless there is exactly one of each."""
    modes = [[run.recording for run in runs if _is_fig4(run, mode)] for mode in ("force_position", "position")]
    return [one for mode in modes for one in mode] if [len(mode) for mode in modes] == [1, 1] else []


def _force_position_run(run: ReportRun) -> fig4_measures.Fig4Run | None:
    """Return the run as force-position run of Fig. 4; None for any other run, or if it cannot be judged."""
    if not _is_fig4(run, "force_position"):
        return None
    try:
        return fig4_measures.checked_run(run.recording)
    except InputRefused:
        return None


def _is_fig4(run: ReportRun, mode: str) -> bool:
    """Whether a run follows the paper's Fig. 4 in a mode of the controller."""
    asked = run.name.startswith(FIG4_PREFIX) and run.values.get("controller", {}).get("mode") == mode
    return asked and run.has("controller.F_z", "plant.F_ee_B", "estimator.p_B", "scale.F_z")


def _texts_by_run(runs: Sequence[ReportRun], texts: Callable[[ReportRun], Iterable[str]]) -> list[str]:
    """Return texts about all runs, prefixed with the runs' labels if there are several."""
    return [f"{run.label}: {text}" if len(runs) > 1 else text for run in runs for text in texts(run)]


def _alarms(run: ReportRun) -> list[str]:
    """List the defects of a run: an incomplete recording, component failures, trips of the monitor."""
    note = run.recording.note
    texts = [f"{note[0].upper()}{note[1:]}"] if note else []
    serious = [event for event in run.recording.events if event.level in ("error", "fatal")]
    return texts + [f"{event.text} ({event.time:.3f} s)" for event in serious]


def _faults(run: ReportRun) -> list[str]:
    return [f"injected on purpose: {json.dumps(fault)}" for fault in run.values.get("fault", ())]
