"""What the controller may do besides the paper's law: know the tissue, take gains for it, go along with the breath."""

from collections.abc import Sequence
from itertools import pairwise

from pydantic import Field

from twin.experiment.quantity import Section, quantity

WIDEST_GAP = 3.0
"""Largest ratio of stiffness of two neighbours in a schedule."""


class ScheduledGains(Section):
    """[[controller.force.schedule]]: gains of the force loop on a tissue of one stiffness."""

    stiffness: float = quantity("stiffness_N_per_m", "of the tissue", gt=0, le=20_000, examples=[300.0])
    kp: float = quantity("kp_mm_per_N", "shift of the z reference per force error", gt=0, le=1000, examples=[2.0])
    ki: float = quantity("ki_mm_per_N_s", "integral gain", gt=0, le=10_000, examples=[40.0])


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


class Tissue(Section):
    """[controller.tissue]: how the controller finds out, while pressing, how stiff the tissue is."""

    frequency: float = quantity("frequency_Hz", "middle of the band that is looked at, and of the dither", 5.0, ge=0.5)
    window: float = quantity("window_s", "how long what was seen is remembered", 0.5, gt=0, le=100)
    dither: float = quantity(
        "dither_N", "amplitude of the force that moves the tissue where nothing else does; 0: none", 0.15, ge=0, le=2
    )
    tolerance: float = Field(
        0.3, gt=0, le=1, description="standard error over stiffness from which on it is not trusted"
    )


class Breath(Section):
    """[controller.breath]: follow a surface that breathes, with the tissue known by [controller.tissue]."""

    rate: float = quantity("rate_per_min", "believed rate, to begin with", 15.0, gt=0, le=120)
    lag: float = quantity("lag_ms", "believed lag of the robot behind its reference", 20.0, ge=0, le=1000)
