"""Names, units and definitions of the checks and measures of a drive, the operating range, and the work cycle.

Drives are judged in the operating range, a range of speeds and loads on the motor shaft. Its numbers come from the
Fig. 4 experiment with the assumed robot of `experiments/robots/massage_robot.toml`. Most findings are based on the work
cycle: rest, a step of the command, a step of the load.
"""

import time
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from twin.kernel.errors import InputRefused
from twin.kernel.process.job import LONG_RUN_DURATION, MIN_ESTIMATE_TIME, duration_text
from twin.studies.command import Say, ignore_progress
from twin.studies.metrics.response import Curve

EXPECTED_TICKS = 75_000
"""Expected ticks of a qualification: 60,000 for a drive that stalls at once, 100,000 for one that cannot be stalled."""
REPORT_PERIOD = 1.0
"""Period of progress reports (s); the first comes after this time."""
TICK = 1e-3
"""Communication step (s), the same as in the experiments."""
SPEED_IN_USE = 0.5
"""Speed in use (rad/s): Fig. 4 commands at most 0.50, when the force loop triggers and the z reference jumps."""
SPEED_LIMIT = 8.0
"""Speed limit (rad/s), where the controller clamps its command."""
LOAD_IN_USE = 0.1
"""Load in use (N m): 5 N need 0.06 N m of each motor through a belt of N = 2; weight and inertia add to that."""
LOAD_PEAK = 0.6
"""Peak load (N m). Ten presses of 5 N: a drive that holds it has a margin in every task."""
MAX_LOAD = 4.0
"""End of the search for the stall torque (N m): no spring of this robot can exert more."""
SMALL_SPEED = 0.1
"""Amplitude for the frequency response (rad/s): a fifth of the speed in use, four steps of a 0.024 rad/s register."""
BIAS_SPEED = 0.25
"""Mean speed of the frequency response (rad/s): above the amplitude, so that friction never changes sign."""
ENCODER_RESOLUTION = 1.5e-3
"""Encoder resolution (rad). One count of the robot's 12-bit motor encoder: the robot cannot see a smaller angle."""
COMMAND_TIME = 0.2
"""Time of the command step (s)."""
LOAD_TIME = 2.2
"""Time of the load step (s); slow drives have settled by then."""
CYCLE_END = 4.2
"""End of the work cycle (s)."""
AVERAGE_TIME = 1.0
"""Averaging time of speeds before the load step, and before the end (s)."""
CHECK_MEANINGS = {
    "contract": "every required quantity of the drive contract is there, with a causality and unit that fit",
    "runs": "every run of the qualification ends without an error status, NaN or infinity",
    "direction": "a positive command turns theta_m up, the same negative one down",
    "scale": f"commanded with {SPEED_IN_USE:g} rad/s without load, it is within a factor 1.5: no unit or gear is wrong",
    "rate": "omega_m is the rate of theta_m, within 5 %",
    "load": f"a load of {LOAD_IN_USE:g} N m sets the shaft back, or does nothing; it never pushes it forward",
    "repeats": "two new instances give the same theta_m and omega_m, bit for bit",
    "reset": "after reset an instance repeats its first run, bit for bit",
    "state": "after its state was saved, changed and restored, an instance continues from there, bit for bit",
    "written": "another process reads its serialized state and continues from there, bit for bit",
}
"""Check name -> condition; `reset`, `state` and `written` do not disqualify a drive, as not every run needs these."""
NEGLIGIBLE_DROOP = ENCODER_RESOLUTION / LOAD_IN_USE
"""Threshold of a negligible droop (rad/s per N m): one encoder count per second of averaging."""
UNIT_ERROR_FACTOR = 100.0
"""Ratio to the drives of fmus/ above which a drive's load is probably in another unit."""
MAX_DROOP, STALL_RANGE = 0.6, (0.378, 2.94)
"""Limits of the drives of fmus/ but the ideal: droop (rad/s per N m), smallest and largest stall torque (N m)."""


class Workload:
    """Progress counter of the ticks of a qualification; `sure` if more than an hour is confirmed."""

    def __init__(self, label: str, say: Say = ignore_progress, sure: bool = True):
        self._label, self._say, self._sure = label, say, sure
        self._done, self._taken = 0, 0.0
        self._reported = time.monotonic()

    def count_ticks(self, ticks: int, taken: float) -> None:
        """Add completed ticks and their wall time (s) to the progress of the qualification, and report it."""
        self._done += ticks
        self._taken += taken
        each = self._taken / self._done
        total = max(EXPECTED_TICKS, self._done)
        if self._taken > MIN_ESTIMATE_TIME and each * total > LONG_RUN_DURATION and not self._sure:
            raise InputRefused(
                f"{self._label}: a step takes {1e3 * each:.3g} ms, and the whole check about "
                f"{duration_text(each * total)}; add --yes if that is intended"
            )
        if self._taken > REPORT_PERIOD and time.monotonic() - self._reported > REPORT_PERIOD:
            self._reported = time.monotonic()
            self._say(f"{self._label}, {1e3 * each:.3g} ms a step", self._done / total)


def work_cycle(speed: float = SPEED_IN_USE, load: float = LOAD_IN_USE, end: float = CYCLE_END) -> tuple[Curve, Curve]:
    """Return speed (rad/s) and load (N m) per tick of the work cycle, stepping to the values, up to `end` (s)."""
    k = np.arange(round(end / TICK))
    return np.where(k >= round(COMMAND_TIME / TICK), speed, 0.0), np.where(k >= round(LOAD_TIME / TICK), load, 0.0)


class Definition(NamedTuple):
    """Definition of a measure of drives: short name, SI unit ("%" for a share), exact meaning."""

    text: str
    unit: str
    meaning: str


MEASURE_DEFINITIONS = {
    "speed": Definition(
        "speed in use", "rad/s",
        f"mean speed without load, commanded with {SPEED_IN_USE:g} rad/s",
    ),
    "no_load_speed": Definition(
        "no-load speed", "rad/s",
        f"mean speed without load, commanded with the robot's limit of {SPEED_LIMIT:g} rad/s",
    ),
    "ripple": Definition(
        "ripple", "rad/s",
        f"largest deviation of omega_m from its mean while it turns steadily at {SPEED_IN_USE:g} rad/s without load",
    ),
    "droop": Definition(
        "droop", "rad/s per N m",
        f"mean speed lost to a steady load of {LOAD_IN_USE:g} N m at {SPEED_IN_USE:g} rad/s, by the load",
    ),
    "bandwidth": Definition(
        "bandwidth (-3 dB)", "Hz",
        f"frequency at which the speed's amplitude has fallen to 1/sqrt(2) of its value at 0.25 Hz, for a command of "
        f"{BIAS_SPEED:g} rad/s with a sine of {SMALL_SPEED:g} rad/s on it",
    ),
    "rise_time": Definition(
        "rise 10-90 %", "s",
        f"time omega_m takes from 10 to 90 % of its final mean when the command steps from 0 to {SPEED_IN_USE:g} rad/s",
    ),
    "settling_time": Definition(
        "settling to 5 %", "s",
        "time from that step until omega_m stays within 5 % of its final mean",
    ),
    "overshoot": Definition(
        "overshoot", "%",
        "largest excess of omega_m over its final mean after that step; 0 if not above the ripple",
    ),
    "stall_torque": Definition(
        "stall torque", "N m",
        f"load beyond which the shaft, commanded with {SPEED_IN_USE:g} rad/s, no longer makes a tenth of that: found "
        "by a load that grows by 0.25 N m/s, then held for 1 s",
    ),
    "step_error": Definition(
        "step-size error", "rad",
        "largest change of theta_m, over start and load step, when the FMU is stepped twice as finely",
    ),
    "cost": Definition(
        "cost of a 1 ms step", "s",
        "wall time in the drive's step function per tick, velocity loop included: the least of three runs",
    ),
}  # fmt: skip


Verdict = Literal["ok", "FAIL", "note"]


@dataclass(frozen=True)
class Check:
    """Result of one check in `CHECK_MEANINGS`; "FAIL" disqualifies, "note" informs; `detail`: evidence."""

    name: str
    verdict: Verdict
    detail: str


@dataclass(frozen=True)
class Measure:
    """Result of one measurement in the definition's unit, None if impossible; `remark`: the reason, or on the value."""

    name: str
    value: float | None
    remark: str = ""


Finding = Check | Measure


def make_check(name: str, right: bool, detail: str, otherwise: Verdict = "FAIL") -> Check:
    return Check(name, "ok" if right else otherwise, detail)
