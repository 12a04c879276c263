"""Drives that go back to the start of a step: FMI's get and set of states, by address."""

import ctypes
from pathlib import Path

import numpy as np
import pytest

from tests.drive.compiled import compiled_drive
from tests.laws.runs import EXPERIMENTS, FORCE, shipped
from twin.cosim.port import Port, width
from twin.cosim.python_component import PythonComponent
from twin.cosim.simulation import Simulation
from twin.cosim.system import System
from twin.drive.component import FmuComponent
from twin.errors import ComponentFailed, InputRefused
from twin.experiment.drive_files import lone_drive
from twin.runs.assembly.assemble import assemble
from twin.runs.assembly.drive_component import drive
from twin.runs.assembly.drives import planned
from twin.runs.assembly.load import load_experiment

TICK = 1e-3
SIGNATURE = ctypes.CFUNCTYPE(
    ctypes.c_int32, ctypes.c_void_p, ctypes.c_double, ctypes.c_double, ctypes.c_void_p, ctypes.c_void_p
)


def fmu(root: Path, path: str) -> FmuComponent:
    """The FMU of a drive alone, without a velocity loop of ours around it."""
    table = lone_drive(str(root / path), root).model_copy(update={"velocity_loop": None, "substeps": 1})
    made = drive("drive_1", planned(table), TICK, 0.0, 0.0)
    assert isinstance(made, FmuComponent)
    return made


@pytest.mark.parametrize("path", ["fmus/velocity_servo", "fmus/torque_motor_fmi3", "fmus/python_servo"])
def test_a_step_from_a_restored_state_gives_the_same_bits(root: Path, path: str):
    component = fmu(root, path)
    rewind = component.rewind()
    assert rewind is not None
    u, y = np.zeros(width(component.inputs)), np.empty(width(component.outputs))
    u[0] = 0.3

    def stepped(k: int) -> np.ndarray:
        step = SIGNATURE(component.step_address)
        assert step(component.self_address, k * TICK, TICK, u.ctypes.data, y.ctypes.data) == 0
        return y.copy()

    def called(address: int) -> int:
        return SIGNATURE(address)(rewind.self_address, 0.0, 0.0, 0, 0)

    try:
        before = [stepped(k) for k in range(20)][-1]
        assert called(rewind.save_address) == 0
        first = stepped(20)
        assert called(rewind.restore_address) == 0
        u[0] = 0.9
        other = stepped(20)
        assert called(rewind.restore_address) == 0
        u[0] = 0.3
        again = stepped(20)
    finally:
        component.close()
    assert np.array_equal(first, again)
    assert not np.array_equal(first, before) and not np.array_equal(first, other)


@pytest.mark.parametrize("path", ["fmus/velocity_servo", "fmus/torque_motor_fmi3", "fmus/python_servo"])
def test_a_step_that_is_repeated_with_the_same_inputs_changes_no_bit_of_a_run(root: Path, path: str):
    class Command:
        inputs, outputs, sampled = (), (Port("command"),), True

        def step(self, t: float, h: float, u: np.ndarray, y: np.ndarray) -> None:
            y[0] = 0.3 * np.sin(50.0 * t)

    def rows(iterations: int) -> np.ndarray:
        component = fmu(root, path)
        wires = [("command.command", f"drive_1.{port.name}") for port in component.inputs]
        components = [PythonComponent("command", Command()), component]
        try:
            return Simulation(System(components, wires, TICK, iterations=iterations), 200).run()
        finally:
            component.close()

    once = rows(1)
    assert np.ptp(once[:, 1]) > 1e-4
    assert np.array_equal(rows(3), once)


def test_a_state_is_freed_once_and_before_its_instance(root: Path, monkeypatch: pytest.MonkeyPatch):
    component = fmu(root, "fmus/velocity_servo")
    freed: list[int] = []
    free = component.instance.forget

    def forget(state: int) -> None:
        assert component.instance.handle
        freed.append(state)
        free(state)

    monkeypatch.setattr(component.instance, "forget", forget)
    rewind = component.rewind()
    assert rewind is not None
    for _ in range(3):
        assert SIGNATURE(rewind.save_address)(rewind.self_address, 0.0, 0.0, 0, 0) == 0
    component.close()
    component.close()
    assert len(freed) == 1 and freed[0]


@pytest.mark.parametrize("function", ["fmi2GetFMUstate", "fmi2SetFMUstate"])
def test_a_state_that_is_refused_is_told_with_drive_function_and_time(root: Path, tmp_path: Path, function: str):
    def broken(source: str) -> str:
        head = source.index(f"fmi2Status {function}(")
        body = source.index("{", head) + 1
        return f"{source[:body]}\n    return fmi2Error;{source[body:]}"

    component = fmu(root, str(compiled_drive(root, tmp_path, "forgetful", {"fmu_state.c": broken})))
    wires = [("drive_1.theta_m", "drive_1.omega_ref"), ("drive_1.theta_m", "drive_1.tau_load")]
    try:
        with pytest.raises(ComponentFailed) as failed:
            Simulation(System([component], wires, TICK, iterations=2), 10).run()
    finally:
        component.close()
    assert f"forgetful.fmu (drive_1) {function} returned fmi2Error" in str(failed.value)
    assert "tick 0" in str(failed.value)


@pytest.mark.parametrize(
    ("name", "label"),
    [
        pytest.param("modelica_dc", "modelica_dc.fmu", id="has no states to get"),
        pytest.param("brushed_dc", "brushed_dc.fmu", id="has a velocity loop of ours"),
    ],
)
def test_a_drive_that_cannot_repeat_a_step_is_refused_by_name(root: Path, name: str, label: str):
    fig4 = EXPERIMENTS / f"{FORCE}.toml"
    experiment = load_experiment(fig4, ["cosim.iterations=2"], drive=str(root / "fmus" / name))
    with pytest.raises(InputRefused) as refused:
        assemble(experiment).close()
    told = f"{label}: cannot go back to the start of a step, which iterations = 2 needs; use iterations = 1"
    assert str(refused.value) == told


def test_by_default_the_loop_neither_weighs_nor_saves_anything():
    with assemble(shipped()) as assembly:
        system = assembly.system
        y = system.outputs()
        table = system.table(np.zeros(system.inputs_width), y)
        assert len(y) == system.outputs_width
        assert not any(table[name].any() for name in ("weights", "before", "save", "restore", "rewind"))
