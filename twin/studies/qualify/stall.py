"""The load that a drive can no longer turn against.

A load that grows finds it in one run, but too high: beyond the stall torque tau_s a shaft of inertia J is still to be
braked, J domega/dt = tau_s - tau_load. That takes until the load is sqrt(2 J omega r) above tau_s if it grows with the
rate r, 0.04 N m of 7e-3 kg m2. And it is too low if the drive's own loop is slower than the load. Loads that are held
know neither: they say whether the one that was found is right, and if it is not they close in on the right one.
"""

from collections.abc import Callable

import numpy as np

from twin.runs.assembly.drives import DrivePlan
from twin.studies.metrics.response import Curve
from twin.studies.qualify.bench import Response, response
from twin.studies.qualify.definitions import Measure
from twin.studies.qualify.operating_range import LOAD_MOST, LOAD_PEAK, SPEED_IN_USE, TICK

START = 0.5
"""s. The load starts to grow when the shaft turns steadily."""
RATE = 0.25
"""N m/s. With which the load grows."""
HOLD = 1.0
"""s. How long a load is held. Its excess e stops a shaft of inertia J from 0.5 rad/s within 0.5 J/e, so that what is
carried that long is too high by at most 0.5 J: 0.0035 N m of 7e-3 kg m2. Longer, and a winding that heats is weaker."""
SHARE = 0.1
"""Of the commanded speed: friction that is smoothed around standstill lets a model creep below it for ever."""
WINDOW = 0.05
"""s. Over which the speed is averaged: a stepper swings while it turns."""
UNCERTAINTY = 0.02
"""Of the stall torque: between a load that is carried and one that is not there is twice as much."""
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


def stall_torque(plan: DrivePlan, done: Response) -> Measure:
    """Measure `stall_torque`.

    Args:
        plan: the drive.
        done: its `overload` run.

    Raises:
        ComponentFailed: the drive failed under a load that was held.
    """
    if not _stalled(done.theta_m):
        return Measure("stall_torque", None, f"more than {LOAD_MOST:g} N m")
    found = ramped_torque(done)
    torque = found and held_torque(found, lambda load: carried(plan, load))
    if torque == 0.0:
        return Measure("stall_torque", None, "does not turn forward")
    if torque >= LOAD_MOST:
        return Measure("stall_torque", None, f"more than {LOAD_MOST:g} N m")
    weak = torque < (1.0 - UNCERTAINTY) * LOAD_PEAK
    return Measure("stall_torque", torque, f"less than the peak of {LOAD_PEAK:g} N m" if weak else "")


def ramped_torque(done: Response) -> float:
    """The load (N m) at which the shaft of an `overload` run has stalled; 0: it never turned."""
    n = round(WINDOW / TICK)
    turning = np.flatnonzero(done.theta_m[n:] - done.theta_m[:-n] >= SHARE * SPEED_IN_USE * WINDOW)
    # the load in the middle of the last window in which it still turned
    return float(done.tau_load[turning[-1] + n // 2]) if len(turning) else 0.0


def held_torque(found: float, carries: Callable[[float], bool]) -> float:
    """`found` (N m) if loads `UNCERTAINTY` below and above it say so, else what they close in on, as exactly; not
    less than `LOAD_MOST` if that is carried.

    Args:
        found: > 0.
        carries: whether a load is carried for as long as it is held; those below one that is, are, too.
    """
    below, above = (1.0 - UNCERTAINTY) * found, (1.0 + UNCERTAINTY) * found
    if not carries(below):
        low, high = 0.0, below
    elif carries(above):
        if above >= LOAD_MOST or carries(LOAD_MOST):
            return LOAD_MOST
        low, high = above, LOAD_MOST
    else:
        return found
    # nothing is told from nothing
    while high - low > max(2.0 * UNCERTAINTY * high, RATE * WINDOW):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if carries(middle) else (low, middle)
    return 0.5 * (low + high)


def carried(plan: DrivePlan, load: float) -> bool:
    """Whether a drive, commanded with the speed in use, still turns when `load` (N m) has been held.

    Raises:
        ComponentFailed: the drive failed.
    """
    t = TICK * np.arange(round((START + load / RATE + HOLD) / TICK))
    tau_load = np.clip(RATE * (t - START), 0.0, load)
    return not _stalled(response(plan, np.full(len(t), SPEED_IN_USE), tau_load).theta_m)


def _stalled(theta_m: Curve) -> bool:
    n = round(PATIENCE / TICK)
    return len(theta_m) > START / TICK and bool(theta_m[-1] - theta_m[-n] < SHARE * SPEED_IN_USE * PATIENCE)
