"""Measures of the held force in a log, against the reference of the twin's own controller."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from twin.kernel.cosim.delay import play, values_by_port
from twin.kernel.errors import InputRefused
from twin.kernel.recording.logs.reader import is_recording
from twin.kernel.recording.reader import read_metadata
from twin.robot.assembly.build import controller
from twin.robot.assembly.load import load_experiment, recorded_experiment
from twin.robot.controller.controller import SHARE_PORT
from twin.robot.experiment.experiment import Experiment
from twin.robot.run.hold import HoldRequest
from twin.robot.run.measures import FORCE_KEYS, HEADLINE_KEYS, Values, labelled_text, missing_measures
from twin.robot.run.view import LogView, outcome_of
from twin.studies.replay.replay import Outputs
from twin.studies.replay.samples import RobotSamples

MAX_PERIOD_ERROR = 0.02
"""Maximum relative difference between the log's period and a divisor of the controller's."""
LOG_MEASURES = (*FORCE_KEYS, "hold_begin", "hold_end")
"""Keys of the measures of a log, which has no true position."""


def log_measures(log: RobotSamples, estimate: Outputs, source: Path | None, settings: tuple[str, ...]) -> Values:
    """Compute the measures of a held force (None with the reason); `source` None for the recorded experiment."""
    if log.force is None:
        return missing_measures("the log has no force")
    try:
        if source is None and not is_recording(log.path):
            return missing_measures("no experiment")
        experiment = (
            load_experiment(source, settings)
            if source
            else recorded_experiment(read_metadata(log.path), log.path, changed=True, settings=settings)
        )
    except InputRefused as refusal:
        return missing_measures(f"no controller: {str(refusal).splitlines()[0]}")
    if "controller" in experiment.stand_ins:
        return missing_measures("a third-party controller does not run on a log")
    period = experiment.controller_ticks * experiment.cosim.tick
    stride = max(1, round(period / log.sampling.period))
    if abs(stride * log.sampling.period / period - 1.0) > MAX_PERIOD_ERROR:
        text = f"a sample every {1e3 * log.sampling.period:.4g} ms, the controller needs one every {1e3 * period:g} ms"
        return missing_measures(text)
    outputs, called = _controller_outputs(experiment, log, estimate, stride, period)
    F_z = log.force.values
    series = {"plant.F_ee_B": np.column_stack([np.zeros((len(F_z), 2)), -F_z])}
    series |= {f"controller.{name}": values for name, values in outputs.items()}
    view = LogView(series, {"plant": log.force.t, "controller": called})
    found = outcome_of(view, HoldRequest.from_experiment(experiment))
    return {key: found.measures[key] for key in LOG_MEASURES} if found else missing_measures("the log has no force")


def _controller_outputs(
    experiment: Experiment, log: RobotSamples, estimate: Outputs, stride: int, period: float
) -> tuple[Outputs, NDArray[np.float64]]:
    """Run the twin's controller on a log's estimates; return its outputs and the times of its calls."""
    law = controller(experiment)
    t = log.t[::stride]
    n = len(t)
    inputs = [
        np.ones((n, 1)) if port == SHARE_PORT else estimate[port.name][::stride].reshape(n, -1) for port in law.inputs
    ]
    rows, _ = play(law, t - t[0], np.full(n, period), np.hstack(inputs))
    return values_by_port(law.outputs, rows), t[: len(rows)]


def measures_text(values: Values) -> str:
    """Format the first measures of a log's held force, or the reason why they are missing."""
    error = values["hold_error"]
    if error.value is None:
        return f"none: {error.reason}"
    found = ", ".join(labelled_text(key, values) for key in HEADLINE_KEYS if values[key].value is not None)
    return f"{found}; of the measured force"
