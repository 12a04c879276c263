"""What a surface answers to being pressed in: its normal force from depth d and rate d_dot.

    Hunt-Crossley  F = K d (d / d_ref)^(n - 1) (1 + c d_dot)             Hunt and Crossley (1975), J Appl Mech 42:440
    Kelvin-Voigt   F = K d + C w(d / d_touch) d_dot                      Fung (1993), Biomechanics, Ch. 2
    exponential    F = K / beta (exp(beta d) - 1) (1 + c d_dot)          Fung (1993), Ch. 7

F is clamped at 0: a surface does not pull. Each is an elastic force with a potential, plus a part of the sign of d_dot;
what is clamped away would have given energy back. So no closed cycle gains energy.

Hunt and Crossley's stiffness has the unit N/m^n; here K (N/m) is the secant stiffness at the reference depth d_ref,
F(d_ref) = K d_ref, so that n has no unit to carry. In the exponential law K is the stiffness at first touch.

Kelvin-Voigt's damper alone would jump to C d_dot at first touch. The fade w(s) = s^2 (3 - 2 s), 1 from s = 1 on, is
smooth: a contact that grows over the touch depth.
"""

import math
from enum import IntEnum

from twin.compiled.function import njit


class ContactLaw(IntEnum):
    """By the names in an experiment's file, in capitals."""

    HUNT_CROSSLEY = 0
    KELVIN_VOIGT = 1
    EXPONENTIAL = 2


# numpy's division: a constant that a fault has set to 0 has to give NaN, because an exception of compiled code that the
# master calls by address is lost
@njit(cache=True, error_model="numpy", forceinline=True)
def elastic_force(parameters, d):
    """Force (N) of a surface that was pressed in to depth `d` > 0 (m) and stays there."""
    if parameters.law == ContactLaw.EXPONENTIAL:
        return parameters.K / parameters.stiffening * math.expm1(parameters.stiffening * d)
    if parameters.law == ContactLaw.HUNT_CROSSLEY and parameters.exponent != 1.0:
        return parameters.K * d * (d / parameters.reference_depth) ** (parameters.exponent - 1.0)
    return parameters.K * d


@njit(cache=True, error_model="numpy", forceinline=True)
def pressing_force(parameters, d, rate):
    """Normal force (N, >= 0) at depth `d` (m, positive inside) that grows at `rate` (m/s)."""
    if d <= 0.0:
        return 0.0
    if parameters.law == ContactLaw.KELVIN_VOIGT:
        share = min(d / parameters.touch_depth, 1.0)
        fade = share * share * (3.0 - 2.0 * share)
        return max(elastic_force(parameters, d) + parameters.damper * fade * rate, 0.0)
    return max(elastic_force(parameters, d) * (1.0 + parameters.damping * rate), 0.0)
