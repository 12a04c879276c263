"""The paper's figures of a state: their experiments, the verdicts on the paper's claims, the panels of Fig. 4.

Fig. 4 takes four runs: with force control and without it, on a robot and a scale that stand straight and on those of
fig4_imperfect.toml; the state is laid over all four. Fig. 5 takes one run of tasks.
"""

from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal, cast

import numpy as np

from twin.report.explore.asked import PageState
from twin.report.explore.picture import drawn
from twin.report.page.markup import DataBlock
from twin.report.page.panels import MM, Panel, PanelCurve, Reader, Samples
from twin.robot.assembly.load import load_experiment
from twin.robot.experiment.drive_files import experiment_file
from twin.robot.experiment.experiment import Experiment
from twin.robot.experiment.source import toml_value
from twin.robot.run.trace import Trace, run_in_memory
from twin.studies.metrics.requirement import FIG4, FIG5
from twin.studies.paper.claim import ClaimFinding, judged
from twin.studies.paper.fig4 import FIG4_EXPERIMENTS, fig4_score, tally
from twin.studies.paper.fig4_measures import WHOLE, Fig4Run, Fig4Runs
from twin.studies.paper.fig5 import CLAIMS
from twin.studies.paper.fig5_measures import TaskRun
from twin.studies.sweep.claims import COMPANION, refuse_unfit

Figure = Literal["fig4", "fig5"]
FORCE_CONTROL = 'controller.mode="force_position"'
FIG5_SIGNALS = (*FIG5, "monitor.tripped")
"""Signals that the claims of Fig. 5 are judged on."""


def figure_of(experiment: Experiment) -> Figure | None:
    """The figure that an experiment is one of; None: of none."""
    if experiment.tasks:
        return "fig5"
    whole = experiment.duration_ticks * experiment.cosim.tick >= WHOLE
    return "fig4" if whole and "mode" in experiment.values["controller"] else None


@lru_cache(1)
def _askew() -> tuple[str, ...]:
    """As --set takes it, what sets robot and scale of fig4_imperfect.toml apart from those that stand straight."""
    straight, askew = (load_experiment(FIG4_EXPERIMENTS[number]).values for number in (0, 2))
    return tuple(
        f"{name}.{key}={toml_value(value)}"
        for name, table in askew.items()
        if isinstance(table, Mapping)
        for key, value in table.items()
        if straight[name].get(key) != value
    )


def fig4_experiments(state: PageState) -> list[Experiment]:
    """The four of Fig. 4 in the order of `FIG4_EXPERIMENTS`, `state` laid over each.

    Of another file than those the first one is the file itself; the others are made of it as they are of the first.

    Raises:
        InputRefused: Fig. 4 cannot be asked of it.
    """
    own = experiment_file(state.base.experiment).resolve()
    base = FIG4_EXPERIMENTS[0] if own in map(Path.resolve, map(experiment_file, FIG4_EXPERIMENTS)) else own
    found = [
        load_experiment(base, [*askew, *state.settings, mode], state.drive, state.body)
        for askew in ((), _askew())
        for mode in (FORCE_CONTROL, COMPANION)
    ]
    refuse_unfit(found[0])
    return found


def fig4_runs(state: PageState, known: tuple[Experiment, Trace] | None = None) -> Fig4Runs:
    """Their runs.

    Args:
        state: of the page.
        known: an experiment with its run, which need not be made again.

    Raises:
        InputRefused: Fig. 4 cannot be asked of it.
        ComponentFailed: one failed.
    """
    own = known[0].values if known else None
    titled = {"title": own["title"]} if own else {}
    first, second, *others = [
        Fig4Run(known[1] if known and one.values | titled == own else run_in_memory(one, only=FIG4))
        for one in fig4_experiments(state)
    ]
    return Fig4Runs(first, second, (others[0], others[1]))


def task_runs(experiment: Experiment, trace: Trace) -> list[TaskRun]:
    """The tasks of a run in memory, which is read as a recording is."""
    return [TaskRun(cast(Any, trace), number, task) for number, task in enumerate(experiment.tasks, start=1)]


def claims(state: PageState) -> dict[str, Any]:
    """What the runs of a state say to the paper, for JSON.

    Raises:
        InputRefused: the paper says nothing of such an experiment.
        ComponentFailed: a run failed.
    """
    experiment = state.loaded()
    if figure_of(experiment) == "fig5":
        rows = [
            (f"{task.number} {task.task.kind}: ", judged(claim, task))
            for task in task_runs(experiment, run_in_memory(experiment, only=FIG5_SIGNALS))
            for claim in CLAIMS[task.task.kind]
        ]
        scores = [_score("of the paper's Fig. 5", [finding for _, finding in rows])]
        return {"figure": "fig5", "claims": [_claim(*row) for row in rows], "scores": scores}
    score = fig4_score(fig4_runs(state))
    found = [one for one in (*score.claims, *score.quality) if one.claim.measure is not None]
    scores = [_score("of the paper's text", score.claims), _score("of this run's own checks", score.quality)]
    return {"figure": "fig4", "claims": [_claim("", one) for one in found], "scores": scores}


def _score(of: str, findings: Sequence[ClaimFinding]) -> dict[str, Any]:
    """How many of some claims hold, for JSON; the same counts as of `twin compare --paper`."""
    held, judged_claims = tally(findings)
    return {"of": of, "held": held, "judged": judged_claims}


def _claim(of: str, finding: ClaimFinding) -> dict[str, Any]:
    return {
        "text": f"{of}{finding.claim.text}",
        "quote": finding.claim.quote,
        "verdict": finding.verdict,
        "measured": finding.measured,
        "expected": f"{finding.expected} {finding.claim.unit}".rstrip(),
        "reason": finding.reason,
    }


def _of_run(name: str, curve: str, scale: float = 1.0) -> Reader:
    """Reads a curve of one of the two straight runs at the controller's rate."""

    def samples(runs: Any) -> Samples:
        run = getattr(runs, name)
        return run.t, scale * getattr(run, curve)

    return samples


def _askew_force(number: int) -> Reader:
    def samples(runs: Any) -> Samples:
        run = runs.imperfect[number]
        return run.t, run.F_ee_B[:, 0]

    return samples


def _force_along_y(name: str) -> Reader:
    def samples(runs: Any) -> Samples:
        run = getattr(runs, name)
        return run.t, run.F_ee_B[:, 1]

    return samples


def _desired_force(runs: Any) -> Samples:
    run = runs.force_position
    return run.t, np.full(len(run.t), run.F_z_ref)


BLUE, VERMILION, ORANGE, INK = 0, 1, 4, 6
"""Numbers of the page's colours that are the nearest to the paper's."""
FIG4_PANELS = (
    Panel(
        "A: z position", "mm",
        (
            PanelCurve("Pre-define", "truth", _of_run("force_position", "z_ref", MM), BLUE),
            PanelCurve("P-based", "truth", _of_run("position", "z", MM), ORANGE),
            PanelCurve("F&P-based", "truth", _of_run("force_position", "z", MM), VERMILION),
            PanelCurve("F&P-based-ref", "reference", _of_run("force_position", "z_cmd", MM), INK),
        ),
    ),
    Panel(
        "B: F_z, pressing", "N",
        (
            PanelCurve("Pre-define", "truth", _desired_force, BLUE),
            PanelCurve("P-based", "truth", _of_run("position", "F_z"), ORANGE),
            PanelCurve("F&P-based", "truth", _of_run("force_position", "F_z"), VERMILION),
        ),
    ),
    Panel(
        "C: F_x, imperfect runs", "N",
        (
            PanelCurve("P-based", "truth", _askew_force(1), ORANGE),
            PanelCurve("F&P-based", "truth", _askew_force(0), VERMILION),
        ),
    ),
    Panel(
        "D: F_y", "N",
        (
            PanelCurve("P-based", "truth", _force_along_y("position"), ORANGE),
            PanelCurve("F&P-based", "truth", _force_along_y("force_position"), VERMILION),
        ),
    ),
)  # fmt: skip


def fig4_panels(runs: Fig4Runs, block: DataBlock, span: tuple[float, float], width: int) -> list[dict[str, Any]]:
    """Fig. 4 as the paper has it, by the controller's estimates; see `drawn`."""
    return drawn(FIG4_PANELS, runs, block, span, width)
