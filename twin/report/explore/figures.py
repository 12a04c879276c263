"""The paper's figures for a state of the page: their experiments, and the verdicts on the paper's claims.

Fig. 4 takes four runs: with and without force control, on an aligned robot and scale and on the misaligned ones of
fig4_imperfect.toml; the state is applied to all four. Fig. 5 takes one run of tasks.
"""

from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

from twin.report.explore.page_state import PageState
from twin.robot.assembly.load import load_experiment
from twin.robot.experiment.experiment import Experiment
from twin.robot.experiment.experiment_files import experiment_file
from twin.robot.experiment.source import toml_value
from twin.robot.run.trace import Trace, run_in_memory
from twin.studies.metrics.required_series import FIG4_SERIES, FIG5_SERIES
from twin.studies.paper.claim import ClaimFinding, judge_claim, tally
from twin.studies.paper.fig4 import FIG4_EXPERIMENTS, fig4_score
from twin.studies.paper.fig4_measures import MIN_DURATION, Fig4Run, Fig4Runs
from twin.studies.paper.fig5 import TASK_CLAIMS
from twin.studies.paper.task_run import TaskRun
from twin.studies.sweep.claims import COMPANION_SETTING, require_fig4_claims

Figure = Literal["fig4", "fig5"]
FORCE_CONTROL = 'controller.mode="force_position"'
FIG5_SIGNALS = (*FIG5_SERIES, "monitor.tripped")


def figure_of(experiment: Experiment) -> Figure | None:
    """Return the paper's figure that an experiment reproduces; None for other experiments."""
    if experiment.tasks:
        return "fig5"
    whole = experiment.duration_ticks * experiment.cosim.tick >= MIN_DURATION
    return "fig4" if whole and "mode" in experiment.values["controller"] else None


@lru_cache(1)
def _imperfection_settings() -> tuple[str, ...]:
    """Return the --set options that turn the aligned experiments into fig4_imperfect.toml."""
    straight, askew = (load_experiment(FIG4_EXPERIMENTS[number]).values for number in (0, 2))
    return tuple(
        f"{name}.{key}={toml_value(value)}"
        for name, table in askew.items()
        if isinstance(table, Mapping)
        for key, value in table.items()
        if straight[name].get(key) != value
    )


def fig4_experiments(state: PageState) -> list[Experiment]:
    """Return the four experiments of the paper's Fig. 4, with the changes of `state` applied to each.

    An explored file that is not among them replaces the first one, and the others differ from it as from that.
    """
    own = experiment_file(state.base.experiment).resolve()
    base = FIG4_EXPERIMENTS[0] if own in map(Path.resolve, map(experiment_file, FIG4_EXPERIMENTS)) else own
    found = [
        load_experiment(base, [*askew, *state.settings, mode], state.drive, state.body)
        for askew in ((), _imperfection_settings())
        for mode in (FORCE_CONTROL, COMPANION_SETTING)
    ]
    require_fig4_claims(found[0])
    return found


def fig4_runs(state: PageState, known: tuple[Experiment, Trace] | None = None) -> Fig4Runs:
    """Simulate the experiments of the paper's Fig. 4 with the changes of `state`; a `known` run is reused."""
    own = known[0].values if known else None
    titled = {"title": own["title"]} if own else {}
    first, second, *others = [
        Fig4Run(known[1] if known and one.values | titled == own else run_in_memory(one, only=FIG4_SERIES))
        for one in fig4_experiments(state)
    ]
    return Fig4Runs(first, second, (others[0], others[1]))


def claims(state: PageState) -> dict[str, Any]:
    """Judge the paper's claims on simulated runs with the changes of `state`, JSON-serialisable."""
    experiment = state.load()
    if figure_of(experiment) == "fig5":
        trace = run_in_memory(experiment, only=FIG5_SIGNALS)
        tasks = [TaskRun(trace, number, task) for number, task in enumerate(experiment.tasks, start=1)]
        rows = [
            (f"{run.number} {run.task.kind}: ", judge_claim(claim, run))
            for run in tasks
            for claim in TASK_CLAIMS[run.task.kind]
        ]
        scores = [_score("of the paper's Fig. 5", [finding for _, finding in rows])]
        return {"figure": "fig5", "claims": [_claim(*row) for row in rows], "scores": scores}
    score = fig4_score(fig4_runs(state))
    found = [one for one in (*score.claims, *score.quality) if one.claim.measure is not None]
    scores = [_score("of the paper's text", score.claims), _score("of this run's own checks", score.quality)]
    return {"figure": "fig4", "claims": [_claim("", one) for one in found], "scores": scores}


def _score(of: str, findings: Sequence[ClaimFinding]) -> dict[str, Any]:
    """Count the paper's claims that hold, JSON-serialisable, as `twin compare --paper` counts them."""
    held, judged_claims = tally(findings)
    return {"of": of, "held": held, "judged": judged_claims}


def _claim(of: str, finding: ClaimFinding) -> dict[str, Any]:
    return {
        "text": f"{of}{finding.claim.text}",
        "quote": finding.claim.quote,
        "verdict": finding.verdict,
        "measured": finding.measured_text,
        "expected": f"{finding.claim.bounds_text} {finding.claim.unit}".rstrip(),
        "reason": finding.reason,
    }
