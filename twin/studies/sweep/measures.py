"""The numbers that a sweep keeps of a run: measures of what is true, with units in their names."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from twin.kernel.errors import InputRefused, nearest
from twin.robot.experiment.experiment import Experiment
from twin.studies.metrics.response import Curve
from twin.studies.packing import text_of, values_of
from twin.studies.paper.claim import as_facts
from twin.studies.paper.fig4 import fig4_score
from twin.studies.paper.fig4_measures import WHOLE, Fig4Runs

if TYPE_CHECKING:
    from twin.robot.experiment.measure import Measure
    from twin.robot.run.outcome import RunOutcome


PERIOD = 0.04
"""Between two samples (s): 500 of the 20 s of Fig. 4, about one per pixel of a panel."""


def packed(curves: Mapping[str, tuple[Curve, Curve]], end: float) -> dict[str, Any]:
    """`curves` for JSON as they are at 0, `PERIOD`, ... up to `end` (s), on lines between their samples.

    Args:
        curves: (times (s), values), each (n,), by name; times ascend.
    """
    t = np.arange(int(end / PERIOD + 1e-9) + 1) * PERIOD
    return {"period_s": PERIOD, "of": {name: text_of(np.interp(t, *curve)) for name, curve in curves.items()}}


def unpacked(kept: Mapping[str, Any]) -> tuple[Curve, dict[str, Curve]]:
    """(times (s), values by name) of what `packed` made.

    Raises:
        ValueError: it did not make this.
    """
    try:
        values = {name: values_of(text) for name, text in kept["of"].items()}
    except KeyError as problem:
        raise ValueError(str(problem)) from None
    if len({len(curve) for curve in values.values()}) != 1:
        raise ValueError("curves of different lengths")
    samples = len(next(iter(values.values())))
    t: Curve = np.arange(samples, dtype=float) * float(kept["period_s"])
    return t, values


COMPANION = 'controller.mode="position"'
"""The setting that makes the second run of a pair: the same plant, the same belief, no force loop."""


def refuse_unfit(experiment: Experiment) -> None:
    """Fig. 4 can be asked of it.

    Raises:
        InputRefused: it is too short, has massage tasks or no force control.
    """
    end = experiment.duration_ticks * experiment.cosim.tick
    if end < WHOLE:
        raise InputRefused(f'{experiment.name}: ends at {end:g} s; claims = "fig4" needs {WHOLE} s')
    if experiment.tasks or experiment.values["controller"].get("mode") != "force_position":
        raise InputRefused(
            f'{experiment.name}: claims = "fig4" needs controller.mode = "force_position" and no tasks; '
            "name fig4_force_position.toml, or one that extends it"
        )


def findings(runs: Fig4Runs) -> dict[str, Any]:
    """For the row: "claims", key -> {"value", "verdict"}, and "curves", see `twin.studies.sweep.measures`: height and
    forces of both runs as estimated and, from `true_`, as they are (m, N)."""
    # the plant drawn is the imperfect one
    score = fig4_score(replace(runs, imperfect=(runs.force_position, runs.position)))
    judged = [finding for finding in (*score.claims, *score.quality) if finding.claim.measure is not None]
    return {
        "claims": {
            str(facts["claim"]): {"value": facts["measured"], "verdict": facts["verdict"]}
            for facts in map(as_facts, judged)
        },
        "curves": _curves(runs),
    }


def _curves(runs: Fig4Runs) -> dict[str, Any]:
    curves = {"force_position.z_cmd": (runs.force_position.t, runs.force_position.z_cmd)}
    for name, run in (("force_position", runs.force_position), ("position", runs.position)):
        curves |= {
            f"{name}.z": (run.t, run.z),
            f"{name}.true_z": (run.t_plant, run.true_z),
            f"{name}.F_z": (run.t, run.F_z),
            f"{name}.true_F_z": (run.t_plant, run.true_F_z),
            f"{name}.F_x": (run.t, run.F_ee_B[:, 0]),
            f"{name}.F_y": (run.t, run.F_ee_B[:, 1]),
        }
    return packed(curves, WHOLE)


METRICS = ("force_error_N", "peak_N", "peak_time_s", "end_N", "lateral_error_mm", "z_error_mm", "early_trigger_s")
"""Of the plant, see `twin.robot.run.outcome.RunOutcome`."""
BY_KIND: dict[str, tuple[str, ...]] = {
    "step": (
        "delay_time", "rise_time", "settling_time_2", "settling_time_5", "overshoot", "peak", "steady_state_error",
        "IAE", "ISE", "ITAE",
    ),
    "tracking": ("rms_error", "max_error"),
    "lag": ("lag",),
    "spread": ("mean", "std"),
    "oscillation": ("amplitude", "frequency"),
    "onset": ("time",),
    "path": ("rms_error", "max_error"),
    "effort": ("commanded_travel", "work_delivered", "work_returned"),
    "requirement": ("distance",),
}  # fmt: skip
"""What `twin.studies.check.measurement` makes of each kind of [[measure]], SI; known before a run is made."""


@dataclass(frozen=True)
class RunFinding:
    """What became of one run.

    Attributes:
        status: "done"; "tripped": the safety monitor did; "failed": a component did, or the process died;
            "refused": these values make no experiment.
        reason: the sentence; "" if done.
        metrics: by the names of `METRICS`, and "measure.metric" of the experiment's measures; empty unless the run came
            to its end. None, or missing for a measure: there is no such number.
        seconds, stepping: wall time of everything, and of the master alone (s); nan if the process died.
        paper: what a sweep with `claims` keeps besides, see `findings`; empty unless the run
            is done.
    """

    status: str
    reason: str
    metrics: dict[str, float | None]
    seconds: float
    stepping: float
    paper: dict[str, Any] = field(default_factory=dict)

    @property
    def facts(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "status": self.status,
            "reason": self.reason,
            "metrics": self.metrics,
            "seconds": finite(self.seconds),
            "stepping_s": finite(self.stepping),
            **self.paper,
        }


def failure(reason: str) -> dict[str, Any]:
    """Facts of the `RunFinding` of a run whose process died."""
    return RunFinding("failed", reason, {}, math.nan, math.nan).facts


def metrics_of(outcome: "RunOutcome") -> dict[str, float | None]:
    """`outcome` by the names of `METRICS`."""
    values = (
        outcome.force_error, outcome.peak, outcome.peak_time, outcome.end,
        *(None if error is None else 1e3 * error for error in (outcome.lateral_error, outcome.z_error)),
        outcome.early_trigger,
    )  # fmt: skip
    return {name: finite(value) for name, value in zip(METRICS, values, strict=True)}


def metric_names(measures: Sequence["Measure"]) -> tuple[str, ...]:
    """Every metric that a run of an experiment with these `measures` may have."""
    return METRICS + tuple(f"{measure.name}.{metric}" for measure in measures for metric in BY_KIND[measure.kind])


def checked_metric(place: str, metric: str, known: Sequence[str]) -> str:
    """`metric` as it was given at `place`.

    Raises:
        InputRefused: it is none of those `known`.
    """
    if metric not in known:
        raise InputRefused(f"{place} {metric}: no such metric; {nearest(metric, known)}")
    return metric


def finite(value: float | None) -> float | None:
    """`value`, or None where JSON has no number for it."""
    return value if value is not None and math.isfinite(value) else None


def within(metrics: dict[str, float | None], limits: dict[str, float]) -> bool | None:
    """Whether a run keeps every limit; a number that is not there keeps none. None: there are no limits."""
    if not limits:
        return None
    values = {name: metrics.get(name) for name in limits}
    return all(value is not None and value <= limits[name] for name, value in values.items())
