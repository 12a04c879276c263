"""One run of a sweep, in whatever process it happens."""

import contextlib
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from twin.assembly.robot import assemble
from twin.cosim.simulation import Simulation
from twin.errors import ComponentFailed, InputRefused
from twin.execution import execute
from twin.execution.outcome import Tally
from twin.experiment.experiment import Experiment, load_experiment
from twin.monitor.component import Monitor
from twin.monitor.reasons import trip_sentence
from twin.regression.measurement import metrics_of_measure
from twin.regression.trace import refuse_unknown, trace_of
from twin.sweep.measures import Finding, metrics_of

SLICE_TICKS = 4000
"""Nobody watches between slices, so they may be long."""


def trial(path: Path, drive: str | None, settings: Sequence[str]) -> Finding:
    """Run the experiment at `path` and measure it; a failure of the run is a finding like any other.

    Args:
        drive, settings: see `load_experiment`.
    """
    began = time.perf_counter()
    try:
        metrics, trip, stepping = _measured(load_experiment(path, settings, drive))
    except InputRefused as refusal:
        return Finding("refused", str(refusal), {}, time.perf_counter() - began, 0.0)
    except ComponentFailed as failure:
        return Finding("failed", str(failure).splitlines()[0], {}, time.perf_counter() - began, 0.0)
    # one run in a thousand that meets a mistake of ours is a row, too
    except Exception as mistake:
        reason = f"{type(mistake).__name__}: {mistake}"
        return Finding("failed", reason, {}, time.perf_counter() - began, 0.0)
    return Finding("tripped" if trip else "done", trip, metrics, time.perf_counter() - began, stepping)


def record(path: Path, drive: str | None, settings: Sequence[str], folder: Path) -> None:
    """Run the experiment at `path` and record it in `folder`, as `twin run` does, also where it fails.

    Raises:
        RecordingFailed: the disk is full; that is no fault of the run.
    """
    # what it comes to is told by `trial`: the same run again
    with contextlib.suppress(InputRefused, ComponentFailed):
        experiment = load_experiment(path, settings, drive)
        folder.mkdir(parents=True, exist_ok=True)
        execute(experiment, folder)


def _measured(experiment: Experiment) -> tuple[dict[str, float | None], str, float]:
    """(metrics, why the monitor tripped or "", wall time of stepping in s)."""
    with assemble(experiment) as assembly:
        refuse_unknown(experiment, assembly.system)
        simulation = Simulation(assembly.system, experiment.duration_ticks, SLICE_TICKS)
        tally, stepping, kept = Tally(assembly.system), 0.0, []
        while not simulation.finished:
            began = time.perf_counter()
            rows = simulation.advance()
            stepping += time.perf_counter() - began
            tally.take(rows)
            if experiment.measures:
                # the next slice overwrites them
                kept.append(rows.copy())
        if simulation.failure:
            raise simulation.failure
        monitor = next((c for c in assembly.system.components if isinstance(c, Monitor)), None)
        trip = trip_sentence(monitor.trip) if monitor and monitor.trip else ""
        metrics = metrics_of(tally.outcome)
        if kept:
            trace = trace_of(experiment, assembly, np.concatenate(kept))
            for measure in experiment.measures:
                # no step, or a force that never comes, at some values: then there are no such numbers
                with contextlib.suppress(InputRefused):
                    metrics |= {name: m.value for name, m in metrics_of_measure(measure, trace).items()}
    return metrics, trip, stepping
