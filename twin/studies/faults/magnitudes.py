"""Ranges of fault magnitudes: from the smallest of the catalogue up to a rule of the monitor, or physics."""

from typing import NamedTuple

import numpy as np

from twin.robot.experiment.fault import FAULT_KINDS

_ONE_SAMPLE = "JUMP: 25 rad/s is 2.9 deg of the motor's shaft in one sample of 2 ms"
_ALL_SAMPLES = "a share: all samples"
CLAIMED_SHARE, UPPER_SHARE = 1.0, 2.0
"""Shares of the catalogue's largest magnitude and of the upper end, see `magnitude_between`."""


class UpperEnd(NamedTuple):
    """Upper end of a kind's searched magnitudes, in the catalogue's unit, and the rule or physics behind it."""

    magnitude: float
    why: str


UPPER_ENDS = {
    "encoder_bias": UpperEnd(5.0, _ONE_SAMPLE),
    "encoder_drift": UpperEnd(1400.0, "JUMP: 25 rad/s is 1,432 deg/s"),
    "encoder_quantisation": UpperEnd(5.0, _ONE_SAMPLE),
    "encoder_dropout_hold": UpperEnd(1.0, _ALL_SAMPLES),
    "encoder_dropout_zero": UpperEnd(1.0, _ALL_SAMPLES),
    "encoder_dropout_nan": UpperEnd(1.0, _ALL_SAMPLES),
    "encoder_glitch": UpperEnd(180.0, "half a turn: no angle is further off"),
    "sample_delay": UpperEnd(200.0, "STALE: 10 ms"),
    "sample_jitter": UpperEnd(200.0, "STALE: 10 ms"),
    "sample_loss": UpperEnd(1.0, _ALL_SAMPLES),
    "controller_overrun": UpperEnd(1000.0, "as command_held: nothing arrives until the force is at its limit"),
    "command_held": UpperEnd(1.0, "a share: all commands"),
    "command_lost": UpperEnd(1.0, "a share: all commands"),
    "spring_softened": UpperEnd(0.1, "softer: as spring_broken; stiffer: the plant's integration, unstable from 20 on"),
    "stiffness_change": UpperEnd(100.0, "as hard as a wall: only the robot's springs still deflect"),
    "backlash_growth": UpperEnd(20.0, "DEFLECTION: 20 deg"),
    "joint_friction": UpperEnd(0.75, "the plant's integration, unstable from 0.8 on"),
    "belt_slip": UpperEnd(-90.0, "SPEED and DEFLECTION: 20 deg; the pose becomes singular"),
    "belief_k_s": UpperEnd(10.0, "DEFLECTION: 20 deg are 18 N, whatever is believed"),
    "belief_eta": UpperEnd(0.1, "DEFLECTION: 20 deg are 18 N, whatever is believed"),
    "drive_runaway": UpperEnd(200.0, "the fastest shipped drive, pmsm_foc: 197 rad/s without load"),
    "drive_saturation": UpperEnd(0.001, "as drive_dead"),
    "brown_out": UpperEnd(0.001, "as power_off"),
    "surface_jump": UpperEnd(25.0, "PENETRATION: 25 mm"),
    "contact_loss": UpperEnd(40.0, "TOO_LOW: 34 mm below the surface of the scale"),
    "breathing": UpperEnd(25.0, "PENETRATION: 25 mm"),
}


def has_two_ways(kind: str) -> bool:
    """Check whether the magnitude of a fault kind has two directions: either sign, or a factor and its inverse."""
    known = FAULT_KINDS[kind]
    return known.unit == "factor" or (known.magnitudes is not None and not {"gt", "ge"} & known.bounds.keys())


def directions(kind: str) -> tuple[float, ...]:
    """Return the signs to try for the magnitude of a fault kind: both if the magnitude is signed, else 1."""
    return (1.0, -1.0) if has_two_ways(kind) and FAULT_KINDS[kind].unit != "factor" else (1.0,)


def magnitude_between(kind: str, share: float, tick: float, slowest: float | None = None) -> float | None:
    """Compute the magnitude of a fault kind at a share of its range, by ratio; None for kinds without a magnitude.

    Args:
        share: 0 is the catalogue's smallest magnitude, 1 its largest, 2 the upper end; negative shares have the other
            sign, or are the inverse of a factor.
        tick: duration of a tick (s).
        slowest: magnitude at share 0; default: the catalogue's smallest.
    """
    known = FAULT_KINDS[kind]
    if known.magnitudes is None:
        return None
    smallest, largest, upper = slowest or known.magnitudes[0], known.magnitudes[-1], UPPER_ENDS[kind].magnitude
    # the largest is the catalogue's to the last bit
    size = largest
    if abs(share) < CLAIMED_SHARE:
        size = smallest * (largest / smallest) ** abs(share)
    elif abs(share) > CLAIMED_SHARE:
        size = largest * (upper / largest) ** (min(abs(share), UPPER_SHARE) - CLAIMED_SHARE)
    if known.unit == "ms":
        # delays are whole ticks
        return float(f"{1e3 * tick * max(1, round(1e-3 * size / tick)):.12g}")
    turned = size if share >= 0.0 else 1.0 / size if known.unit == "factor" else -size
    # four digits are enough of a search
    return largest if turned == largest else float(f"{turned:.4g}")


def share_of(kind: str, magnitude: float | None, slowest: float | None = None) -> float:
    """Convert a magnitude to its signed share of the fault kind's range, the inverse of `magnitude_between`.

    The share is 0 if `magnitude` is None or the kind has no magnitudes.
    """
    known = FAULT_KINDS[kind]
    if known.magnitudes is None or magnitude is None:
        return 0.0
    size, middle = magnitude, 1.0 if known.unit == "factor" else 0.0
    way = -1 if (size - middle) * (known.magnitudes[-1] - middle) < 0.0 else 1
    if way < 0:
        size = 1.0 / size if known.unit == "factor" else -size
    smallest, largest, upper = slowest or known.magnitudes[0], known.magnitudes[-1], UPPER_ENDS[kind].magnitude
    share = float(np.log(size / smallest) / np.log(largest / smallest))
    if share > CLAIMED_SHARE and upper != largest:
        share = CLAIMED_SHARE + float(np.log(size / largest) / np.log(upper / largest))
    return way * share
