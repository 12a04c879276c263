"""Distances against their definition, written down word for word and slow."""

import random
import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twin.kernel.errors import InputRefused
from twin.kernel.recording.messages import Field
from twin.robot.experiment.measure import (
    BooleanOp,
    Formula,
    Inequality,
    Negation,
    Temporal,
    Term,
    UntilFormula,
    parse_requirement,
)
from twin.studies.metrics.requirement import checked_requirement, distance
from validation.yardsticks.temporal_logic import Curves, formula


def value(term: Term, run: Curves, at: int) -> float:
    assert not isinstance(term.value, tuple)
    return term.sign * (float(run.values[term.value][at]) if isinstance(term.value, str) else term.value)


def defined(formula: Formula, run: Curves, at: int) -> float:
    """The distance at tick `at`, by definition."""
    end = len(next(iter(run.values.values())))

    def window(begin: float, last: float | None) -> range:
        return range(at + int(begin), end if last is None else min(end, at + int(last) + 1))

    match formula:
        case Inequality(smaller, larger):
            return sum(value(term, run, at) for term in larger) - sum(value(term, run, at) for term in smaller)
        case Negation(of):
            return -defined(of, run, at)
        case BooleanOp(how, left, right):
            return (min if how == "and" else max)(defined(left, run, at), defined(right, run, at))
        case Temporal("always", of, begin, last):
            return min((defined(of, run, then) for then in window(begin, last)), default=np.inf)
        case Temporal(_, of, begin, last):
            return max((defined(of, run, then) for then in window(begin, last)), default=-np.inf)
        case UntilFormula(hold, goal, begin, last):
            return max(
                (
                    min([defined(goal, run, then), *(defined(hold, run, before) for before in range(at, then))])
                    for then in window(begin, last)
                ),
                default=-np.inf,
            )
    raise AssertionError(formula)


@given(st.integers(0, 2**32), st.lists(st.floats(-3.0, 3.0), min_size=1, max_size=12))
def test_a_distance_is_what_its_definition_says(seed: int, a: list[float]):
    draw = random.Random(seed)
    run = Curves(a=a, b=[draw.gauss(0.0, 2.0) for _ in a])
    wanted = parse_requirement(formula(draw, draw.randint(1, 2)))
    # the same minima and maxima of the same differences
    assert distance(wanted, run.tick, run.held) == defined(wanted, run, 0)


def test_of_a_force_it_is_the_room_that_its_peak_leaves():
    run = Curves(a=[0.0, 3.0, 5.0, 4.0])
    assert distance(parse_requirement("always (x.a <= 18 m)"), run.tick, run.held) == 13.0
    assert distance(parse_requirement("always[0 s, 1 s] (x.a <= 18 m)"), run.tick, run.held) == 15.0
    assert distance(parse_requirement("eventually (x.a >= 6 m)"), run.tick, run.held) == -1.0


def test_a_vector_between_bars_is_its_length():
    force = np.array([[3.0, 0.0, 4.0], [0.0, 0.0, 1.0]])
    assert distance(parse_requirement("always (|plant.F_ee_B| <= 18 N)"), 0.001, lambda key: force) == 13.0


def test_what_is_true_or_false_limits_no_distance():
    signals = {"c.on": np.array([False, True]), "x.a": np.array([9.0, 4.0])}
    assert distance(parse_requirement("always (c.on implies x.a <= 5 N)"), 1.0, signals.__getitem__) == 1.0
    assert distance(parse_requirement("always (x.a <= 5 N)"), 1.0, signals.__getitem__) == -4.0


def test_a_minute_at_1_ms_is_judged_in_a_tenth_of_a_second():
    run = Curves(a=list(np.sin(np.arange(62_000))))
    run.tick = 0.001
    wanted = parse_requirement("always (x.a >= 0.9 m implies eventually[0 s, 3 s] (always[0 s, 1 s] x.a <= 0.5 m))")
    began = time.process_time()
    distance(wanted, run.tick, run.held)
    # 10 ms were seen; a window looked at tick by tick takes minutes
    assert time.process_time() - began < 1.0


FIELDS = {
    "plant.F_ee_B": Field("F_ee_B", 3, "double", "N", ""),
    "plant.p_B": Field("p_B", 3, "double", "m", ""),
    "controller.F_z": Field("F_z", 1, "double", "N", ""),
    "controller.omega_ref": Field("omega_ref", 3, "double", "rad/s", ""),
    "controller.triggered": Field("triggered", 1, "bool", "1", ""),
}


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("always (plant.F_ee <= 18 N)", r"no such signal as plant.F_ee; did you mean 'plant.F_ee_B'"),
        ("always (|plant.F_ee_B| <= 18)", "units differ: N and 1; .* every number its unit"),
        ("always (|plant.F_ee_B| <= 18 mm)", "units differ: N and m; give"),
        ("always (plant.F_ee_B <= 18 N)", r"a comparison of vectors; expected one component, x\[2\]"),
        ("always (1 N <= plant.F_ee_B)", "a comparison of vectors"),
        ("always (plant.F_ee_B[3] <= 18 N)", r"it has 3 components; expected \[0\] to \[2\]"),
        ("always (controller.F_z[0] <= 18 N)", "expected no index"),
        ("always (plant.p_B - controller.F_z <= 1 m)", "units differ: m and N; give"),
        ("always (|plant.F_ee_B + controller.F_z| <= 1 N)", "a sum of 3 and 1 components"),
        ("controller.F_z", "is not true or false; expected a comparison"),
        ("1 N <= 2 N", "a comparison of numbers"),
        ("always (controller.F_z <= 9 N and plant.p_B[2] <= 0 mm)", "compares in N and in m"),
        ("alway (controller.F_z <= 9 N)", "unknown word 'alway'"),
    ],
)
def test_a_requirement_that_no_run_can_be_held_to_is_refused(text, told):
    with pytest.raises(InputRefused, match=told):
        checked_requirement(text, FIELDS)


def test_the_unit_of_a_distance_is_that_of_its_comparisons():
    assert checked_requirement("always (|controller.omega_ref| <= 30 rpm)", FIELDS)[1] == "rad/s"
    assert checked_requirement("eventually controller.triggered", FIELDS)[1] == "1"
