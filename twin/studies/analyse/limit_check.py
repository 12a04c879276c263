"""Check of the linear model's gain limits in the co-simulation, just below and just above the prediction.

A limit that fails the check is searched for in the co-simulation itself. Nudges of two sizes are tried, because a
nonlinear drive responds differently to them: friction damps small swings more than large ones, quantised registers
swallow them or keep them alive.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache

from twin.robot.experiment.experiment import Experiment
from twin.studies.analyse.linear.loops import DriveModel
from twin.studies.analyse.linear.margins import LARGEST_GAIN
from twin.studies.analyse.nudge import residual_swings
from twin.studies.analyse.operating_point import OperatingPoint

LIMIT_TOLERANCE = 0.15
"""Largest difference between predicted and simulated gain limit, as a share of the simulated one."""
BRACKET_RATIO = 1.05
"""Ratio of the gains that bracket the simulated limit when the bisection stops."""
SEARCH_RATIO = 1.5
"""Ratio of successive gains in the search for the limit."""
MAX_SEARCH_FACTOR = 10.0
"""Largest factor between the prediction and a searched limit."""
SMALL_NUDGE, LARGE_NUDGE, PRESSING_NUDGE = 1e-4, 1e-3, 3e-4
"""Nudges (m): about the encoders' resolution of the platform; a push in air; one that keeps contact."""
LastingNudges = tuple[float, ...]
"""Nudges (m) that last."""


@dataclass(frozen=True)
class LimitCheck:
    """The predicted gain limit of a control law at an operating point, and the limit in the co-simulation.

    Attributes:
        predicted: factor on all gains of the law, see `twin.studies.analyse.linear.margins.gain_limit`.
        low, high: factors between which a nudge begins to last in the co-simulation, each None if it was not reached.
        holds: whether the prediction is confirmed within `LIMIT_TOLERANCE`.
        reason: explanation of a failed prediction, as far as it was measured; "" if it holds.
    """

    law: str
    point: OperatingPoint
    predicted: float | None
    low: float | None
    high: float | None
    holds: bool
    reason: str = ""

    @property
    def simulated_limit(self) -> float | None:
        """Gain limit in the co-simulation, by bisection; None if the prediction holds or the limit was not found."""
        if self.holds or self.high is None or self.low is None:
            return None
        return float((self.low * self.high) ** 0.5)

    @property
    def shakes(self) -> bool:
        """Whether a nudge of the platform does not die out even with the gains as set."""
        return self.high is not None and self.high <= 1.0

    @property
    def limit_bounds(self) -> tuple[float | None, float | None]:
        return self.low, self.high

    JSON_KEYS = (
        "law p_B=point.p_B F_z=point.F_z predicted holds simulated=simulated_limit "
        "simulated_between=limit_bounds reason"
    )


def check_limit(
    experiment: Experiment, point: OperatingPoint, law: str, predicted: float | None, drives: Sequence[DriveModel]
) -> LimitCheck:
    @cache
    def lasting(factor: float) -> LastingNudges:
        return lasting_nudges(experiment, point, law, factor)

    expected = LARGEST_GAIN if predicted is None else max(predicted, 1.0 / LARGEST_GAIN)
    low, high = bracket(lambda factor: bool(lasting(factor)), expected, ends=predicted is not None)
    holds = (low, high) == borders(expected) or (predicted is None and high is None)
    return LimitCheck(law, point, predicted, low, high, holds, "" if holds else _reason(drives, lasting, high))


def borders(expected: float) -> tuple[float, float]:
    """Return the bounds between which the simulated gain limit must be if the prediction `expected` holds."""
    return expected / (1.0 + LIMIT_TOLERANCE), expected / (1.0 - LIMIT_TOLERANCE)


def bracket(lasts: Callable[[float], bool], expected: float, ends: bool = True) -> tuple[float | None, float | None]:
    """Bracket the limit by the highest tried factor whose nudges all die out and the next one, starting at `expected`.

    An end is None if it is too far from `expected`. The two are `borders(expected)` if the limit is between them, else
    their ratio is at most `BRACKET_RATIO`. `ends`: `expected` is a limit, not just the largest factor examined.
    """
    low, high = borders(expected)
    if lasts(low):
        high, least = low, low / MAX_SEARCH_FACTOR
        low /= SEARCH_RATIO
        while lasts(low):
            high, low = low, low / SEARCH_RATIO
            if high <= least:
                return None, high
    elif not ends:
        return low, None
    elif lasts(high):
        return low, high
    else:
        low, most = high, high * MAX_SEARCH_FACTOR
        high *= SEARCH_RATIO
        while not lasts(high):
            low, high = high, high * SEARCH_RATIO
            if low >= most:
                return low, None
    return bisect_limit(lasts, low, high)


def bisect_limit(lasts: Callable[[float], bool], low: float, high: float) -> tuple[float, float]:
    """Narrow the bracket (low, high) of a gain limit by bisection to a ratio of `BRACKET_RATIO`."""
    while high > BRACKET_RATIO * low:
        middle = (low * high) ** 0.5
        low, high = (low, middle) if lasts(middle) else (middle, high)
    return low, high


def lasting_nudges(experiment: Experiment, point: OperatingPoint, law: str, factor: float) -> LastingNudges:
    """Simulate a large and a small nudge with scaled gains of a control law; return the nudges that do not die out."""
    sizes = (PRESSING_NUDGE if point.in_contact else LARGE_NUDGE, SMALL_NUDGE)
    left = residual_swings(experiment, point, law, factor, sizes)
    return tuple(size for size, one in zip(sizes, left, strict=True) if one.lasts(size))


def _reason(drives: Sequence[DriveModel], lasting: Callable[[float], LastingNudges], high: float | None) -> str:
    """Explain a failed prediction of a gain limit by the measured nonlinearity of the drives."""
    reasons = []
    if any(drive.turning for drive in drives):
        reasons.append("at rest the drive is nonlinear for small signals; the linear model is of a turning shaft")
    at_limit = lasting(high) if high is not None else ()
    if at_limit and SMALL_NUDGE not in at_limit:
        reasons.append(
            f"a perturbation of {1e3 * at_limit[0]:g} mm persists there, one of {1e3 * SMALL_NUDGE:g} mm decays"
        )
    elif at_limit == (SMALL_NUDGE,):
        reasons.append(f"a perturbation of {1e3 * SMALL_NUDGE:g} mm persists there, a larger one decays")
    if not reasons:
        reasons.append("perturbations of all sizes agree, so the linear model is wrong")
    return "; ".join(reasons)
