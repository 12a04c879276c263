"""The compiled master against the interpreted one, over random co-simulations."""

from typing import cast

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.kernel.cosim.graphs import Shape, components, nodes, shapes, wires
from tests.kernel.cosim.interpreted import interpreted
from twin.kernel.cosim.simulation import Simulation
from twin.kernel.cosim.system import Scheme, System

TICK = 0.1

schemes = st.sampled_from(["gauss_seidel", "jacobi"])


def compiled(graph: list[Shape], scheme: str, last_tick: int, slice_ticks: int) -> np.ndarray:
    """Rows with the columns in the order of `graph`."""
    system = System(components(graph), wires(graph), TICK, cast(Scheme, scheme))
    rows = Simulation(system, last_tick, slice_ticks).run()
    return np.hstack([rows[:, system.columns(f"c{i}.y")] for i in range(len(graph))])


@given(shapes(), schemes, st.integers(0, 25))
def test_every_system_runs_as_the_interpreted_master_says_bit_for_bit(graph, scheme, last_tick):
    expected = np.array([np.concatenate(row) for row in interpreted(nodes(graph), TICK, scheme, last_tick)])
    np.testing.assert_array_equal(compiled(graph, scheme, last_tick, 7), expected)


@given(shapes(), schemes)
def test_how_a_run_is_sliced_changes_no_bit(graph, scheme):
    in_one = compiled(graph, scheme, 25, 100)
    np.testing.assert_array_equal(compiled(graph, scheme, 25, 1), in_one)
    np.testing.assert_array_equal(compiled(graph, scheme, 25, 7), in_one)


@given(shapes())
def test_the_schemes_differ_only_where_a_continuous_component_feeds_a_later_one(graph):
    coupled = any(
        not shape.sampled and not graph[source].sampled and source < position
        for position, shape in enumerate(graph)
        for source, _ in shape.sources
    )
    same = np.array_equal(compiled(graph, "gauss_seidel", 10, 100), compiled(graph, "jacobi", 10, 100))
    assert same or coupled


@pytest.mark.parametrize("slice_ticks", [1, 7, 100])
def test_slices_join_without_gap_or_overlap(slice_ticks):
    graph = [Shape(sampled=True, period=1, outputs=1, sources=())]
    simulation = Simulation(System(components(graph), [], TICK), 20, slice_ticks)
    lengths: list[int] = []
    while not simulation.is_over:
        assert simulation.next_tick == sum(lengths)
        lengths.append(len(simulation.advance()))
    assert sum(lengths) == 21
    assert all(length == slice_ticks for length in lengths[:-1])
    assert simulation.next_tick == 21
