import time

import numpy as np
import pytest

from tests.kernel.cosim.models import continuous, sampled
from twin.kernel.cosim.component import Component
from twin.kernel.cosim.simulation import Simulation
from twin.kernel.cosim.system import System


def busy(seconds: float):
    """A law that takes its time."""

    def law(t, h, u):
        until = time.perf_counter() + seconds
        while time.perf_counter() < until:
            pass
        return 0.0

    return law


@pytest.fixture
def parts():
    return [
        sampled("light", lambda t, h, u: 0.0),
        sampled("middle", busy(1e-4)),
        continuous("heavy", busy(1e-3)),
    ]


def test_counted_cycles_rank_components_by_the_time_they_take(parts):
    simulation = Simulation(System(parts, [], 1e-3), 40, timed=True)
    simulation.run()
    light, middle, heavy = simulation.cycles
    # each is ten times and more the one before it, by construction: room for a machine that is busy with others
    assert 0 < light < middle < heavy


def off_the_whole(parts: list[Component]) -> float:
    """By how much the cycles of two spans are off proportion to their times, as a share."""
    simulation = Simulation(System(parts, [], 1e-3), 100, slice_ticks=10, timed=True)
    began = time.perf_counter()
    simulation.advance()
    first = simulation.cycles.sum()
    seconds = time.perf_counter() - began
    began = time.perf_counter()
    while not simulation.is_over:
        simulation.advance()
    rest = (time.perf_counter() - began) / seconds
    return abs((simulation.cycles.sum() - first) / first / rest - 1.0)


def test_the_parts_add_up_to_the_whole(parts):
    # cycles per second are the same in both spans; what is not in any component is under a tenth of a millisecond,
    # unless the machine turns to others just then, which it does not five times in a row
    assert any(off_the_whole(parts) < 0.2 for _ in range(5))


def test_timing_changes_no_bit(parts):
    system = System([continuous("a", lambda t, h, u: t / 3.0)], [], 1e-3)
    plain = Simulation(system, 20).run()
    np.testing.assert_array_equal(Simulation(system, 20, timed=True).run(), plain)


def test_nothing_is_counted_unless_asked(parts):
    simulation = Simulation(System(parts, [], 1e-3), 1)
    simulation.run()
    assert simulation.cycles.size == 0
