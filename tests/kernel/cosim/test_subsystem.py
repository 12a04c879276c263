"""A system inside a component."""

import numpy as np
import pytest

from twin.kernel.cosim.port import Port
from twin.kernel.cosim.python_class import PythonComponent
from twin.kernel.cosim.simulation import Simulation
from twin.kernel.cosim.subsystem import INLET_NAME, Subsystem
from twin.kernel.cosim.system import System
from twin.kernel.errors import ComponentFailed, InputRefused

TICK = 1e-3


class Ramp:
    """Its output is the time."""

    inputs = ()
    outputs = (Port("t", 1, "s"),)
    sampled = True

    def step(self, t: float, h: float, u: np.ndarray, y: np.ndarray) -> None:
        y[0] = t


class Lag:
    """Explicit Euler of dx/dt = u - x."""

    inputs = (Port("u"),)
    outputs = (Port("x"),)
    sampled = False

    def __init__(self) -> None:
        self.x = 0.0
        self.times: list[float] = []

    def step(self, t: float, h: float, u: np.ndarray, y: np.ndarray) -> None:
        self.times.append(t)
        self.x += h * (u[0] - self.x)
        y[0] = self.x


class Twice:
    """A sampled gain of two."""

    inputs = (Port("u"),)
    outputs = (Port("y"),)
    sampled = True

    def step(self, t: float, h: float, u: np.ndarray, y: np.ndarray) -> None:
        y[0] = 2.0 * u[0]


class Breaks(Lag):
    """A lag that fails at 5.25 ms."""

    def step(self, t: float, h: float, u: np.ndarray, y: np.ndarray) -> None:
        if t > 0.00524:
            raise ValueError("snap")
        super().step(t, h, u, y)


def nested(model: Lag, substeps: int) -> Subsystem:
    parts = [PythonComponent("twice", Twice(), period=2), PythonComponent("lag", model)]
    wires = [(f"{INLET_NAME}.u", "twice.u"), ("twice.y", "lag.u")]
    outputs = [(Port("x"), "lag.x"), (Port("doubled"), "twice.y")]
    return Subsystem("inner", (Port("u"),), outputs, parts, wires, TICK / substeps, substeps, label="a drive of parts")


def simulated(model: Lag, substeps: int, ticks: int) -> tuple[System, np.ndarray]:
    system = System([PythonComponent("ramp", Ramp()), nested(model, substeps)], [("ramp.t", "inner.u")], TICK)
    return system, Simulation(system, ticks).run()


@pytest.mark.parametrize("substeps", [1, 4])
def test_a_subsystem_is_its_parts_stepped_finer_with_inputs_held(substeps: int):
    system, rows = simulated(Lag(), substeps, 20)
    x, doubled, expected, held = 0.0, 0.0, [0.0], [0.0]
    for k in range(20 * substeps):
        u = (k // substeps) * TICK
        if k % 2 == 0:
            doubled = 2.0 * u
        x += TICK / substeps * (doubled - x)
        if (k + 1) % substeps == 0:
            expected.append(x)
            held.append(doubled)
    assert np.array_equal(rows[:, system.columns("inner.x")][:, 0], expected)
    assert np.array_equal(rows[:, system.columns("inner.doubled")][:, 0], held)


def test_inner_time_is_an_integer_tick_too():
    model = Lag()
    simulated(model, 7, 50)
    assert model.times == [k * (TICK / 7) for k in range(350)]


def test_a_failure_inside_names_the_part_its_time_and_the_drive():
    with pytest.raises(ComponentFailed) as failure:
        simulated(Breaks(), 4, 20)
    said = str(failure.value)
    assert said.startswith("a drive of parts (inner) failed inside: Breaks (lag) raised ValueError: snap")
    assert "in the step from t = 0.00525 s, tick 21" in said
    assert "in the step from t = 0.005 s, tick 5" in said


def test_no_substeps_are_refused():
    with pytest.raises(InputRefused, match="expected at least 1"):
        Subsystem("x", (Port("u"),), [], [], [], TICK, 0)
