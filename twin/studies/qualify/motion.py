"""Which way a drive turns, how fast, and what a load does to it."""

import numpy as np

from twin.runs.assembly.drives import DrivePlan
from twin.studies.qualify.bench import Response, response
from twin.studies.qualify.definitions import NEGLIGIBLE_DROOP, Finding, Measure, judged
from twin.studies.qualify.operating_range import LOAD_IN_USE, SPEED_IN_USE, SPEED_LIMIT, TICK
from twin.studies.qualify.work_cycle import AVERAGE, END, LOADED, work_cycle

WRONG_SCALE = 1.5
"""No drive for this robot is that far off by itself; rpm (9.5), degrees (57) and gears are."""
WRONG_RATE = 0.05
"""Twice what a register of 0.024 rad/s can be off at the speed in use."""
SOON = 0.1
"""How long after the load step its effect is looked for (s): before an integral loop has made up for it."""
NOT_FELT = 1e-9
"""rad. Rounding of the angle after seconds of turning."""


def direction_findings(plan: DrivePlan, cycle: Response) -> list[Finding]:
    """Checks `direction`, `scale` and `rate`; measures `speed` and `no_load_speed`.

    Args:
        plan: the drive.
        cycle: its work cycle.

    Raises:
        ComponentFailed: it failed in one of the runs.
    """
    back = response(plan, *work_cycle(speed=-SPEED_IN_USE, end=LOADED))
    fast = response(plan, *work_cycle(speed=SPEED_LIMIT, end=LOADED))
    window = (LOADED - AVERAGE, LOADED)
    forth, back_speed = cycle.mean_speed(*window), back.mean_speed(*window)
    reported = float(np.mean(cycle.omega_m[cycle.window(*window)]))
    share = forth / SPEED_IN_USE
    return [
        judged(
            "direction",
            forth > 0.0 > back_speed,
            f"{forth:+.3f} and {back_speed:+.3f} rad/s at {SPEED_IN_USE:+g} and {-SPEED_IN_USE:+g} commanded"
            + _remedy(plan, forth, back_speed),
        ),
        judged(
            "scale",
            1.0 / WRONG_SCALE < abs(share) < WRONG_SCALE,
            f"{abs(share):.3g} times the command",
        ),
        judged(
            "rate",
            abs(reported - forth) <= WRONG_RATE * abs(forth),
            f"{reported:.4g} rad/s reported, {forth:.4g} rad/s from the angle",
        ),
        Measure("speed", forth),
        Measure("no_load_speed", fast.mean_speed(*window)),
    ]


def load_findings(plan: DrivePlan, cycle: Response) -> list[Finding]:
    """Check `load`, measure `droop`.

    Args:
        plan: the drive.
        cycle: its work cycle.

    Raises:
        ComponentFailed: it failed in the run without load.
    """
    free = response(plan, *work_cycle(load=0.0))
    first = round(LOADED / TICK)
    behind = (free.theta_m - cycle.theta_m)[first : first + round(SOON / TICK)]
    most = float(behind[np.argmax(np.abs(behind))])
    told = "not felt" if abs(most) <= NOT_FELT else f"{abs(most):.3g} rad {'behind' if most > 0 else 'AHEAD'}"
    droop = (free.mean_speed(END - AVERAGE, END) - cycle.mean_speed(END - AVERAGE, END)) / LOAD_IN_USE
    return [
        judged("load", most >= -NOT_FELT, f"{told} within {SOON:g} s of a load of {LOAD_IN_USE:g} N m"),
        Measure("droop", droop, "less than an encoder shows" if abs(droop) < NEGLIGIBLE_DROOP else ""),
    ]


def _remedy(plan: DrivePlan, forth: float, back: float) -> str:
    if forth < 0.0 < back:
        shaft = [b for b in plan.bindings if b.port.name in ("theta_m", "omega_m")]
        other = ", ".join(f'{b.port.name} = "{b.name if b.turned else f"-{b.name}"}"' for b in shaft)
        return f"; its command and its angle disagree, and sign turns over both: map {other}, or the command so"
    return "; it does not turn: does it need an enable, a supply or other inputs?" if forth == back else ""
