import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.kernel.cosim.models import sampled
from twin.kernel.cosim.component import NativeComponent
from twin.kernel.cosim.delay import DELAY_MEMORY, delay, fill_ring, play, values_by_port
from twin.kernel.cosim.port import Port
from twin.kernel.cosim.simulation import Simulation
from twin.kernel.cosim.system import System
from twin.robot.mechanism.statics import G_ACCELERATION
from twin.robot.plant.encoder import Scale

X = Port("x", 2)
INITIAL = np.array([8.0, 9.0])


@given(st.integers(1, 9), st.integers(0, 25))
def test_a_delay_gives_back_what_it_was_given_so_many_ticks_ago(ticks, last_tick):
    source = sampled("source", lambda t, h, u: (t, -t), outputs=(X,))
    late = delay("late", (X,), ticks, INITIAL)
    system = System([source, late], [("source.x", "late.x")], 1.0)
    rows = Simulation(system, last_tick).run()[:, system.columns("late.x")].tolist()
    assert rows == [[k - ticks, ticks - k] if k >= ticks else [8.0, 9.0] for k in range(last_tick + 1)]


def test_the_initial_output_is_valid_before_the_first_tick():
    assert delay("late", (X,), 3, INITIAL).initial("x").tolist() == [8.0, 9.0]


@pytest.mark.parametrize("ticks", [1, 4])
def test_two_delays_keep_memories_of_their_own(ticks):
    source = sampled("source", lambda t, h, u: (t, t), outputs=(X,))
    parts = [source, delay("a", (X,), ticks, np.zeros(2)), delay("b", (X,), ticks, np.zeros(2))]
    system = System(parts, [("source.x", "a.x"), ("a.x", "b.x")], 1.0)
    rows = Simulation(system, 20).run()[:, system.columns("b.x")][:, 0].tolist()
    assert rows == [max(0, k - 2 * ticks) for k in range(21)]


def test_what_is_taken_elsewhere_begins_with_what_it_is_given():
    late = delay("late", (X,), 2, INITIAL)
    assert isinstance(late, NativeComponent) and late.memory.dtype == DELAY_MEMORY
    begun = NativeComponent("late", (X,), (X,), True, fill_ring, late.memory, np.zeros(2), pointers=late.pointers)
    told = sampled("told", lambda t, h, u: (5.0, 6.0), outputs=(X,))
    assert Simulation(System([told, begun], [("told.x", "late.x")], 1.0), 0).run()[0, 2:].tolist() == [5.0, 6.0]
    assert late.pointers["ring"].tolist() == [[5.0, 6.0], [5.0, 6.0]]


def test_a_component_played_over_inputs_gives_what_it_would_give_in_a_run():
    force = -np.linspace(-1.0, 6.0, 50)
    u = np.zeros((50, 3))
    u[:, 2] = force
    scale = Scale(0.005 * G_ACCELERATION)
    rows, status = play(scale, np.arange(50.0), np.ones(50), u)
    steps = np.floor(-force / (0.005 * G_ACCELERATION) + 0.5)
    assert status == 0
    np.testing.assert_array_equal(values_by_port(scale.outputs, rows)["F_z"], steps * (0.005 * G_ACCELERATION))


def test_rows_are_taken_after_as_many_steps_as_asked_for():
    u = np.zeros((6, 3))
    u[:, 2] = -np.arange(6.0)
    rows, _ = play(Scale(1.0), np.arange(6.0), np.ones(6), u, np.array([1, 3, 2]))
    np.testing.assert_array_equal(rows[:, 0], [0.0, 3.0, 5.0])
