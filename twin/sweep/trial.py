"""One run of a sweep, in whatever process it happens."""

import contextlib
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from twin.assembly.assemble import assemble
from twin.assembly.load import load_experiment
from twin.cosim.simulation import Simulation
from twin.drive.reuse import free_kept
from twin.errors import ComponentFailed, InputRefused
from twin.execution import execute
from twin.execution.outcome import Tally
from twin.experiment.experiment import Experiment
from twin.monitor.component import Monitor
from twin.monitor.reasons import trip_sentence
from twin.paper.fig4_runs import Fig4Run, Fig4Runs
from twin.regression.measurement import metrics_of_measure
from twin.regression.trace import refuse_unknown, trace_of
from twin.sweep.fig4 import COMPANION, findings
from twin.sweep.measures import Finding, metrics_of
from twin.sweep.series import RunSeries
from twin.writing import made_folder

SLICE_TICKS = 1000
"""Nobody watches between slices, so they may be long; but the rows of one are to stay in the processor's cache."""


def trial(path: Path, drive: str | None, settings: Sequence[str], claims: str = "") -> Finding:
    """Run the experiment at `path` and measure it; a failure of the run is a finding like any other.

    Args:
        drive, settings: see `load_experiment`.
        claims: "fig4": judge the claims of Fig. 4 on it and on its companion without force control, which is run, too.
    """
    began = time.perf_counter()
    try:
        ran = _measured(load_experiment(path, settings, drive), bool(claims))
        paper = {}
        if claims and not ran.trip:
            paper = _judged(ran, _measured(load_experiment(path, [*settings, COMPANION], drive), True))
    # one run in a thousand that meets a mistake of ours is a row, too
    except Exception as problem:
        free_kept()
        return Finding(*_told(problem), {}, time.perf_counter() - began, 0.0)
    status = "tripped" if ran.trip else "done"
    return Finding(status, ran.trip, ran.metrics, time.perf_counter() - began, ran.stepping, paper)


def record(path: Path, drive: str | None, settings: Sequence[str], folder: Path) -> None:
    """Run the experiment at `path` and record it in `folder`, as `twin run` does, also where it fails.

    Raises:
        InputRefused, NotWritten: no folder, or the disk is full; that is no fault of the run.
    """
    # what it comes to is told by `trial`: the same run again
    try:
        experiment = load_experiment(path, settings, drive)
    except InputRefused:
        return
    made_folder(folder)
    try:
        execute(experiment, folder)
    except (InputRefused, ComponentFailed):
        free_kept()


def _told(problem: Exception) -> tuple[str, str]:
    """(status, reason) of a run that `problem` has ended."""
    match problem:
        case InputRefused():
            return "refused", str(problem)
        case ComponentFailed():
            return "failed", str(problem).splitlines()[0]
    return "failed", f"{type(problem).__name__}: {problem}"


@dataclass(frozen=True)
class _Ran:
    """A run that came to its end.

    Attributes:
        trip: why the monitor tripped; "" if it did not. stepping: wall time (s). series: None unless it was asked for.
    """

    metrics: dict[str, float | None]
    trip: str
    stepping: float
    series: RunSeries | None


def _measured(experiment: Experiment, kept_whole: bool) -> _Ran:
    with assemble(experiment) as assembly:
        refuse_unknown(experiment, assembly.system)
        simulation = Simulation(assembly.system, experiment.duration_ticks, SLICE_TICKS)
        tally, stepping, kept = Tally(assembly.system), 0.0, []
        while not simulation.finished:
            began = time.perf_counter()
            rows = simulation.advance()
            stepping += time.perf_counter() - began
            tally.take(rows)
            if experiment.measures or kept_whole:
                # the next slice overwrites them
                kept.append(rows.copy())
        if simulation.failure:
            raise simulation.failure
        monitor = next((c for c in assembly.system.components if isinstance(c, Monitor)), None)
        trip = trip_sentence(monitor.trip) if monitor and monitor.trip else ""
        metrics = metrics_of(tally.outcome)
        values = np.concatenate(kept) if kept else None
        if experiment.measures and values is not None:
            trace = trace_of(experiment, assembly, values)
            for measure in experiment.measures:
                # no step, or a force that never comes, at some values: then there are no such numbers
                with contextlib.suppress(InputRefused):
                    metrics |= {name: m.value for name, m in metrics_of_measure(measure, trace).items()}
        series = RunSeries(assembly.system, values) if values is not None else None
    return _Ran(metrics, trip, stepping, series)


def _judged(ran: _Ran, companion: _Ran) -> dict[str, Any]:
    """What the pair says to the paper.

    Raises:
        ComponentFailed: the monitor tripped in the companion.
    """
    assert ran.series is not None and companion.series is not None
    if companion.trip:
        raise ComponentFailed(f"without force control: {companion.trip}")
    return findings(Fig4Runs(Fig4Run(ran.series), Fig4Run(companion.series)))
