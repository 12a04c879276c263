"""Who sees what, when: the schedule of the master on systems small enough to do by hand."""

import numpy as np
import pytest

from tests.kernel.cosim.models import Part, U, clock, continuous, echo, sampled
from twin.kernel.cosim.port import Port
from twin.kernel.cosim.simulation import Simulation
from twin.kernel.cosim.system import Scheme, System

TICK = 0.1
SCHEMES: tuple[Scheme, ...] = ("gauss_seidel", "jacobi")


def columns(parts: list[Part], wires: list[tuple[str, str]], ticks: int, scheme: Scheme = "gauss_seidel"):
    """The rows of each component by name, ticks 0 to `ticks`."""
    system = System(parts, wires, TICK, scheme)
    rows = Simulation(system, ticks).run()
    return {part.name: rows[:, system.columns(f"{part.name}.y")].ravel().tolist() for part in parts}


def times(ticks: int) -> list[float]:
    return [k * TICK for k in range(ticks + 1)]


def test_time_is_a_multiple_of_the_tick_not_a_sum_of_ticks():
    part = continuous("a", clock)
    Simulation(System([part], [], TICK), 1000).run()
    summed = 0.0
    for k, (t, h, _) in enumerate(part.model.calls):
        assert (t, h) == (k * TICK, TICK)
        summed += h
    # the two differ in this very run, so the line above could have failed
    assert summed != 1000 * TICK


def test_the_last_tick_gets_a_row_but_no_step():
    source, follower = continuous("a", clock), sampled("b", echo, U)
    rows = columns([source, follower], [("a.y", "b.u")], 5)
    assert rows["a"] == pytest.approx(times(5))
    assert [t for t, _, _ in source.model.calls] == times(4)
    assert [t for t, _, _ in follower.model.calls] == times(5)


def test_a_run_of_no_ticks_has_one_row_of_initial_outputs():
    part = continuous("a", clock, initial_outputs=[7.0])
    assert columns([part], [], 0) == {"a": [7.0]}
    assert part.model.calls == []


def test_sampled_components_see_the_present_outputs_of_those_before_them():
    chain = [sampled("a", lambda t, h, u: t), sampled("b", echo, U), sampled("c", echo, U)]
    rows = columns(chain, [("a.y", "b.u"), ("b.y", "c.u")], 4)
    assert rows["a"] == rows["b"] == rows["c"] == times(4)


def test_sampled_components_see_the_previous_outputs_of_those_after_them():
    chain = [sampled("b", echo, U), sampled("a", lambda t, h, u: t, initial_outputs=[-1.0])]
    rows = columns(chain, [("a.y", "b.u")], 4)
    assert rows["b"] == [-1.0, *times(3)]


@pytest.mark.parametrize("scheme", SCHEMES)
def test_the_order_in_which_kinds_are_listed_does_not_matter(scheme):
    def parts():
        return [continuous("a", clock), sampled("b", echo, U), continuous("c", echo, U)]

    wires = [("a.y", "b.u"), ("b.y", "c.u")]
    a, b, c = parts()
    assert columns([a, b, c], wires, 5, scheme) == columns([b, *parts()[::2]], wires, 5, scheme)


@pytest.mark.parametrize("scheme", SCHEMES)
def test_sampled_components_see_continuous_ones_at_the_present_tick(scheme):
    rows = columns([continuous("a", clock), sampled("b", echo, U)], [("a.y", "b.u")], 4, scheme)
    assert rows["b"] == rows["a"] == pytest.approx(times(4))


def test_gauss_seidel_hands_new_results_on_within_the_tick_and_jacobi_one_tick_later():
    wires = [("a.y", "b.u")]
    follower = {
        scheme: columns([continuous("a", clock), continuous("b", echo, U)], wires, 4, scheme)["b"] for scheme in SCHEMES
    }
    assert follower["gauss_seidel"] == pytest.approx(times(4))
    assert follower["jacobi"] == pytest.approx([0.0, *times(3)])


def test_gauss_seidel_against_the_order_is_jacobi():
    wires = [("a.y", "b.u")]
    backwards = columns([continuous("b", echo, U), continuous("a", clock)], wires, 4)
    assert backwards == columns([continuous("b", echo, U), continuous("a", clock)], wires, 4, "jacobi")


@pytest.mark.parametrize(("scheme", "around"), [("gauss_seidel", 1), ("jacobi", 3)])
def test_jacobi_takes_a_tick_per_component_around_a_loop_and_gauss_seidel_one(scheme, around):
    loop = [continuous("a", lambda t, h, u: u + 1.0, U), continuous("b", echo, U), continuous("c", echo, U)]
    rows = columns(loop, [("a.y", "b.u"), ("b.y", "c.u"), ("c.y", "a.u")], 12, scheme)
    assert rows["c"] == [float(k // around) for k in range(13)]


def test_a_slow_sampled_component_is_held_between_its_ticks():
    slow = sampled("a", lambda t, h, u: t, period=3)
    rows = columns([slow], [], 7)
    assert rows["a"] == [k // 3 * 3 * TICK for k in range(8)]
    assert [h for _, h, _ in slow.model.calls] == [3 * TICK] * 3


@pytest.mark.parametrize("scheme", SCHEMES)
def test_a_slow_continuous_component_publishes_when_its_step_ends(scheme):
    slow, follower = continuous("a", clock, period=3), sampled("b", echo, U)
    rows = columns([slow, follower], [("a.y", "b.u")], 7, scheme)
    assert rows["a"] == rows["b"] == pytest.approx([k // 3 * 3 * TICK for k in range(8)])
    assert [(t, h) for t, h, _ in slow.model.calls] == [(3 * k * TICK, 3 * TICK) for k in range(3)]


def test_in_gauss_seidel_order_a_faster_component_sees_where_the_slow_one_is_going():
    parts = [continuous("a", clock, period=3), continuous("b", echo, U)]
    seen = columns(parts, [("a.y", "b.u")], 6)["b"]
    assert seen == pytest.approx([0.0, *[3 * TICK] * 3, *[6 * TICK] * 3])


def test_a_wire_can_pick_one_element_and_an_input_can_be_gathered_from_many():
    source = sampled("a", lambda t, h, u: (1.0, 2.0, 3.0), outputs=(Port("x"), Port("y", 2)))
    gathering = (Port("u"), Port("v", 2))
    gathered = sampled("b", echo, gathering, outputs=(Port("y", 3),))
    wires = [("a.y[1]", "b.u"), ("a.x", "b.v[1]"), ("a.y[0]", "b.v[0]")]
    rows = Simulation(System([source, gathered], wires, TICK), 0).run()
    np.testing.assert_array_equal(rows, [[1.0, 2.0, 3.0, 3.0, 2.0, 1.0]])
