"""The design of Saltelli et al. (2010): blocks of A, B and A with one parameter of B."""

import numpy as np
import pytest

from tests.studies.sweep.definitions import definition
from twin.studies.sweep.definition import why_not_saltelli
from twin.studies.sweep.design import largest_count, points, saltelli_cube
from twin.studies.sweep.vary import Condition, Vary

TWO = [{"key": "a", "from": 0.0, "to": 1.0}, {"key": "b", "from": 1.0, "to": 2.0}]


def test_each_run_of_a_block_has_one_parameter_of_the_second_point_and_the_rest_of_the_first():
    blocks = saltelli_cube(8, 3, np.random.default_rng(0)).reshape(8, 5, 3)
    A, B = blocks[:, 0], blocks[:, 1]
    for i in range(3):
        expected = A.copy()
        expected[:, i] = B[:, i]
        assert np.array_equal(blocks[:, 2 + i], expected)
    assert not np.any(A == B)


def test_both_halves_fill_every_eighth_of_every_parameter_once():
    blocks = saltelli_cube(8, 3, np.random.default_rng(5)).reshape(8, 5, 3)
    for half in (blocks[:, 0], blocks[:, 1]):
        assert np.array_equal(np.sort((8 * half).astype(int), axis=0), np.tile(np.arange(8)[:, None], 3))


def test_runs_are_blocks_and_each_drive_runs_all_of_them():
    sweep = definition(design="saltelli", runs=4, vary=TWO, drives=["one", "other"])
    assert largest_count(sweep) == len(points(sweep)) == 2 * 4 * (2 + 2)
    one, other = points(sweep)[:16], points(sweep)[16:]
    assert [point.parameters for point in one] == [point.parameters for point in other]


def test_the_same_seed_makes_the_same_design_and_another_seed_another():
    runs = [points(definition(design="saltelli", runs=4, vary=TWO, seed=seed)) for seed in (1, 1, 2)]
    assert runs[0] == runs[1] != runs[2]


@pytest.mark.parametrize("key", ["values", "when"])
def test_what_makes_parameters_dependent_or_alike_is_named(key: str):
    table = Vary.model_validate({"key": "a", "from": 0.0, "to": 1.0})
    given = {"values": [1.0, 2.0], "when": Condition(key="b", value=1)}[key]
    (sentence,) = why_not_saltelli([table.model_copy(update={key: given})])
    assert sentence.startswith(f"[[vary]] 1: {key} does not go with")
