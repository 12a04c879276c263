"""What is checked and measured: names, units and definitions, in the order in which they are shown; what is found."""

from dataclasses import dataclass
from typing import Literal, NamedTuple

from twin.studies.qualify.operating_range import (
    BIAS_SPEED,
    LOAD_IN_USE,
    RESOLUTION,
    SMALL_SPEED,
    SPEED_IN_USE,
    SPEED_LIMIT,
)


class Definition(NamedTuple):
    """A measure: what tables call it, its SI unit ("%" for a share), what exactly it is."""

    text: str
    unit: str
    meaning: str


CHECKS = {
    "contract": "every required quantity of the drive contract is there, with a causality and unit that fit",
    "runs": "every run of the qualification ends without an error status, NaN or infinity",
    "direction": "a positive command turns theta_m up, the same negative one down",
    "scale": f"commanded with {SPEED_IN_USE:g} rad/s without load, it is within a factor 1.5: no unit or gear is wrong",
    "rate": "omega_m is the rate of theta_m, within 5 %",
    "load": f"a load of {LOAD_IN_USE:g} N m sets the shaft back, or does nothing; it never pushes it forward",
    "repeats": "two fresh instances give the same theta_m and omega_m, bit for bit",
    "reset": "after reset an instance repeats its first run, bit for bit",
    "state": "after its state was saved, changed and restored, an instance goes on from there, bit for bit",
}
"""Name -> what holds. All disqualify a drive but `reset` and `state`: nothing that runs an experiment needs those."""
MEASURES = {
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
        f"frequency at which the speed's amplitude has fallen to 1/sqrt(2) of what it is at 0.25 Hz, for a command of "
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
        "by how much omega_m exceeds its final mean at most after that step; 0 where it is no more than the ripple",
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

NEGLIGIBLE_DROOP = RESOLUTION / LOAD_IN_USE
"""rad/s per N m. One encoder count per second of averaging: less than this is not told from none."""


Verdict = Literal["ok", "FAIL", "note"]


@dataclass(frozen=True)
class Check:
    """One thing that is right or not.

    Attributes:
        name: key in `CHECKS`.
        verdict: "FAIL" disqualifies the drive, "note" is worth knowing and does not.
        detail: the evidence, in a phrase.
    """

    name: str
    verdict: Verdict
    detail: str


@dataclass(frozen=True)
class Measure:
    """One number.

    Attributes:
        name: key in `MEASURES`.
        value: in the unit of the definition; None: not measurable.
        remark: why not, or what to know about the value.
    """

    name: str
    value: float | None
    remark: str = ""


Finding = Check | Measure


def judged(name: str, right: bool, detail: str, otherwise: Verdict = "FAIL") -> Check:
    """A check that is "ok" if `right`, else `otherwise`."""
    return Check(name, "ok" if right else otherwise, detail)
