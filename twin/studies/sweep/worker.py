"""One run of a sweep, and the job of a worker process: runs until no more orders come.

Judgement of a sweep's run by the paper's Fig. 4, together with a companion run without force control.

Runs of a sweep that differ only in what acts later, faults and changes: they go on from one past.

A past is given up with the first run that has another one. Runs whose keys act from the start have none in common.
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

from twin.kernel.cosim.observers import Observer, Simulated, TickEvent, simulate
from twin.kernel.cosim.simulation import Simulation
from twin.kernel.errors import ComponentFailed, InputRefused
from twin.kernel.process.job import function_called
from twin.kernel.process.reporter import Reporter
from twin.kernel.writing import made_folder
from twin.robot.assembly.assemble import assemble
from twin.robot.assembly.load import load_experiment
from twin.robot.experiment.experiment import Experiment
from twin.robot.mechanism.geometry import geometry_of
from twin.robot.monitor.component import trip_reason
from twin.robot.run.hold import HoldRequest
from twin.robot.run.measures import RunOutcome
from twin.robot.run.outcome import Tally
from twin.robot.run.past import SharedPast, before_fault
from twin.robot.run.run import execute
from twin.robot.run.trace import Trace
from twin.studies.check.measurement import Signals, metrics_of_measure, refuse_unknown
from twin.studies.metrics.response import Curve
from twin.studies.packing import text_of, values_of
from twin.studies.paper.claim import as_facts
from twin.studies.paper.fig4 import fig4_score
from twin.studies.paper.fig4_measures import WHOLE, Fig4Run, Fig4Runs
from twin.studies.sweep.measures import RunFinding, metrics_of

AFTER = 2
"""Runs in a row with the same past after which it is made: that takes about as long as two runs."""


class LastPast:
    """The past of the runs that came last; `close` frees what it keeps.

    Args:
        share: False: no run goes on from it, for comparison.
    """

    def __init__(self, share: bool = True) -> None:
        self._share, self._runs = share, 0
        self._before: Experiment | None = None
        self._past: SharedPast | None = None
        self._known: SummedUp | None = None

    def run(self, experiment: Experiment) -> tuple[Simulated, Tally] | None:
        """`experiment`, and what it comes to; None: it is to be made from the start.

        Raises:
            InputRefused: a part of the robot, or a fault, does not fit.
        """
        later = [fault.onset for fault in experiment.faults] + [change.tick for change in experiment.changes]
        base = replace(before_fault(experiment), changes=())
        # what it was read from says no more than the rest
        before = replace(base, values={}, origins={})
        if before != self._before:
            self.close()
            self._before = before
        self._runs += 1
        if self._runs <= AFTER or not later or not self._share:
            return None
        if self._past is None:
            self._known = SummedUp(HoldRequest.of(base))
            self._past = SharedPast(base, [self._known])
        tally = SummedUp(HoldRequest.of(experiment), self._known)
        return self._past.go_on(experiment, min(later), [tally]), tally.tally

    def close(self) -> None:
        """Give the past up; safe to call twice."""
        past, self._past, self._before, self._runs = self._past, None, None, 0
        if past is not None:
            past.close()


class SummedUp(Observer):
    """A tally of a run that may begin where another one was.

    Args:
        request: of its experiment.
        past: of that one; None: nothing goes on from it.

    Attributes:
        tally: its own, from the beginning of the simulation on.
    """

    tally: Tally

    def __init__(self, request: HoldRequest, past: "SummedUp | None" = None):
        self._request, self._past = request, past
        self._states: dict[int, object] = {}

    def begin(self, simulation: Simulation) -> None:
        self.tally = Tally(simulation.system, self._request)
        self.tally.begin(simulation)
        if self._past is not None and simulation.next_tick > 0:
            self.tally.restore(self._past._states[simulation.next_tick])

    def ready(self, tick: int) -> None:
        if self._past is None:
            self._states[tick] = self.tally.state()

    def take(self, first: int, rows: np.ndarray, events: list[TickEvent]) -> None:
        self.tally.take(first, rows, events)


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
        done, metrics, no_hold, run = _simulated(load_experiment(path, settings, drive), bool(claims))
        trip, paper = trip_reason(done.simulation), {}
        if claims and not trip:
            companion, _, _, other = _simulated(load_experiment(path, [*settings, COMPANION], drive), True)
            if early := trip_reason(companion.simulation):
                raise ComponentFailed(f"without force control: {early}")
            assert run is not None and other is not None
            paper = findings(Fig4Runs(Fig4Run(run), Fig4Run(other)))
    # one run in a thousand that meets a mistake of ours is a row, too
    except Exception as problem:
        return RunFinding(*_status_and_reason(problem), {}, time.perf_counter() - began, 0.0)
    status = "tripped" if trip else "done"
    return RunFinding(status, trip, metrics, time.perf_counter() - began, done.stepping, paper, no_hold)


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


_past = LastPast()
"""Of the runs of this process."""


def _simulated(experiment: Experiment, whole: bool) -> tuple[Simulated, dict[str, float | None], str, Trace | None]:
    """(how a run went, its metrics, why it has no hold error, the run itself if it is to be had `whole` or was needed
    for them)."""
    # what is measured or drawn is of the whole run
    shared = None if experiment.measures or whole else _past.run(experiment)
    if shared is not None:
        done, found = shared
        return done.completed(), *_measured(found.outcome), None
    with assemble(experiment) as assembly:
        refuse_unknown(experiment, assembly.system)
        tally = Tally(assembly.system, HoldRequest.of(experiment))
        run = Trace() if experiment.measures or whole else None
        done = simulate(assembly, experiment.duration_ticks, [tally, run] if run else [tally]).completed()
    metrics, no_hold = _measured(tally.outcome)
    if run:
        signals = Signals(run, geometry_of(experiment.controller.model))
        for measure in experiment.measures:
            # no step, or a force that never comes, at some values: then there are no such numbers
            with contextlib.suppress(InputRefused):
                metrics |= {name: m.value for name, m in metrics_of_measure(measure, signals).items()}
    return done, metrics, no_hold, run


def _measured(outcome: RunOutcome) -> tuple[dict[str, float | None], str]:
    """(metrics of a run, why it has no hold error; "" if it has one)."""
    hold = outcome.measures["hold_error"]
    return metrics_of(outcome), hold.reason if hold.value is None else ""


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
