"""One run of a sweep, in whatever process it happens."""

import time
from collections.abc import Sequence
from pathlib import Path

from twin.assembly.robot import assemble
from twin.cosim.simulation import Simulation
from twin.errors import ComponentFailed, InputRefused
from twin.execution import execute
from twin.execution.outcome import Tally
from twin.experiment.experiment import Experiment, load_experiment
from twin.monitor.component import Monitor
from twin.monitor.reasons import trip_sentence
from twin.recording.errors import RecordingFailed
from twin.sweep.measures import Finding, metrics_of

SLICE_TICKS = 4000
"""Nobody watches between slices, so they may be long."""


def trial(path: Path, drive: str | None, settings: Sequence[str], folder: Path | None) -> Finding:
    """Run the experiment at `path` and measure it; a failure of the run is a finding like any other.

    Args:
        drive, settings: see `load_experiment`. folder: where to record it; None: nowhere.

    Raises:
        RecordingFailed: the disk is full; that is no fault of the run.
    """
    began = time.perf_counter()
    try:
        experiment = load_experiment(path, settings, drive)
        metrics, trip, stepping = _recorded(experiment, folder) if folder else _measured(experiment)
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
    return Finding("tripped" if trip else "done", trip, metrics, time.perf_counter() - began, stepping)


Measured = tuple[dict[str, float | None], str, float]
"""(metrics, why the monitor tripped or "", wall time of stepping in s)"""


def _measured(experiment: Experiment) -> Measured:
    with assemble(experiment) as assembly:
        simulation = Simulation(assembly.system, experiment.duration_ticks, SLICE_TICKS)
        tally, stepping = Tally(assembly.system), 0.0
        while not simulation.finished:
            began = time.perf_counter()
            rows = simulation.advance()
            stepping += time.perf_counter() - began
            tally.take(rows)
        if simulation.failure:
            raise simulation.failure
        monitor = next((c for c in assembly.system.components if isinstance(c, Monitor)), None)
        trip = trip_sentence(monitor.trip) if monitor and monitor.trip else ""
    return metrics_of(tally.outcome), trip, stepping


def _recorded(experiment: Experiment, folder: Path) -> Measured:
    folder.mkdir(parents=True, exist_ok=True)
    run = execute(experiment, folder)
    return metrics_of(run.outcome), run.trip, run.stepping
