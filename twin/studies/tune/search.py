"""The fastest gains that meet the goals at every corner, found by differential evolution.

Storn and Price (1997, J Global Optimization 11:341): it needs no derivatives, which goals do not have, and with
a seed it finds the same gains every time. What is compared are gains of three digits, those that are written.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from itertools import count
from typing import NamedTuple

import numpy as np
from scipy.optimize import differential_evolution

from twin.studies.tune.corner import Corner
from twin.studies.tune.gains import LawGains, rounded
from twin.studies.tune.goals import Goals
from twin.studies.tune.prediction import Prediction, predicted

SEED = 1
POPULATION, GENERATIONS = 8, 40
"""Population per gain; most generations. On Fig. 4's experiment 25 end up to 15 % slower, and 60 are no faster."""
BOUNDS = ((0.1, 200.0), (1e-6, 0.1), (1e-5, 1.0))
"""Searched range of each gain: kp (1/s), force_kp (m/N), force_ki (m/(N s))."""
ROUNDING = 1e-3
"""By how much a goal may be missed and count as met, relative; for the overshoot, as a share of the step."""
PRICES = {"bandwidth": 1e2, "overshoot": 1e4, "margin": 1e4, "stability": 1e8}
"""A goal that is missed costs more than any slowness; what keeps people safe comes before bandwidth."""


Told = Callable[[float], None]


class Miss(NamedTuple):
    """A goal that gains miss at a corner.

    Attributes:
        goal: "margin", "overshoot", "bandwidth" or "stability".
        by: relative, for the overshoot a share of the step.
        reached: what there is instead, in the unit of the goal.
        at: where.
    """

    goal: str
    by: float
    reached: float
    at: Prediction


def misses(prediction: Prediction, goals: Goals) -> Iterator[Miss]:
    """Each goal that `prediction` misses. A bandwidth is asked of the law whose steps are looked at, see `Goals`."""
    if not prediction.stable:
        yield Miss("stability", prediction.radius - 1.0, prediction.radius, prediction)
        return
    over = prediction.sensitivity / goals.sensitivity - 1.0
    if over > ROUNDING:
        yield Miss("margin", over, prediction.sensitivity, prediction)
    for law, found in prediction.answers.items():
        if found.overshoot > goals.overshoot + ROUNDING:
            yield Miss("overshoot", found.overshoot - goals.overshoot, found.overshoot, prediction)
        if goals.bandwidth and law == goals.law and found.bandwidth < (1.0 - ROUNDING) * goals.bandwidth:
            yield Miss("bandwidth", 1.0 - found.bandwidth / goals.bandwidth, found.bandwidth, prediction)


def worst_misses(predictions: Sequence[Prediction], goals: Goals) -> list[Miss]:
    """Of each goal that is missed somewhere, where it is missed most."""
    worst: dict[str, Miss] = {}
    for prediction in predictions:
        for miss in misses(prediction, goals):
            if miss.goal not in worst or miss.by > worst[miss.goal].by:
                worst[miss.goal] = miss
    return list(worst.values())


def cost(predictions: Sequence[Prediction], goals: Goals) -> float:
    """Less is better: goals first, then the logarithms of the largest integrated error of each law, added.

    Not the settling time: that rewards a P law which jumps into its band and never gets to the end.
    """
    price = sum(PRICES[miss.goal] * (1.0 + miss.by) for miss in worst_misses(predictions, goals))
    largest: dict[str, float] = {}
    for prediction in predictions:
        for law, found in prediction.answers.items():
            largest[law] = max(largest.get(law, 0.0), found.error)
    # less than a millisecond is no better
    return price + sum(math.log(max(error, 1e-3)) for error in largest.values())


def best_gains(
    corners: Sequence[Corner],
    goals: Goals,
    start: LawGains,
    laws: str = "both",
    allowed: Callable[[LawGains], bool] = lambda gains: True,
    told: Told = lambda done: None,
) -> LawGains:
    """The gains of least `cost`. Those of the force law stay as in `start` where no corner has it.

    Args:
        laws: "both", or "force": kp of the position law stays as in `start`, too.
        allowed: which gains come into question at all.
        told: hears after each generation how much of the longest search is over, 0 .. 1.
    """
    force = any(corner.point.force_on for corner in corners)
    first, last = (1 if laws == "force" else 0), (len(BOUNDS) if force else 1)
    bounds = [(math.log10(low), math.log10(high)) for low, high in BOUNDS[first:last]]

    def gains(logarithms: np.ndarray) -> LawGains:
        return rounded(LawGains(*start[:first], *(float(10.0**x) for x in logarithms), *start[last:]))

    def judged(logarithms: np.ndarray) -> float:
        tried, predictions = gains(logarithms), []
        if not allowed(tried):
            return 2.0 * PRICES["stability"]
        for corner in corners:
            predictions.append(predicted(corner, tried))
            if not predictions[-1].stable:
                break
        return cost(predictions, goals)

    generations = count(1)
    found = differential_evolution(
        judged,
        bounds,
        seed=SEED,
        popsize=POPULATION,
        maxiter=GENERATIONS,
        tol=1e-3,
        polish=False,
        init="sobol",
        callback=lambda intermediate_result: told(next(generations) / GENERATIONS),
    )
    return gains(found.x)
