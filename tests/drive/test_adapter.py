"""Values of every FMI type, by address."""

import ctypes
from pathlib import Path

import numpy as np
import pytest

from twin.cosim.port import Port
from twin.cosim.python_component import PythonComponent
from twin.cosim.simulation import Simulation
from twin.cosim.system import System
from twin.drive.calls import DO_STEP, TERMINATE
from twin.drive.component import FmuComponent, FmuPort
from twin.drive.cosim_step import MEMORY, step
from twin.drive.description import described
from twin.drive.groups import _load, _store
from twin.drive.unpacked import unpacked
from twin.drive.variable import ITEM_SIZES, KINDS

STEP = ctypes.CFUNCTYPE(
    ctypes.c_int32, ctypes.c_void_p, ctypes.c_double, ctypes.c_double, ctypes.c_void_p, ctypes.c_void_p
)
DO_STEP_3 = ctypes.CFUNCTYPE(
    ctypes.c_int32, ctypes.c_void_p, ctypes.c_double, ctypes.c_double, ctypes.c_uint8, *[ctypes.c_void_p] * 4
)
"""fmi3DoStep (FMI 3.0, section 4.2.1.2)."""
DTYPES = {"Float64": np.float64, "Float32": np.float32, "Boolean": np.uint8} | {
    name: np.dtype(name.lower()).type for name in KINDS if name.startswith(("Int", "UInt"))
}


@pytest.mark.parametrize("kind", range(len(KINDS)))
def test_every_type_keeps_its_values_in_its_own_layout(kind: int):
    name = KINDS[kind]
    buffer = np.zeros(3, dtype=DTYPES[name])
    assert buffer.itemsize == ITEM_SIZES[kind]
    low, high = (0.0, 1.0) if name == "Boolean" or name.startswith("U") else (-7.0, 7.0)
    _store(kind, buffer.ctypes.data, 0, low)
    _store(kind, buffer.ctypes.data, 2, high)
    assert buffer.tolist() == [low, 0, high]
    assert [_load(kind, buffer.ctypes.data, j) for j in range(3)] == [low, 0.0, high]


def test_whole_numbers_are_rounded_to_the_nearest():
    buffer = np.zeros(2, dtype=np.int32)
    for j, value in enumerate((2.6, -2.6)):
        _store(KINDS.index("Int32"), buffer.ctypes.data, j, value)
    assert buffer.tolist() == [3, -3]


@pytest.mark.parametrize(
    ("returned", "terminates", "status"),
    [(0, 0, 0), (0, 1, TERMINATE), (1, 0, 0), (1, 1, TERMINATE), (2, 1, DO_STEP + 2), (3, 0, DO_STEP + 3)],
)
def test_a_step_that_asks_for_termination_is_told_from_one_that_fails(returned: int, terminates: int, status: int):
    @DO_STEP_3
    def do_step(instance, t, h, final, event, terminate, early, last):
        ctypes.cast(terminate, ctypes.POINTER(ctypes.c_uint8))[0] = terminates
        return returned

    flags, memory = np.zeros(16, dtype=np.uint8), np.zeros(1, dtype=MEMORY)
    memory["version"], memory["returned"] = 3, flags.ctypes.data
    memory["do_step"] = ctypes.cast(do_step, ctypes.c_void_p).value
    u = np.zeros(1)
    assert STEP(step.address)(memory.ctypes.data, 0.0, 1e-3, u.ctypes.data, u.ctypes.data) == status


class Operator:
    """Commands a torque, and takes the enable away after 50 ms."""

    inputs = ()
    outputs = (Port("tau_cmd"), Port("tau_load"), Port("enable"))
    sampled = True

    def step(self, t: float, h: float, u: np.ndarray, y: np.ndarray) -> None:
        y[:] = 0.1, 0.0, float(t < 0.0495)


def test_boolean_integer_and_single_precision_pass_by_address(root: Path):
    motor = described(root / "fmus/torque_motor_fmi3/torque_motor_fmi3.fmu")

    def port(name: str) -> FmuPort:
        return FmuPort(Port(name), motor.variables[name])

    component = FmuComponent(
        "motor",
        motor,
        unpacked(motor.path, motor.sha256),
        [port(name) for name in ("tau_cmd", "tau_load", "enable")],
        [port(name) for name in ("omega_m", "current", "status", "temperature")],
    )
    assert {motor.variables[name].type for name in ("enable", "status", "temperature")} == {
        "Boolean",
        "Int32",
        "Float32",
    }
    wires = [(f"operator.{name}", f"motor.{name}") for name in ("tau_cmd", "tau_load", "enable")]
    system = System([PythonComponent("operator", Operator()), component], wires, 1e-3)
    rows = Simulation(system, 100).run()
    component.close()
    current, status = (rows[:, system.columns(f"motor.{name}")][:, 0] for name in ("current", "status"))
    # k_t = 0.25 N m/A; the current loop is 0.3 ms fast
    assert current[49] == pytest.approx(0.4, rel=0.05)
    assert abs(current[-1]) < 1e-6
    # 0: all is well, 3: disabled
    assert (status[49], status[-1]) == (0.0, 3.0)
    assert rows[0, system.columns("motor.temperature")][0] == 25.0
