"""[controller.position] and [controller.force]: the two loops of Fig. 3 B, and gains over the stiffness.

A state-variable filter of second order: low-pass, band-pass and high-pass of one signal at once.
"""

import math
from collections.abc import Sequence
from itertools import pairwise

from pydantic import model_validator

from twin.compiled.function import njit
from twin.settings import Settings, setting


@njit(cache=True)
def state_variable(damping, g, fast, slow, x):
    """(low-passed `x`, its derivative over 2 pi f, its second over (2 pi f)^2, the two states after it).

    By the trapezoidal rule, so the derivatives are those of the output itself (Zavalishin 2012, The Art of VA Filter
    Design, Ch. 4).

    Args:
        damping: 1/Q.
        g: tan(pi f h), of the corner f (Hz) and the period h (s).
        fast, slow: states after the call before; at rest 0 and the signal.
    """
    # a factor, which does not wait for x and is one for all stages of a filter
    high = (x - (damping + g) * fast - slow) * (1.0 / (1.0 + g * (damping + g)))
    band = g * high + fast
    low = g * band + slow
    return low, band, high, band + g * high, low + g * band


WIDEST_GAP = 3.0
"""Largest ratio of stiffness of two neighbours in a schedule."""


class ScheduledGains(Settings):
    """[[controller.force.schedule]]: gains of the force loop on a tissue of one stiffness."""

    stiffness: float = setting("N/m", gt=0, le=20_000, examples=[300.0], help="of the tissue")
    kp: float = setting("mm/N", gt=0, le=1000, examples=[2.0], help="shift of the z reference per force error")
    ki: float = setting("mm/(N s)", gt=0, le=10_000, examples=[40.0], help="integral gain")


def order_refused(points: Sequence[ScheduledGains]) -> str:
    """Why `points` are no schedule; "" if they are one, or none."""
    if len(points) == 1:
        return "one point; expected two or more, for one is kp_mm_per_N and ki_mm_per_N_s"
    for number, (below, above) in enumerate(pairwise(points), start=2):
        if above.stiffness <= below.stiffness:
            order = f"point {number} is at {above.stiffness:g} N/m, after {below.stiffness:g}"
            return f"{order}; expected the softest first"
        if above.stiffness > WIDEST_GAP * below.stiffness:
            gap = f"a gap from {below.stiffness:g} to {above.stiffness:g} N/m, in which nobody has said what holds"
            return f"{gap}; expected points at most {WIDEST_GAP:g}-fold apart"
    return ""


class PositionLoop(Settings):
    """[controller.position]: PID from position error (m) to platform speed (m/s), the same on x, y and z."""

    kp: float = setting("1/s", ge=0, le=1000, tunable=True, help="platform speed per position error")
    ki: float = setting("1/s2", default=0.0, ge=0, help="integral gain")
    kd: float = setting(default=0.0, ge=0, help="derivative gain")
    derivative_filter: float = setting(
        "Hz", field="derivative_corner", default=0.0, ge=0, help="low-pass of the derivative; 0: none"
    )


class ForceLoop(Settings):
    """[controller.force]: PID from force error (N) to a shift of the z reference (m), and what starts it."""

    reference: float | None = setting(
        "N",
        default=None,
        gt=0,
        le=50,
        examples=[5.0],
        field="F_z_ref",
        absent=0.0,
        tunable=True,
        help="pressing force to hold",
    )
    trigger: float | None = setting(
        "N",
        default=None,
        ge=0,
        examples=[0.6],
        field="trigger_force",
        absent=math.inf,
        help="pressing force that starts the force loop",
    )
    trigger_time: float | None = setting(
        "s", default=None, ge=0, examples=[6.0], absent=math.inf, help="when the force loop starts, whatever the force"
    )
    kp: float = setting(
        "mm/N", ge=0, le=1000, into="gains", tunable=True, help="shift of the z reference per force error"
    )
    ki: float = setting("mm/(N s)", ge=0, le=10_000, into="gains", tunable=True, help="integral gain")
    kd: float = setting("mm s/N", default=0.0, ge=0, into="gains", help="derivative gain")
    derivative_filter: float = setting(
        "Hz", default=0.0, ge=0, into="gains", field="derivative_corner", help="low-pass of the derivative; 0: none"
    )
    limit: float = setting("mm", gt=0, field="dp_z_max", help="largest shift of the z reference")
    filter: float = setting("Hz", ge=0, field="corner", help="low-pass of the estimated force; 0: none")
    schedule: tuple[ScheduledGains, ...] = setting(
        default=(),
        examples=[[
            {"stiffness_N_per_m": 600.0, "kp_mm_per_N": 2.0, "ki_mm_per_N_s": 30.0},
            {"stiffness_N_per_m": 1200.0, "kp_mm_per_N": 1.5, "ki_mm_per_N_s": 15.0},
        ]],
        help="gains over the stiffness that [controller.tissue] estimates, softest first; without it, these",
    )  # fmt: skip
    follow: float = setting(
        into="schedule",
        default=1.0,
        ge=0,
        le=1,
        help="with a schedule: share of a change of the reference that is fed forward",
    )
    rate: float = setting(
        "1/s", into="schedule", default=2.0, gt=0, le=100, help="with a schedule: largest relative change of the gains"
    )

    @model_validator(mode="after")
    def _softest_first(self) -> "ForceLoop":
        if refusal := order_refused(self.schedule):
            raise ValueError(f"schedule: {refusal}")
        return self
