"""One run of a sweep, in whatever process it happens."""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from twin.assembly.robot import assemble
from twin.cosim.simulation import Simulation
from twin.errors import ComponentFailed, InputRefused
from twin.execution import execute
from twin.execution.outcome import Tally
from twin.experiment.experiment import Experiment, load_experiment
from twin.monitor.component import Monitor
from twin.monitor.reasons import trip_sentence
from twin.paper.fig4_runs import Fig4Run, Fig4Runs
from twin.recording.errors import RecordingFailed
from twin.sweep.fig4 import COMPANION, findings
from twin.sweep.measures import Finding, metrics_of
from twin.sweep.series import RunSeries

SLICE_TICKS = 4000
"""Nobody watches between slices, so they may be long."""


def trial(path: Path, drive: str | None, settings: Sequence[str], folder: Path | None, claims: str = "") -> Finding:
    """Run the experiment at `path` and measure it; a failure of the run is a finding like any other.

    Args:
        drive, settings: see `load_experiment`. folder: where to record it; None: nowhere.
        claims: "fig4": judge the claims of Fig. 4 on it and on its companion without force control, which is run, too.

    Raises:
        RecordingFailed: the disk is full; that is no fault of the run.
    """
    began = time.perf_counter()
    try:
        experiment = load_experiment(path, settings, drive)
        ran = _recorded(experiment, folder) if folder else _measured(experiment)
        paper = {}
        if claims and not ran.trip:
            companion = _measured(load_experiment(path, [*settings, COMPANION], drive))
            # a recording may leave ticks out, and what is found must not depend on whether there is one
            series = ran.series or _measured(experiment).series
            paper = _judged(series, companion)
    except InputRefused as refusal:
        return Finding("refused", str(refusal), {}, time.perf_counter() - began, 0.0)
    except ComponentFailed as failure:
        return Finding("failed", str(failure).splitlines()[0], {}, time.perf_counter() - began, 0.0)
    except RecordingFailed:
        raise
    # one run in a thousand that meets a mistake of ours is a row, too
    except Exception as mistake:
        reason = f"{type(mistake).__name__}: {mistake}"
        return Finding("failed", reason, {}, time.perf_counter() - began, 0.0)
    status = "tripped" if ran.trip else "done"
    return Finding(status, ran.trip, ran.metrics, time.perf_counter() - began, ran.stepping, paper)


@dataclass(frozen=True)
class _Ran:
    """A run that came to its end; `trip`: why the monitor tripped, or "". `series`: None if it went to the disk."""

    metrics: dict[str, float | None]
    trip: str
    stepping: float
    series: RunSeries | None


def _measured(experiment: Experiment) -> _Ran:
    with assemble(experiment) as assembly:
        simulation = Simulation(assembly.system, experiment.duration_ticks, SLICE_TICKS)
        tally, stepping, kept = Tally(assembly.system), 0.0, []
        while not simulation.finished:
            began = time.perf_counter()
            rows = simulation.advance()
            stepping += time.perf_counter() - began
            tally.take(rows)
            kept.append(rows.copy())
        if simulation.failure:
            raise simulation.failure
        monitor = next((c for c in assembly.system.components if isinstance(c, Monitor)), None)
        trip = trip_sentence(monitor.trip) if monitor and monitor.trip else ""
        series = RunSeries(assembly.system, np.concatenate(kept))
    return _Ran(metrics_of(tally.outcome), trip, stepping, series)


def _recorded(experiment: Experiment, folder: Path) -> _Ran:
    folder.mkdir(parents=True, exist_ok=True)
    run = execute(experiment, folder)
    return _Ran(metrics_of(run.outcome), run.trip, run.stepping, None)


def _judged(series: RunSeries | None, companion: _Ran) -> dict[str, Any]:
    """What the pair says to the paper.

    Raises:
        ComponentFailed: the monitor tripped in the companion.
    """
    assert series is not None and companion.series is not None
    if companion.trip:
        raise ComponentFailed(f"without force control: {companion.trip}")
    return findings(Fig4Runs(Fig4Run(series), Fig4Run(companion.series)))
