"""Signals over time as outputs of a component."""

import numpy as np

from twin.kernel.cosim.expression import parse_expression
from twin.kernel.cosim.port import Port
from twin.kernel.cosim.simulation import Simulation
from twin.kernel.cosim.source import SampledSignal, Signal, source
from twin.kernel.cosim.system import System


def test_samples_are_joined_by_lines_or_held_and_jump_where_a_time_comes_twice():
    t, values = np.array([0.1, 0.2, 0.2, 0.3]), np.array([0.0, 1.0, 5.0, 6.0])
    signals: list[Signal] = [
        parse_expression("t**2", "x"),
        SampledSignal(t, values, "lines"),
        SampledSignal(t, values, "held"),
    ]
    part = source("signals", [Port(name) for name in "abc"], signals)
    rows = Simulation(System([part], [], 0.05), 8).run()
    times = 0.05 * np.arange(9)
    np.testing.assert_allclose(rows[:, 0], times**2, rtol=1e-15)
    # before the first and after the last sample these hold
    np.testing.assert_allclose(rows[:, 1], [0, 0, 0, 0.5, 5, 5.5, 6, 6, 6], atol=1e-12)
    np.testing.assert_array_equal(rows[:, 2], [0, 0, 0, 0, 5, 5, 6, 6, 6])


def test_a_signal_is_the_same_in_a_run_and_by_itself():
    one = SampledSignal(np.array([0.0, 0.37, 1.0]), np.array([-1.0, 1.0 / 3.0, 7.0]), "lines")
    rows = Simulation(System([source("s", [Port("a")], [one])], [], 0.1), 10).run()
    assert rows[:, 0].tolist() == [one.value_at(0.1 * k) for k in range(11)]
