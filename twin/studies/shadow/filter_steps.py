"""The filter of a robot stepped over its samples: as they arrive, or all at once."""

import numpy as np
from numpy.typing import NDArray

from twin.kernel.cosim.delay import columns, play
from twin.kernel.cosim.port import by_port, width
from twin.kernel.errors import ComponentFailed
from twin.robot.assembly.build import belief, planned_drives, plant_parameters
from twin.robot.experiment.experiment import Experiment
from twin.studies.converge.monolith import servos
from twin.studies.replay.sample_columns import INPUTS
from twin.studies.replay.samples import RobotSamples
from twin.studies.shadow.filter import Shadow
from twin.studies.shadow.layout import OUTPUTS, Noises, Sensors, ShadowDrive

Columns = dict[str, NDArray[np.float64]]
UNKNOWN_DRIVE = ShadowDrive(lag=0.02, droop=0.0, inertia=1e-4, wander=20.0)
"""Of a drive whose equations are not known: the lag that a controller believes, and much that it does besides."""
KNOWN_DRIVE = 0.1
"""rad/s2/sqrt(Hz). A lag of 20 ms that is 1 % off is as much, at 10 rad/s2 that change ten times a second."""


def shadow_of(experiment: Experiment, noises: Noises = Noises()) -> Shadow:  # noqa: B008, it is a tuple
    """The filter beside the robot that `experiment` describes, before the first sample.

    Raises:
        InputRefused: a drive does not fit.
    """
    plant = experiment.plant
    return Shadow(
        plant_parameters(plant, experiment.contact),
        belief(experiment),
        Sensors(plant.motor_noise, plant.joint_noise),
        drive_model(experiment),
        noises,
    )


def drive_model(experiment: Experiment) -> ShadowDrive:
    """What is known of the drives of `experiment`: all of `velocity_servo`'s equations, little of any other.

    Raises:
        InputRefused: a drive does not fit.
    """
    known = servos(planned_drives(experiment))
    if known is None:
        return UNKNOWN_DRIVE
    lag, droop, inertia = (float(np.mean(values)) for values in (known.T_m, known.droop, known.J_m))
    return ShadowDrive(lag, droop, inertia, KNOWN_DRIVE)


class FilterFeed:
    """A filter that is given its samples one by one, as they come; nothing is allocated for one.

    Args:
        shadow: the filter.

    Attributes:
        u: the sample that is taken next (13,), by `sample_columns.INPUTS`; NaN in the beginning.
        inputs: views of it by port.
        y: what the filter said last (24,), by `layout.OUTPUTS`.
        outputs: views of it by port.
    """

    def __init__(self, shadow: Shadow):
        self._shadow, self._last = shadow, -np.inf
        self.u, self.y = np.full(width(INPUTS), np.nan), np.zeros(width(OUTPUTS))
        self._step, self._at = shadow.step.c_function_with_gil, (self.u.ctypes.data, self.y.ctypes.data)
        self.inputs, self.outputs = by_port(INPUTS, self.u), by_port(OUTPUTS, self.y)

    def __call__(self, t: float) -> None:
        """Take the sample of time `t` (s), later than the one before, that lies in `u`.

        Raises:
            ComponentFailed: it is the first, and its counts fit no pose.
        """
        status = self._step(self._shadow.self_address, t, t - self._last, *self._at)
        if status:
            raise ComponentFailed(f"shadow {self._shadow.explain(status)}, t = {t:.3f} s")
        self._last = t


def filter_outputs(shadow: Shadow, samples: RobotSamples) -> Columns:
    """What the filter says at each of `samples`, by `layout.OUTPUTS`: (n,), or (n, size); it goes on from where it is.

    Raises:
        ComponentFailed: its first counts fit no pose.
    """
    h = samples.periods
    rows, status = play(shadow, samples.t, np.where(np.isfinite(h), h, 1e9), samples.u)
    if status:
        raise ComponentFailed(f"shadow {shadow.explain(status)}, t = {samples.t[len(rows)]:.3f} s")
    return columns(shadow, rows)
