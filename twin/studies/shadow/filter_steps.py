"""Stepping of the filter over samples, one by one or all at once."""

import numpy as np
from numpy.typing import NDArray

from twin.kernel.cosim.delay import play, values_by_port
from twin.kernel.cosim.port import by_port, width
from twin.kernel.errors import ComponentFailed
from twin.robot.assembly.build import belief, planned_drives, plant_parameters
from twin.robot.experiment.experiment import Experiment
from twin.studies.converge.monolith import servos
from twin.studies.replay.sample_columns import INPUTS
from twin.studies.replay.samples import RobotSamples
from twin.studies.shadow.filter import Shadow
from twin.studies.shadow.layout import OUTPUTS, Sensors, ShadowDrive

Columns = dict[str, NDArray[np.float64]]
UNKNOWN_DRIVE = ShadowDrive(lag=0.02, droop=0.0, inertia=1e-4, wander=20.0)
"""Model of a drive with unknown equations: the lag that controllers believe, and much process noise."""
KNOWN_DRIVE = 0.1
"""Process noise of a known drive (rad/s2/sqrt(Hz)): a lag of 20 ms off by 1 %, 10 rad/s2 changing at 10 Hz."""


def shadow_of(experiment: Experiment) -> Shadow:
    plant = experiment.plant
    sensors = Sensors(plant.motor_noise, plant.joint_noise)
    return Shadow(plant_parameters(plant, experiment.contact), belief(experiment), sensors, drive_model(experiment))


def drive_model(experiment: Experiment) -> ShadowDrive:
    """Create the drive model of `experiment`: from the equations of `velocity_servo`, else `UNKNOWN_DRIVE`."""
    known = servos(planned_drives(experiment))
    if known is None:
        return UNKNOWN_DRIVE
    lag, droop, inertia = (float(np.mean(values)) for values in (known.T_m, known.droop, known.J_m))
    return ShadowDrive(lag, droop, inertia, KNOWN_DRIVE)


class FilterFeed:
    """Kalman filter stepped without allocations, with views by port on the sample `u` (13,) and outputs `y` (24,)."""

    def __init__(self, shadow: Shadow):
        self._shadow, self._last = shadow, -np.inf
        self.u, self.y = np.full(width(INPUTS), np.nan), np.zeros(width(OUTPUTS))
        self._step, self._at = shadow.step.c_function_with_gil, (self.u.ctypes.data, self.y.ctypes.data)
        self.inputs, self.outputs = by_port(INPUTS, self.u), by_port(OUTPUTS, self.y)

    def __call__(self, t: float) -> None:
        """Step the filter with the sample in `u` of time `t` (s), later than the previous sample."""
        status = self._step(self._shadow.self_address, t, t - self._last, *self._at)
        if status:
            raise ComponentFailed(f"shadow {self._shadow.explain(status)}, t = {t:.3f} s")
        self._last = t


def filter_outputs(shadow: Shadow, samples: RobotSamples) -> Columns:
    """Step the filter over all `samples`; return its outputs by the names in `layout.OUTPUTS`: (n,) or (n, size)."""
    h = samples.periods
    rows, status = play(shadow, samples.t, np.where(np.isfinite(h), h, 1e9), samples.u)
    if status:
        raise ComponentFailed(f"shadow {shadow.explain(status)}, t = {samples.t[len(rows)]:.3f} s")
    return values_by_port(shadow.outputs, rows)
