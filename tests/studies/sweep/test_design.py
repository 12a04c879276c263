"""Designs: every run once, the same for the same seed, distributed as the file says."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from tests.studies.sweep.definitions import definition
from twin.errors import InputRefused
from twin.studies.sweep.design import MOST, Point, largest_count, points, unit_cube
from twin.studies.sweep.vary import Value, Vary

numbers = st.lists(st.integers(-50, 50), min_size=1, max_size=4, unique=True)
grids = st.lists(numbers, min_size=1, max_size=4)
shares = st.floats(1e-12, 1.0 - 1e-12)


def vary(**table) -> Vary:
    return Vary.model_validate({"key": "k", **table})


def levels(key: str, values: list[int]) -> dict:
    return {"key": key, "values": values}


def identity(point: Point) -> tuple[object, ...]:
    return point.drive, *sorted(point.parameters.items())


@given(grids, st.sampled_from([[], ["a"], ["a", "b"]]))
def test_a_grid_is_every_combination_once_for_every_drive(values: list[list[int]], drives: list[str]):
    plan = definition(vary=[levels(f"k{n}", list_) for n, list_ in enumerate(values)], drives=drives)
    found = [identity(point) for point in points(plan)]
    assert len(set(found)) == len(found) == largest_count(plan)
    assert len(found) == math.prod(map(len, values)) * max(1, len(drives))


@given(st.sampled_from(["latin_hypercube", "random", "sobol"]), st.integers(0, 2**40), st.integers(0, 4))
def test_the_same_seed_draws_the_same_runs_for_every_drive(design: str, seed: int, exponent: int):
    tables = [{"key": "a", "from": -1.0, "to": 2.0}, {"key": "b", "distribution": "normal", "mean": 3.0, "std": 0.5}]
    plan = definition(design=design, seed=seed, runs=2**exponent, vary=tables, drives=["x", "y"])
    found = points(plan)
    assert found == points(plan)
    x, y = ([p.parameters for p in found if p.drive == drive] for drive in ("x", "y"))
    assert x == y and len(x) == 2**exponent
    assert all(-1.0 < float(parameters["a"]) < 2.0 for parameters in x)


def test_another_seed_draws_other_runs():
    tables = [{"key": "a", "from": 0.0, "to": 1.0}]
    one, other = (definition(design="random", seed=seed, runs=3, vary=tables) for seed in (1, 2))
    assert points(one) != points(other)


@given(st.integers(1, 40), st.integers(0, 100))
def test_a_latin_hypercube_has_one_draw_in_every_stratum_of_every_parameter(runs: int, seed: int):
    tables = [{"key": key, "from": 0.0, "to": 1.0} for key in "ab"]
    cube = unit_cube(definition(design="latin_hypercube", runs=runs, seed=seed, vary=tables))
    assert np.array_equal(np.sort(np.floor(cube * runs), axis=0), np.tile(np.arange(runs)[:, None], 2))


@given(st.integers(1, 7), st.integers(0, 100))
def test_a_sobol_sequence_has_one_draw_in_every_stratum_of_a_power_of_two(exponent: int, seed: int):
    runs = 2**exponent
    tables = [{"key": key, "from": 0.0, "to": 1.0} for key in "abc"]
    cube = unit_cube(definition(design="sobol", runs=runs, seed=seed, vary=tables))
    assert np.array_equal(np.sort(np.floor(cube * runs), axis=0), np.tile(np.arange(runs)[:, None], 3))


@given(shares)
def test_a_draw_is_the_quantile_of_its_distribution(u: float):
    low_high = {"from": 1.0, "to": 5.0}
    quantiles = [
        (vary(distribution="normal", mean=2.0, std=0.3), stats.norm(2.0, 0.3)),
        (vary(distribution="lognormal", median=1500.0, sigma=0.4), stats.lognorm(0.4, scale=1500.0)),
        (vary(distribution="uniform", **low_high), stats.uniform(1.0, 4.0)),
        (vary(scale="log", **low_high), stats.loguniform(1.0, 5.0)),
    ]
    for table, distribution in quantiles:
        # two libraries' inverses of the normal distribution differ in the last digits
        assert table.drawn(u) == pytest.approx(float(distribution.ppf(u)), rel=1e-9)


@given(numbers, shares)
def test_a_list_is_drawn_from_evenly(values: list[int], u: float):
    assert vary(values=values).drawn(u) == values[int(u * len(values))]


@given(st.floats(0.1, 10.0), st.floats(1.1, 100.0), st.integers(2, 9))
def test_levels_reach_both_ends_and_are_even_in_value_or_in_ratio(low: float, ratio: float, count: int):
    ends = {"from": low, "to": low * ratio, "count": count}
    even, log = (np.array(vary(scale=scale, **ends).levels(), dtype=float) for scale in ("linear", "log"))
    # rounding of numpy's spacing
    for found in (even, log):
        assert found[[0, -1]] == pytest.approx([low, low * ratio], rel=1e-12)
    assert np.diff(even) == pytest.approx(np.full(count - 1, low * (ratio - 1.0) / (count - 1)), rel=1e-6)
    assert log[1:] / log[:-1] == pytest.approx(np.full(count - 1, ratio ** (1.0 / (count - 1))), rel=1e-9)


@given(numbers, numbers, st.data())
def test_a_conditional_key_varies_only_where_its_condition_holds(first: list[int], second: list[int], data):
    wanted: Value = data.draw(st.sampled_from(first))
    tables = [levels("a", first), levels("b", second) | {"when": {"key": "a", "value": wanted}}]
    found = points(definition(vary=tables))
    assert all(("b" in point.parameters) == (point.parameters["a"] == wanted) for point in found)
    assert len(found) == len(first) - 1 + len(second) == len({identity(point) for point in found})


def test_a_condition_may_name_the_drive():
    tables = [levels("gain", [1, 2]) | {"when": {"key": "drive", "value": "b"}}]
    found = points(definition(vary=tables, drives=["a", "b"]))
    assert [(p.drive, p.parameters) for p in found] == [("a", {}), ("b", {"gain": 1}), ("b", {"gain": 2})]


def test_draws_that_are_alike_once_conditions_left_keys_out_are_one_run():
    tables = [levels("a", [1, 2]), {"key": "b", "from": 0.0, "to": 1.0, "when": {"key": "a", "value": 1}}]
    found = points(definition(design="random", runs=64, vary=tables))
    assert sum(point.parameters == {"a": 2} for point in found) == 1


def test_more_runs_than_fit_are_refused_before_any_is_made():
    tables = [{"key": key, "from": 0.0, "to": 1.0, "count": 1000} for key in "abc"]
    with pytest.raises(InputRefused, match=f"1,000,000,000 runs: more than {MOST:,}"):
        points(definition(vary=tables))
