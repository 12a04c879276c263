"""The claims of Fig. 4 on a run of a sweep and its companion without force control: verdicts and curves."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from twin.kernel.errors import InputRefused
from twin.kernel.serialise import to_dict
from twin.robot.experiment.experiment import Experiment
from twin.studies.metrics.response import Curve
from twin.studies.packing import text_of, values_of
from twin.studies.paper.fig4 import fig4_score
from twin.studies.paper.fig4_measures import MIN_DURATION, Fig4Runs

CURVE_PERIOD = 0.04
"""Sampling period of stored curves (s): 500 samples for the 20 s of Fig. 4, about one per pixel of a panel."""
COMPANION_SETTING = 'controller.mode="position"'
"""Setting of the second run of a pair: same plant, same belief, no force loop."""


def pack_curves(curves: Mapping[str, tuple[Curve, Curve]], end: float) -> dict[str, Any]:
    """Resample curves, name -> (ascending times (s), values), at a common period and encode them for JSON."""
    t = np.arange(int(end / CURVE_PERIOD + 1e-9) + 1) * CURVE_PERIOD
    return {"period_s": CURVE_PERIOD, "of": {name: text_of(np.interp(t, *curve)) for name, curve in curves.items()}}


def unpack_curves(stored: Mapping[str, Any]) -> tuple[Curve, dict[str, Curve]]:
    """Decode curves stored by `pack_curves` (else ValueError): (times (s), name -> values)."""
    try:
        values = {name: values_of(text) for name, text in stored["of"].items()}
    except KeyError as problem:
        raise ValueError(str(problem)) from None
    if len({len(curve) for curve in values.values()}) != 1:
        raise ValueError("curves of different lengths")
    samples = len(next(iter(values.values())))
    t: Curve = np.arange(samples, dtype=float) * float(stored["period_s"])
    return t, values


def require_fig4_claims(experiment: Experiment) -> None:
    """Refuse an experiment that is too short, has massage tasks or no force control for the claims of Fig. 4."""
    end = experiment.duration_ticks * experiment.cosim.tick
    if end < MIN_DURATION:
        raise InputRefused(f'{experiment.name}: ends at {end:g} s; claims = "fig4" needs {MIN_DURATION} s')
    if experiment.tasks or experiment.values["controller"].get("mode") != "force_position":
        raise InputRefused(
            f'{experiment.name}: claims = "fig4" needs controller.mode = "force_position" and no tasks; '
            "name fig4_force_position.toml, or one that extends it"
        )


def findings(runs: Fig4Runs) -> dict[str, Any]:
    """Judge the claims of Fig. 4 on two runs and return the additional fields of a sweep's row.

    Fields: "claims", key -> {"value", "verdict"}, and "curves", as `pack_curves` writes them: height (m) and forces (N)
    of both runs as estimated and, with `true_` in the name, as simulated.
    """
    # The plant of the sweep is the imperfect one.
    score = fig4_score(replace(runs, imperfect=(runs.force_position, runs.position)))
    judged = [finding for finding in (*score.claims, *score.quality) if finding.claim.measure is not None]
    return {
        "claims": {
            finding.claim.key: {"value": to_dict(finding.value), "verdict": finding.verdict} for finding in judged
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
    return pack_curves(curves, MIN_DURATION)
