"""Steps of a model-exchange FMU that are repeated: its own state and the solver's go back together."""

import ctypes

import numpy as np
import pytest

from tests.drive.exchange.conftest import Planner
from twin.cosim.component import Component
from twin.cosim.port import Port
from twin.cosim.python_component import PythonComponent
from twin.cosim.simulation import Simulation
from twin.cosim.system import System
from twin.runs.assembly.drive_component import drive

TICK = 1e-3
SIGNATURE = ctypes.CFUNCTYPE(
    ctypes.c_int32, ctypes.c_void_p, ctypes.c_double, ctypes.c_double, ctypes.c_void_p, ctypes.c_void_p
)
EVENTFUL = {"i_max": 0.3, "switch_every": 0.0123}


@pytest.mark.parametrize("solver", ["cvode", "rk4"])
@pytest.mark.parametrize("fmi", [2, 3])
def test_a_step_from_a_restored_state_gives_the_same_bits(motor: Planner, fmi: int, solver: str):
    component = drive("drive_1", motor(fmi, solver=solver, **EVENTFUL), TICK, 0.0, 0.0)
    rewind = component.rewind()
    assert rewind is not None
    u, y = np.array([3.0, 0.0]), np.empty(3)

    def stepped(k: int) -> np.ndarray:
        step = SIGNATURE(component.step_address)
        assert step(component.self_address, k * TICK, TICK, u.ctypes.data, y.ctypes.data) == 0
        return y.copy()

    def called(address: int) -> None:
        assert SIGNATURE(address)(rewind.self_address, 0.0, 0.0, 0, 0) == 0

    try:
        for k in range(12):
            before = stepped(k)
        # the supply falls in the step from 12 ms on
        called(rewind.save_address)
        first = stepped(12)
        called(rewind.restore_address)
        u[0] = -3.0
        other = stepped(12)
        called(rewind.restore_address)
        u[0] = 3.0
        again = stepped(12)
    finally:
        component.close()
    assert np.array_equal(first, again)
    assert not np.array_equal(first, before) and not np.array_equal(first, other)


@pytest.mark.parametrize("solver", ["cvode", "rk4"])
def test_a_step_that_is_repeated_with_the_same_inputs_changes_no_bit_of_a_run(motor: Planner, solver: str):
    class Command:
        inputs, outputs, sampled = (), (Port("omega_ref"), Port("tau_load")), True

        def step(self, t: float, h: float, u: np.ndarray, y: np.ndarray) -> None:
            y[:] = 3.0 * np.sin(40.0 * t), 0.0

    def rows(iterations: int) -> np.ndarray:
        component = drive("drive_1", motor(solver=solver, **EVENTFUL), TICK, 0.0, 0.0)
        components: list[Component] = [PythonComponent("command", Command()), component]
        wires = [(f"command.{port.name}", f"drive_1.{port.name}") for port in component.inputs]
        try:
            return Simulation(System(components, wires, TICK, iterations=iterations), 60).run()
        finally:
            component.close()

    # every input jumps, so that the solver begins anew in each tick in any case
    assert np.array_equal(rows(1), rows(3))
