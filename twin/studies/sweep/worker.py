"""One run of a sweep, and the job of a worker process: runs until no more orders come.

Judgement of a sweep's run by the paper's Fig. 4, together with a companion run without force control.
"""

import contextlib
import gc
import json
import shutil
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from twin.kernel.errors import ComponentFailed, InputRefused
from twin.kernel.process.job import function_called
from twin.kernel.process.reporter import Reporter
from twin.kernel.writing import made_folder
from twin.robot.assembly.load import load_experiment
from twin.robot.experiment.experiment import Experiment
from twin.robot.mechanism.geometry import geometry_of
from twin.robot.run.run import execute
from twin.robot.run.runs import Outcome, RunRequest, Runs
from twin.studies.check.measurement import Signals, metrics_of_measure, refuse_unknown
from twin.studies.metrics.response import Curve
from twin.studies.packing import text_of, values_of
from twin.studies.paper.claim import as_facts
from twin.studies.paper.fig4 import fig4_score
from twin.studies.paper.fig4_measures import WHOLE, Fig4Run, Fig4Runs
from twin.studies.sweep.measures import RunFinding, metrics_of

PERIOD = 0.04
"""Between two samples (s): 500 of the 20 s of Fig. 4, about one per pixel of a panel."""


def packed(curves: Mapping[str, tuple[Curve, Curve]], end: float) -> dict[str, Any]:
    """`curves` for JSON as they are at 0, `PERIOD`, ... up to `end` (s), on lines between their samples.

    Args:
        curves: (times (s), values), each (n,), by name; times ascend.
    """
    t = np.arange(int(end / PERIOD + 1e-9) + 1) * PERIOD
    return {"period_s": PERIOD, "of": {name: text_of(np.interp(t, *curve)) for name, curve in curves.items()}}


def unpacked(stored: Mapping[str, Any]) -> tuple[Curve, dict[str, Curve]]:
    """(times (s), values by name) of what `packed` made.

    Raises:
        ValueError: it did not make this.
    """
    try:
        values = {name: values_of(text) for name, text in stored["of"].items()}
    except KeyError as problem:
        raise ValueError(str(problem)) from None
    if len({len(curve) for curve in values.values()}) != 1:
        raise ValueError("curves of different lengths")
    samples = len(next(iter(values.values())))
    t: Curve = np.arange(samples, dtype=float) * float(stored["period_s"])
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
    """For the row: "claims", key -> {"value", "verdict"}, and "curves", as `packed` writes them: height and
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


def trial(path: Path, drive: str | None, settings: Sequence[str], claims: str = "") -> RunFinding:
    """Run the experiment at `path` and measure it; a failure of the run is a finding like any other.

    Args:
        drive, settings: see `load_experiment`.
        claims: "fig4": judge the claims of Fig. 4 on it and on its companion without force control, which is run, too.
    """
    began = time.perf_counter()
    try:
        done, metrics, no_hold = _simulated(load_experiment(path, settings, drive), bool(claims))
        paper = {}
        if claims and not done.reason:
            companion, *_ = _simulated(load_experiment(path, [*settings, COMPANION], drive), True)
            if companion.reason:
                raise ComponentFailed(f"without force control: {companion.reason}")
            assert done.trace is not None and companion.trace is not None
            paper = findings(Fig4Runs(Fig4Run(done.trace), Fig4Run(companion.trace)))
    # one run in a thousand that meets a mistake of ours is a row, too
    except Exception as problem:
        return RunFinding(*_status_and_reason(problem), {}, time.perf_counter() - began, 0.0)
    return RunFinding(done.status, done.reason, metrics, time.perf_counter() - began, done.stepping, paper, no_hold)


def record(path: Path, drive: str | None, settings: Sequence[str], folder: Path) -> None:
    """Run the experiment at `path` and record it in `folder`, as `twin run` does, also where it fails.

    Raises:
        InputRefused, NotWritten: no folder, or the disk is full; that is no fault of the run.
    """
    # its result comes from `trial`: the same run again
    try:
        experiment = load_experiment(path, settings, drive)
    except InputRefused:
        return
    made_folder(folder)
    with contextlib.suppress(InputRefused, ComponentFailed):
        execute(experiment, folder)


def _status_and_reason(problem: Exception) -> tuple[str, str]:
    """(status, reason) of a run that `problem` has ended."""
    match problem:
        case InputRefused():
            return "refused", str(problem)
        case ComponentFailed():
            return "failed", str(problem).splitlines()[0]
    return "failed", f"{type(problem).__name__}: {problem}"


AFTER = 2
"""Runs in a row with the same past from the start, before the past is run: that takes about as long as two."""
NUMBERS, WHOLE_RUN = RunRequest(tally=True), RunRequest(signals=None, tally=True, check=refuse_unknown)
_runs = Runs(NUMBERS, AFTER, most=1)
"""Of this process; runs whose keys act from the start have no past in common."""


def _simulated(experiment: Experiment, whole: bool) -> tuple[Outcome, dict[str, float | None], str]:
    """(outcome, metrics, why it has no hold error) of a run; all its signals if it is `whole` or they are measured."""
    if not (experiment.measures or whole):
        done = _runs.run(experiment).completed()
        return done, *_measured(done)
    done = Runs(WHOLE_RUN, most=0).run(experiment).completed()
    metrics, no_hold = _measured(done)
    assert done.trace is not None
    signals = Signals(done.trace, geometry_of(experiment.controller.model))
    for measure in experiment.measures:
        # no step, or a force that never comes, at some values: then there are no such numbers
        with contextlib.suppress(InputRefused):
            metrics |= {name: m.value for name, m in metrics_of_measure(measure, signals).items()}
    return done, metrics, no_hold


def _measured(done: Outcome) -> tuple[dict[str, float | None], str]:
    """(metrics of a run, why it has no hold error; "" if it has one)."""
    assert done.numbers is not None
    hold = done.numbers.measures["hold_error"]
    return metrics_of(done.numbers), hold.reason if hold.value is None else ""


def served(reporter: Reporter, experiment: str, orders: str, folder: str, claims: str, trial: str) -> None:
    """Run every order; what is imported, compiled or unpacked for one is there for the next.

    Notes: {"finding": facts of `Finding`} after each.

    Args:
        experiment: its file.
        folder: where recordings go, a folder per run.
        claims: see `twin.studies.sweep.worker.trial`.
        trial: see `Job`.
        orders: a named pipe, alone in its folder, that brings {"run", "drive", "settings", "record"} as JSON lines;
            ends the job when it is closed. What is to be recorded is run twice: so measuring never depends on the
            recorder, and a good run in a sweep that records failures never meets it.

    Raises:
        RecordingFailed: the disk is full.
    """
    judged = function_called(trial)
    with open(orders, encoding="utf-8") as lines:
        # it is open at both ends now; who made it may be killed
        with contextlib.suppress(OSError):
            Path(orders).unlink()
            Path(orders).parent.rmdir()
        for number, line in enumerate(lines):
            order = json.loads(line)
            what = Path(experiment), order["drive"], order["settings"]
            own = Path(folder) / f"{order['run']:06d}"
            reporter.loading()
            if order["record"] != "none":
                # what an earlier attempt left of the same run
                shutil.rmtree(own, ignore_errors=True)
            if order["record"] == "all":
                record(*what, own)
                reporter.loading()
            finding = judged(*what, claims)
            if order["record"] == "failures" and finding.status != "done":
                reporter.loading()
                record(*what, own)
            reporter.note(finding=finding.facts)
            if number == 0:
                # what one run has loaded stays for all others: it need not be looked through for garbage again
                gc.collect()
                gc.freeze()
