"""The load that a drive can no longer turn against."""

import numpy as np

from twin.runs.assembly.drives import DrivePlan
from twin.studies.metrics.response import Curve
from twin.studies.qualify.bench import Response, response
from twin.studies.qualify.definitions import Measure
from twin.studies.qualify.operating_range import LOAD_MOST, LOAD_PEAK, SPEED_IN_USE, TICK

START = 0.5
"""s. The load starts to grow when the shaft turns steadily."""
RATE = 0.25
"""N m/s. A shaft of 1e-4 kg m2 is braked from 0.5 rad/s within 0.02 s, and the load then is 0.005 N m too high."""
SHARE = 0.1
"""Of the commanded speed: friction that is smoothed around standstill lets a model creep below it for ever."""
WINDOW = 0.05
"""s. Over which the speed is averaged: a stepper swings while it turns."""
UNCERTAINTY = 0.02
"""Of the stall torque: the load grows by 0.0125 N m within one `WINDOW`."""
PATIENCE = 0.3
"""s. A shaft that has been slower than `SHARE` for that long is stalled."""


def overload(plan: DrivePlan) -> Response:
    """Commanded with the speed in use, the load grows until the shaft has stalled.

    Raises:
        ComponentFailed: the drive failed.
    """
    t = TICK * np.arange(round((START + LOAD_MOST / RATE) / TICK))
    tau_load = RATE * np.maximum(0.0, t - START)
    return response(plan, np.full(len(t), SPEED_IN_USE), tau_load, enough=_stalled)


def stall_torque(done: Response) -> Measure:
    """Measure `stall_torque` of an `overload` run."""
    if not _stalled(done.theta_m):
        return Measure("stall_torque", None, f"more than {LOAD_MOST:g} N m")
    n = round(WINDOW / TICK)
    turning = np.flatnonzero(done.theta_m[n:] - done.theta_m[:-n] >= SHARE * SPEED_IN_USE * WINDOW)
    # the load in the middle of the last window in which it still turned
    torque = float(done.tau_load[turning[-1] + n // 2]) if len(turning) else 0.0
    if torque == 0.0:
        return Measure("stall_torque", None, "does not turn forward")
    weak = torque < (1.0 - UNCERTAINTY) * LOAD_PEAK
    return Measure("stall_torque", torque, f"less than the peak of {LOAD_PEAK:g} N m" if weak else "")


def _stalled(theta_m: Curve) -> bool:
    n = round(PATIENCE / TICK)
    return len(theta_m) > START / TICK and bool(theta_m[-1] - theta_m[-n] < SHARE * SPEED_IN_USE * PATIENCE)
