"""What a report says first: how it went, in a sentence, and every claim behind it."""

import json
from collections.abc import Sequence
from dataclasses import dataclass

from twin.errors import InputRefused
from twin.paper.claim import Finding
from twin.paper.fig4_runs import Fig4Runs, fig4_runs
from twin.paper.fig5_score import Fig5Score, fig5_score
from twin.paper.score import fig4_score, tally
from twin.report.page.run import ReportRun

FIG4 = "fig4"
"""How the names of experiments begin that follow the paper's Fig. 4."""


@dataclass(frozen=True)
class Group:
    """Claims that belong together: of a figure, or of one task."""

    title: str
    findings: tuple[Finding, ...]


@dataclass(frozen=True)
class Verdict:
    """How the runs went.

    Attributes:
        headline: one sentence. bad: whether anything is wrong. remarks: what one has to know besides, worst first.
        groups: claims that were judged, empty if the runs are none that the paper says anything about.
        fig4, fig5: what the paper's picture is drawn from, if it applies.
    """

    headline: str
    bad: bool
    remarks: tuple[str, ...]
    groups: tuple[Group, ...]
    fig4: Fig4Runs | None
    fig5: Fig5Score | None


def verdict(runs: Sequence[ReportRun]) -> Verdict:
    """Judge `runs`: Fig. 4 if there is one with force control and one without, Fig. 5 every run of tasks."""
    pair, why_not = _fig4_pair(runs)
    with_tasks = [run.recording for run in runs if run.values.get("task") and run.has("controller.task")]
    fig5 = fig5_score(with_tasks) if with_tasks else None
    groups: list[Group] = []
    if pair is not None:
        score = fig4_score(pair)
        groups.append(Group("The paper's Fig. 4, judged as the paper does, on estimates", score.claims))
        groups.append(Group("Judged on the true contact force, force-position run", score.quality))
    if fig5 is not None:
        labels = {run.recording.path: run.label for run in runs}
        for task in fig5.tasks:
            of = f" of {labels[task.run.recording.path]}" if len(with_tasks) > 1 else ""
            groups.append(Group(f"Task {task.name}{of}: {task.manner}; {task.drive} on {task.body}", task.findings))
    alarms = [remark for run in runs for remark in _alarms(run, len(runs) > 1)]
    findings = [finding for group in groups for finding in group.findings]
    held, judged = tally(findings)
    said = [f"{held} of {judged} claims hold" if held == judged else f"{judged - held} of {judged} claims fail"]
    said = said if judged else []
    if alarms:
        said += ["something went wrong" if len(alarms) > 1 else alarms[0]]
    headline = "; ".join(said) or "No claim of the paper applies; no run tripped, failed or is incomplete"
    remarks = [*(alarms if len(alarms) > 1 or judged else ()), *why_not]
    remarks += [remark for run in runs for remark in _faults(run, len(runs) > 1)]
    return Verdict(headline, held < judged or bool(alarms), tuple(remarks), tuple(groups), pair, fig5)


def _fig4_pair(runs: Sequence[ReportRun]) -> tuple[Fig4Runs | None, list[str]]:
    """The two runs of Fig. 4, and what is to be said if there is only one of them, or if they do not reach its end."""
    modes: dict[str, list[ReportRun]] = {"force_position": [], "position": []}
    for run in runs:
        mode = run.values.get("controller", {}).get("mode")
        if run.name.startswith(FIG4) and mode in modes and run.has("controller.F_z", "plant.F_ee_B", "estimator.p_B"):
            modes[mode].append(run)
    with_force, without = modes["force_position"], modes["position"]
    if not with_force and not without:
        return None, []
    if len(with_force) != 1 or len(without) != 1:
        return None, ["Fig. 4 is scored on two runs, one with force control and one without: report those two together"]
    try:
        return fig4_runs(with_force[0].recording, without[0].recording), []
    except InputRefused as problem:
        return None, [str(problem)]


def _alarms(run: ReportRun, several: bool) -> list[str]:
    """What is wrong with a run: it is not whole, a component failed, the monitor tripped."""
    who = f"{run.label}: " if several else ""
    note = run.recording.note
    texts = [f"{note[0].upper()}{note[1:]}"] if note else []
    texts += [f"{event.text} ({event.time:.3f} s)" for event in run.recording.events if event.level == "error"]
    return [f"{who}{text}" for text in texts]


def _faults(run: ReportRun, several: bool) -> list[str]:
    who = f"{run.label}: " if several else ""
    return [f"{who}injected on purpose: {json.dumps(fault)}" for fault in run.values.get("fault", ())]
