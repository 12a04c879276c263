"""A discrete PID: rectangular integral that stops at the limit, first-order filter on the derivative."""

import math

from twin.compiled.function import njit
from twin.controller.loops import ForceLoop, PositionLoop
from twin.cosim.record import record, record_of
from twin.settings import Values, numbers, taken


class Gains(Values, parts=(taken(PositionLoop),)):
    """Gains of one loop, SI: kp, ki, kd, and the corner of the derivative filter (0: unfiltered)."""


def force_gains(table: ForceLoop) -> Gains:
    """Those of the force loop."""
    return Gains(**numbers(table, into="gains"))


PID = record_of(Gains, integral="f8", derivative="f8", error="f8", started="i8")
LOW_PASS = record(corner="f8", h="f8", share="f8")
"""The share of a low-pass that was worked out last, and for what: an exponential costs as much as a loop."""


def loop(gains: Gains) -> tuple:
    """A record of dtype `PID` at rest."""
    return (*gains, 0.0, 0.0, 0.0, 0)


@njit(cache=True)
def low_pass_share(corner, h):
    """How much of a new sample a first-order low-pass with `corner` (Hz) takes over per period `h` (s)."""
    return 1.0 - math.exp(-2.0 * math.pi * corner * h) if corner > 0.0 else 1.0


@njit(cache=True)
def kept_share(kept, corner, h):
    """`low_pass_share`, worked out where corner or period are not those of the call before.

    Args:
        kept: a record of `LOW_PASS`; at first 0.
    """
    if kept.corner != corner or kept.h != h:
        kept.corner, kept.h, kept.share = corner, h, low_pass_share(corner, h)
    return kept.share


@njit(cache=True)
def proposal(pid, e, h):
    """(output, integral): what the loop would do for error `e`; `accept` keeps the integral.

    The derivative acts on the error and starts at 0. Whoever limits the output accepts the integral only if the output
    was within its limit: conditional integration, so nothing winds up.
    """
    if pid.started and pid.kd != 0.0:
        rate = (e - pid.error) / h
        pid.derivative += low_pass_share(pid.derivative_corner, h) * (rate - pid.derivative)
    pid.error = e
    pid.started = 1
    integral = pid.integral + pid.ki * e * h
    return pid.kp * e + integral + pid.kd * pid.derivative, integral


@njit(cache=True)
def accept(pid, integral):
    """Keep the proposed integral."""
    pid.integral = integral


@njit(cache=True)
def rest(pid):
    """Forget every error so far."""
    pid.integral, pid.derivative, pid.error, pid.started = 0.0, 0.0, 0.0, 0
