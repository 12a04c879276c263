"""How fast a drive's speed follows small changes of its command: amplitudes over frequency, -3 dB bandwidth."""

import numpy as np

from twin.runs.assembly.drives import DrivePlan
from twin.studies.metrics.response import Curve
from twin.studies.qualify.bench import Response, response
from twin.studies.qualify.definitions import Measure
from twin.studies.qualify.operating_range import BIAS_SPEED, SMALL_SPEED, TICK

LOWEST, HIGHEST = 0.25, 200.0
"""Hz. The lowest stands for none at all; the highest is a fifth of the rate at which the command changes."""
PER_OCTAVE = 2
FINELY = 5
"""Frequencies tried once more between the two that embrace the bandwidth."""
LEAD_IN, PERIODS = 0.25, 1.0
"""Periods run before, and looked at, at each frequency."""
LEAST_LEAD_IN, LEAST_TIME = 0.1, 0.2
"""Of each, at least that long (s): a drive's own transient, and ripple that has to average out."""
NOTHING = 1e-6
"""Of the amplitude at the lowest frequency: what has fallen so far may have fallen to nothing."""
HALF_POWER = 1.0 / np.sqrt(2.0)


def frequency_response(plan: DrivePlan) -> tuple[Curve, Curve]:
    """(frequencies (n,) in Hz, amplitude of speed over amplitude of command (n,)), dense near the bandwidth.

    The drive's own: what holding the command for a tick H and averaging the speed over one take away, sin(x)/x with
    x = pi f H each, is given back.

    Raises:
        ComponentFailed: the drive failed.
    """
    count = 1 + round(PER_OCTAVE * np.log2(HIGHEST / LOWEST))
    coarse = np.geomspace(LOWEST, HIGHEST, count)
    gain = _gains(plan, coarse)
    below = np.flatnonzero(gain < HALF_POWER * gain[0])
    if len(below) == 0:
        return coarse, gain
    fine = np.geomspace(coarse[below[0] - 1], coarse[below[0]], FINELY + 2)[1:-1]
    order = np.argsort(np.concatenate([coarse, fine]))
    return np.concatenate([coarse, fine])[order], np.concatenate([gain, _gains(plan, fine)])[order]


def bandwidth(frequencies: Curve, gain: Curve, steady_gain: float) -> Measure:
    """Measure `bandwidth`: where `gain` first falls below 1/sqrt(2) of its value at the lowest frequency.

    Args:
        frequencies: Hz, ascending (n,).
        gain: (n,).
        steady_gain: speed over command at rest of both, for a drive too slow for the lowest frequency.
    """
    if gain[0] < HALF_POWER * abs(steady_gain):
        return Measure("bandwidth", None, f"less than {LOWEST:g} Hz")
    if not gain[0] > 0.0:
        return Measure("bandwidth", None, "does not follow its command")
    below = np.flatnonzero(gain < HALF_POWER * gain[0])
    if len(below) == 0:
        return Measure("bandwidth", None, f"more than {HIGHEST:g} Hz")
    last, first = below[0] - 1, below[0]
    # between two neighbours a gain over frequency is nearly straight on logarithmic axes
    falling = np.log(np.maximum(gain[[first, last]], NOTHING * gain[0]))
    at = np.interp(np.log(HALF_POWER * gain[0]), falling, np.log(frequencies[[first, last]]))
    return Measure("bandwidth", float(np.exp(at)))


def _gains(plan: DrivePlan, frequencies: Curve) -> Curve:
    """Amplitude ratios (n,) at `frequencies`, one after the other in one run."""
    lead_in = np.round(np.maximum(LEAD_IN / frequencies, LEAST_LEAD_IN) / TICK).astype(int)
    looked_at = np.round(np.maximum(PERIODS / frequencies, LEAST_TIME) / TICK).astype(int)
    phase = np.cumsum(2.0 * np.pi * TICK * np.repeat(frequencies, lead_in + looked_at))
    omega_ref = BIAS_SPEED + SMALL_SPEED * np.sin(phase)
    done = response(plan, omega_ref, np.zeros(len(phase)))
    ends = np.cumsum(lead_in + looked_at)
    seen = [_amplitude(done, phase, slice(end - n, end)) for end, n in zip(ends, looked_at, strict=True)]
    return np.array(seen) / SMALL_SPEED / np.sinc(frequencies * TICK) ** 2


def _amplitude(done: Response, phase: Curve, part: slice) -> float:
    """Amplitude (rad/s) of the speed's sine in a part of the run, fitted beside a straight line.

    The speed is the mean over each tick, from the angle: encoder steps and ripple are noise that the fit averages out.
    """
    speed = np.diff(done.theta_m[part]) / TICK
    angle = phase[part][1:]
    t = done.t[part][1:] - done.t[part][0]
    columns = np.column_stack([np.sin(angle), np.cos(angle), np.ones_like(t), t])
    fitted = np.linalg.lstsq(columns, speed, rcond=None)[0]
    return float(np.hypot(fitted[0], fitted[1]))
