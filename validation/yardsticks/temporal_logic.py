"""Distances of random curves from random formulas, beside the monitor rtamt's."""

import random
import re

import numpy as np
from numpy.typing import NDArray

from twin.robot.experiment.measure import parse_requirement
from twin.studies.metrics import requirement as distance
from validation.yardstick import Yardstick

FORMULAS = 300
LONGEST = 15
"""Ticks of a curve: windows of up to 6 begin within it, reach beyond its end and begin after it."""


class Curves:
    """A run of two signals, one tick a second."""

    tick = 1.0

    def __init__(self, **values: list[float]):
        self.values = {f"x.{name}": np.array(curve) for name, curve in values.items()}

    def held(self, key: str) -> NDArray:
        return self.values[key]


def formula(draw: random.Random, depth: int) -> str:
    """A formula of so many levels."""
    if depth == 0:
        return draw.choice(["x.a >= 1 m", "x.b < 0.5 m", "x.a >= x.b", "x.b <= 2 m"])
    begin = draw.randint(0, 3)
    window = f"[{begin} s, {begin + draw.randint(0, 3)} s]"
    left, right = (f"({formula(draw, depth - 1)})" for _ in range(2))
    one = [f"{how}{interval} {left}" for how in ("always", "eventually") for interval in ("", window)]
    two = [f"{left} {how} {right}" for how in ("and", "or", "implies", "until", f"until{window}")]
    return draw.choice([f"not {left}", *one, *two])


def theirs(text: str, curves: Curves) -> float:
    """What rtamt says of the same."""
    import rtamt

    formula = re.sub(r"\[(\d+) s, (\d+) s\]", r"[\1:\2]", re.sub(r" m\b", "", re.sub(r"x\.", "", text)))
    monitor = rtamt.StlDiscreteTimeSpecification()
    data = {name.removeprefix("x."): list(values) for name, values in curves.values.items()}
    for name in data:
        monitor.declare_var(name, "float")
    monitor.spec = formula
    monitor.parse()
    length = len(next(iter(data.values())))
    return monitor.evaluate({"time": list(range(length)), **data})[0][1]


def differences() -> dict[str, float]:
    """The largest, and how many formulas came to a number."""
    draw = random.Random(0)
    largest = 0.0
    for _ in range(FORMULAS):
        length = draw.randint(2, LONGEST)
        curves = Curves(**{name: [draw.gauss(0.0, 2.0) for _ in range(length)] for name in "ab"})
        text = formula(draw, draw.randint(1, 3))
        ours, other = distance.distance(parse_requirement(text), curves.tick, curves.held), theirs(text, curves)
        # of a window after the end both say never, or always
        largest = max(largest, 0.0 if ours == other else abs(ours - other))
    return {f"{FORMULAS} formulas": largest}


YARDSTICKS = (
    Yardstick(
        "distance of random curves from random formulas of signal temporal logic",
        "rtamt, discrete time, offline",
        "m",
        0.0,
        "minima, maxima and differences of the same numbers do not round differently",
        differences,
        ("rtamt",),
    ),
)
