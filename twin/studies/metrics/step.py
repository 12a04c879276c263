"""The answer to a step: how soon, how far beyond, how close in the end.

Definitions, for y from its value y_0 before the step to its final value y_inf, share = (y - y_0) / (y_inf - y_0):
delay and rise times run between first crossings of 10, 50 and 90 % of the share, between samples on a straight line
(as in IEEE 181); settling times end where the share stays within 2 or 5 % of 1, seen for at least the last tenth of
the samples; overshoot is the largest share beyond 1 (terms as in IEC 60050-351). The errors are against the reference,
e = r - y: IAE, ISE and ITAE are the integrals of |e|, e^2 and t |e| from the step to the end of the samples.

A share needs a final value, so a response that is still on its way is refused rather than measured.
"""

from dataclasses import dataclass

import numpy as np

from twin.errors import InputRefused
from twin.studies.metrics.response import Curve, overshoot, settling_time

TAIL = 0.1
"""Share of the samples at the end over which the final value is a mean."""
STILL = 0.05
"""A response has settled if it stays this near to its final value (share of the step) for twice the tail."""


@dataclass(frozen=True)
class StepInfo:
    """What a response to a step at t = 0 comes to; times in s, values in the unit of y.

    Attributes:
        final: y_inf.
        peak: the value of y farthest along the step;
        peak_time: when.
        delay_time: to 50 %.
        rise_time: from 10 to 90 %.
        settling_time_2, settling_time_5: to stay within 2, 5 %; infinity if it was outside within the last tenth, as a
            response that hunts for ever is.
        overshoot: share of the step.
        steady_state_error: r - y_inf.
        IAE, ISE, ITAE: unit times s, unit squared times s, unit times s squared.
    """

    final: float
    peak: float
    peak_time: float
    delay_time: float
    rise_time: float
    settling_time_2: float
    settling_time_5: float
    overshoot: float
    steady_state_error: float
    IAE: float
    ISE: float
    ITAE: float


def step_info(t: Curve, y: Curve, before: float, reference: float) -> StepInfo:
    """Measure the response y to a step of its reference at t = 0.

    Args:
        t: s, ascending, from 0 on (n,).
        y: samples (n,).
        before: y_0.
        reference: r, constant after the step.

    Raises:
        InputRefused: fewer than 20 samples, no step, no answer, or a response that has not settled at the end.
    """
    if len(t) < 20:
        raise InputRefused(f"a step response of {len(t)} samples: expected 20 or more; record longer or faster")
    if reference == before:
        raise InputRefused(f"a step from {before:g} to {reference:g}: no step")
    tail = max(2, round(TAIL * len(t)))
    final = float(np.mean(y[-tail:]))
    step = final - before
    if abs(step) < STILL * abs(reference - before):
        raise InputRefused(
            f"no answer to the step from {before:g} to {reference:g}: in the end it is {final:g}, moved less than "
            f"{100 * STILL:g} % of the step"
        )
    rest = float(np.max(np.abs(y[-2 * tail :] - final)))
    if rest > STILL * abs(step):
        raise InputRefused(
            f"the step response has not settled: in its last {t[-1] - t[-2 * tail]:.3g} s it is still {rest:.3g} from "
            f"its end, {100 * rest / abs(step):.0f} % of the step, expected at most {100 * STILL:g} %; simulate longer"
        )
    share = (y - before) / step
    farthest = int(np.argmax(share))
    settled_2, settled_5 = (settling_time(t, share, 1.0, band) for band in (0.02, 0.05))
    e = reference - y
    return StepInfo(
        final=final,
        peak=float(y[farthest]),
        peak_time=float(t[farthest]),
        delay_time=crossing_time(t, share, 0.5),
        rise_time=crossing_time(t, share, 0.9) - crossing_time(t, share, 0.1),
        settling_time_2=settled_2 if settled_2 <= t[-tail] else np.inf,
        settling_time_5=settled_5 if settled_5 <= t[-tail] else np.inf,
        overshoot=overshoot(share, 1.0),
        steady_state_error=reference - final,
        IAE=float(np.trapezoid(np.abs(e), t)),
        ISE=float(np.trapezoid(e**2, t)),
        ITAE=float(np.trapezoid(t * np.abs(e), t)),
    )


def crossing_time(t: Curve, y: Curve, level: float) -> float:
    """Time at which y first reaches `level` from below, between samples on a straight line; infinity: never."""
    above = np.flatnonzero(y >= level)
    if len(above) == 0:
        return np.inf
    k = int(above[0])
    if k == 0:
        return float(t[0])
    return float(t[k - 1] + (level - y[k - 1]) / (y[k] - y[k - 1]) * (t[k] - t[k - 1]))
