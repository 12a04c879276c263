"""PID loops of the robot's computer: settings, scheduled gains, filters, and the discrete law.

The integral is rectangular and stops at the limit; the derivative has a first-order low-pass.
"""

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Literal

from pydantic import model_validator

from twin.kernel.compiled.function import njit
from twin.kernel.cosim.port import record, record_of, states
from twin.kernel.settings import Settings, Values, numbers, optional, setting, setting_fields

MAX_STIFFNESS_RATIO = 3.0
"""Maximum ratio of stiffness between neighbouring points of a schedule."""
LOW_PASS_RECORD = record(corner="f8", h="f8", share="f8")
"""Cache of a low-pass's share, with its arguments: an exponential takes as long as a loop."""


class Processor(Settings):
    """The controller's general settings: the keys directly in [controller]."""

    mode: Literal["force_position", "position"] = setting(help="control of force and position, or of position alone")
    period: float = setting("ms", gt=0, help="period of estimator and controller")
    delay_ticks: int = setting(default=0, ge=0, le=1000, help="computation delay of the command before the monitor")
    bus_delay_ticks: int = setting(
        default=0, ge=0, le=1000, help="delay of the bus from monitor to drives: of commanded speeds and power"
    )
    speed_limit: float = setting("rad/s", gt=0, field="omega_max", help="largest commanded motor speed")
    gravity_compensation: bool = setting(help="whether the estimated force excludes the robot's own weight")
    dead_zone: float = setting(
        "deg", default=0.0, ge=0, field="backlash", help="believed backlash (half width); the paper's estimator has 0"
    )


@njit(cache=True)
def state_variable(damping, g, fast, slow, x):
    """Advance a second-order state-variable filter by one sample `x`.

    Returned are the low-passed `x`, its derivative over 2 pi f, its second derivative over (2 pi f)^2, and the two new
    states. It uses the trapezoidal rule, so the derivatives belong exactly to the output (Zavalishin 2012, The Art of
    VA Filter Design, Ch. 4).

    Args:
        damping: 1/Q.
        g: tan(pi f h), with the corner f (Hz) and the period h (s).
        fast, slow: states after the previous call; at rest 0 and the signal.
    """
    # a factor independent of x, shared by all stages of a filter
    high = (x - (damping + g) * fast - slow) * (1.0 / (1.0 + g * (damping + g)))
    band = g * high + fast
    low = g * band + slow
    return low, band, high, band + g * high, low + g * band


class ScheduledGains(Settings):
    """[[controller.force.schedule]]: gains of the force loop on a tissue of one stiffness."""

    stiffness: float = setting(
        "N/m", gt=0, le=20_000, examples=[300.0], help="tissue stiffness; beyond the ends, gains are those of the end"
    )
    kp: float = setting("mm/N", gt=0, le=1000, examples=[2.0], help="proportional gain at this stiffness")
    ki: float = setting("mm/(N s)", gt=0, le=10_000, examples=[40.0], help="integral gain at this stiffness")


def schedule_error(points: Sequence[ScheduledGains]) -> str:
    """Return an error message for an invalid table of scheduled gains; "" if it is valid or empty."""
    if len(points) == 1:
        return "one point; expected two or more, for one is kp_mm_per_N and ki_mm_per_N_s"
    for number, (below, above) in enumerate(pairwise(points), start=2):
        if above.stiffness <= below.stiffness:
            order = f"point {number} is at {above.stiffness:g} N/m, after {below.stiffness:g}"
            return f"{order}; expected the softest first"
        if above.stiffness > MAX_STIFFNESS_RATIO * below.stiffness:
            gap = f"a gap from {below.stiffness:g} to {above.stiffness:g} N/m without valid gains"
            return f"{gap}; expected points at most {MAX_STIFFNESS_RATIO:g}-fold apart"
    return ""


class PositionLoop(Settings):
    """[controller.position]: PID from position error (m) to platform speed (m/s), the same on x, y and z."""

    kp: float = setting("1/s", ge=0, le=1000, tunable=True, help="proportional gain, platform speed per position error")
    ki: float = setting("1/s2", default=0.0, ge=0, help="integral gain")
    kd: float = setting(default=0.0, ge=0, help="derivative gain")
    derivative_filter: float = setting(
        "Hz", field="derivative_corner", default=0.0, ge=0, help="derivative's low-pass corner; 0: off"
    )


class ForceLoop(Settings):
    """[controller.force]: PID from force error (N) to a shift of the z reference (m), and its trigger."""

    reference: float | None = optional(
        "N", gt=0, le=50, example=5.0, field="F_z_ref", absent=0.0, tunable=True, help="pressing force to hold"
    )
    trigger: float | None = optional(
        "N", ge=0, example=0.6, field="trigger_force", absent=math.inf, help="pressing force that starts the loop, once"
    )
    trigger_time: float | None = optional(
        "s", ge=0, example=6.0, absent=math.inf, help="time at which the force loop starts, at any force"
    )
    kp: float = setting(
        "mm/N", ge=0, le=1000, into="gains", tunable=True, help="proportional gain, z reference shift per force error"
    )
    ki: float = setting("mm/(N s)", ge=0, le=10_000, into="gains", tunable=True, help="integral gain")
    kd: float = setting("mm s/N", default=0.0, ge=0, into="gains", help="derivative gain")
    derivative_filter: float = setting(
        "Hz", default=0.0, ge=0, into="gains", field="derivative_corner", help="derivative's low-pass corner; 0: off"
    )
    limit: float = setting("mm", gt=0, field="dp_z_max", help="largest shift of the z reference")
    filter: float = setting("Hz", ge=0, field="corner", help="low-pass corner of the estimated force; 0: off")
    schedule: tuple[ScheduledGains, ...] = setting(
        default=(),
        examples=[[
            {"stiffness_N_per_m": 600.0, "kp_mm_per_N": 2.0, "ki_mm_per_N_s": 30.0},
            {"stiffness_N_per_m": 1200.0, "kp_mm_per_N": 1.5, "ki_mm_per_N_s": 15.0},
        ]],
        help="gains over the stiffness that [controller.tissue] estimates, softest first; without it, these",
    )  # fmt: skip
    follow: float = setting(
        into="schedule", default=1.0, ge=0, le=1, help="with a schedule: fed-forward share of a reference change"
    )
    rate: float = setting(
        "1/s", into="schedule", default=2.0, gt=0, le=100, help="with a schedule: largest relative rate of its gains"
    )

    @model_validator(mode="after")
    def _softest_first(self) -> "ForceLoop":
        if refusal := schedule_error(self.schedule):
            raise ValueError(f"schedule: {refusal}")
        return self


class Gains(Values, parts=(setting_fields(PositionLoop),)):
    """PID gains of one control loop, SI, and the corner frequency of its derivative filter (0: unfiltered)."""


def force_gains(table: ForceLoop) -> Gains:
    return Gains(**numbers(table, into="gains"))


PID_RECORD = record_of(Gains, **states(integral="f8", derivative="f8", error="f8", started="i8"))


def loop_record(gains: Gains) -> tuple:
    """Return the memory record of a PID loop at rest, of dtype `PID_RECORD`."""
    return (*gains, 0.0, 0.0, 0.0, 0)


@njit(cache=True)
def low_pass_share(corner, h):
    """Return the share of a new sample in a first-order low-pass with `corner` (Hz) and period `h` (s)."""
    return 1.0 - math.exp(-2.0 * math.pi * corner * h) if corner > 0.0 else 1.0


@njit(cache=True)
def cached_share(cache, corner, h):
    """Return a first-order low-pass's share, kept in a `LOW_PASS_RECORD` (0 at first) until corner or period change."""
    if cache.corner != corner or cache.h != h:
        cache.corner, cache.h, cache.share = corner, h, low_pass_share(corner, h)
    return cache.share


@njit(cache=True)
def proposal(pid, e, h):
    """Compute the output of a PID loop for error `e`; return it with the new integral, which is not stored yet.

    The derivative acts on the error and starts at 0. A caller with an output limit accepts the integral only within
    that limit, which prevents windup by conditional integration.
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
    pid.integral = integral


@njit(cache=True)
def reset_loop(pid):
    pid.integral, pid.derivative, pid.error, pid.started = 0.0, 0.0, 0.0, 0
