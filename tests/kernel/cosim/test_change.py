"""Numbers that are others from a tick on."""

import numpy as np
import pytest

from tests.kernel.cosim.models import continuous, sampled
from tests.kernel.cosim.test_interpolation import mass, spring
from twin.kernel.cosim.simulation import Simulation
from twin.kernel.cosim.system import MemoryChange, System

LAST = 20


def changing(*changes: tuple[int, float]) -> System:
    """A component that shows a number in memory, and one that integrates it."""
    number = np.array([1.0])
    show = sampled("show", lambda t, h, u: number)
    total = np.zeros(1)

    def add(t: float, h: float, u: np.ndarray) -> np.ndarray:
        total[0] += number[0]
        return total

    system = System([show, continuous("total", add)], [], 0.1)
    system.changes = tuple(MemoryChange(tick, number, value) for tick, value in changes)
    return system


@pytest.mark.parametrize("slice_ticks", [1, 3, 7, 100])
def test_a_change_acts_from_its_tick_on_however_the_run_is_sliced(slice_ticks: int):
    rows = Simulation(changing((5, 2.0), (6, 3.0), (14, -1.0)), LAST, slice_ticks).run()
    assert rows[:, 0].tolist() == [1.0] * 5 + [2.0] + [3.0] * 8 + [-1.0] * 7
    # the step from tick k to k + 1 is made with the number of tick k
    assert np.array_equal(np.diff(rows[:, 1]), rows[:-1, 0])


def test_a_slice_is_as_long_with_changes_as_without():
    simulation = Simulation(changing((5, 2.0)), LAST, 10)
    assert [len(simulation.advance()), len(simulation.advance())] == [10, 10]


def test_changes_of_the_first_and_after_the_last_tick_harm_nothing():
    rows = Simulation(changing((0, 4.0), (LAST + 1, 9.0)), LAST).run()
    assert rows[:, 0].tolist() == [4.0] * (LAST + 1)


@pytest.mark.parametrize("coupling", [{"inputs": "linear"}, {"inputs": "linear", "iterations": 3}])
def test_a_change_between_interpolated_and_repeated_steps_is_the_same_however_the_run_is_sliced(coupling: dict):
    def rows(slice_ticks: int) -> np.ndarray:
        first = mass()
        wires = [("mass.v", "spring.v"), ("spring.force", "mass.force")]
        system = System([first, spring()], wires, 0.01, **coupling)
        # a kick: it is written into what a repeated step restores
        system.changes = (MemoryChange(7, first.memory["v"], 2.0),)
        return Simulation(system, LAST, slice_ticks).run()

    whole = rows(100)
    for slice_ticks in (1, 3, 7):
        assert np.array_equal(rows(slice_ticks), whole)
    s = 0.02 * np.arange(LAST - 6)
    # from then on as if let go there at speed 2, but for the one step in which the spring sees the mean of the speeds
    # before and after: 0.011 m less of it pull with 0.046 m/s2, 0.4 mm until the end
    np.testing.assert_allclose(whole[7:, 0], np.cos(0.14) * np.cos(s) + np.sin(s), atol=5e-4)
