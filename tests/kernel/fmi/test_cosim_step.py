"""Steps of FMUs without events: variables of all types, discarded steps, and steps that are made again."""

import ctypes
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.kernel.fmi.compiled import compiled_drive
from tests.kernel.fmi.odd import odd_fmu
from tests.kernel.fmi.test_component import TICK, made, run
from tests.kernel.fmi.test_event_step import stepped
from tests.laws.runs import EXPERIMENTS, FORCE, shipped
from twin.kernel.cosim.delay import play
from twin.kernel.cosim.port import Port, width
from twin.kernel.cosim.python_class import PythonComponent
from twin.kernel.cosim.simulation import Simulation
from twin.kernel.cosim.system import System
from twin.kernel.errors import ComponentFailed, InputRefused
from twin.kernel.fmi.component import FmuComponent
from twin.kernel.fmi.cosim_step import STEP_MEMORY, step
from twin.kernel.fmi.description import described
from twin.kernel.fmi.groups import DO_STEP_FAILED, TERMINATE_REQUEST, _load, _store
from twin.kernel.fmi.stepping import FmuPort, Stepping
from twin.kernel.fmi.unpacked import unpacked
from twin.kernel.fmi.variable import ITEM_SIZES, NUMERIC_TYPES
from twin.robot.assembly.assemble import assemble
from twin.robot.assembly.drives import drive, plan_drive
from twin.robot.assembly.load import load_experiment
from twin.robot.experiment.drive_files import load_drive

STEP = ctypes.CFUNCTYPE(
    ctypes.c_int32, ctypes.c_void_p, ctypes.c_double, ctypes.c_double, ctypes.c_void_p, ctypes.c_void_p
)
DO_STEP_3 = ctypes.CFUNCTYPE(
    ctypes.c_int32, ctypes.c_void_p, ctypes.c_double, ctypes.c_double, ctypes.c_uint8, *[ctypes.c_void_p] * 4
)
"""fmi3DoStep (FMI 3.0, section 4.2.1.2)."""
DTYPES = {"Float64": np.float64, "Float32": np.float32, "Boolean": np.uint8} | {
    name: np.dtype(name.lower()).type for name in NUMERIC_TYPES if name.startswith(("Int", "UInt"))
}


@pytest.mark.parametrize("kind", range(len(NUMERIC_TYPES)))
def test_every_type_keeps_its_values_in_its_own_layout(kind: int):
    name = NUMERIC_TYPES[kind]
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
        _store(NUMERIC_TYPES.index("Int32"), buffer.ctypes.data, j, value)
    assert buffer.tolist() == [3, -3]


@pytest.mark.parametrize(
    ("returned", "terminates", "status"),
    [
        (0, 0, 0),
        (0, 1, TERMINATE_REQUEST),
        (1, 0, 0),
        (1, 1, TERMINATE_REQUEST),
        (2, 1, DO_STEP_FAILED + 2),
        (3, 0, DO_STEP_FAILED + 3),
    ],
)
def test_a_step_that_asks_for_termination_is_told_from_one_that_fails(returned: int, terminates: int, status: int):
    @DO_STEP_3
    def do_step(instance, t, h, final, event, terminate, early, last):
        ctypes.cast(terminate, ctypes.POINTER(ctypes.c_uint8))[0] = terminates
        return returned

    flags, memory = np.zeros(16, dtype=np.uint8), np.zeros(1, dtype=STEP_MEMORY)
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


def test_an_enumeration_that_nothing_starts_keeps_its_start_and_outputs_of_several_need_one_call(tmp_path: Path):
    motor = described(odd_fmu(tmp_path / "items.fmu", types=["Enumeration"]))
    into, out = (motor.variables[f"{side}_Enumeration"] for side in ("in", "out"))
    other = replace(out, items={"one": 1.0})
    # 0, which other inputs get without a value, is no item
    assert 0.0 not in into.items.values()
    component = FmuComponent(
        "part",
        motor,
        unpacked(motor.path, motor.sha256),
        [FmuPort(Port("mode"), into)],
        [FmuPort(Port("a"), out), FmuPort(Port("b"), other)],
    )
    try:
        stepping = component._stepping
        assert len(stepping._group_table(stepping.outputs, "Get")) == 1
    finally:
        component.close()


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


TRICKS = {"honest": 1, "none": 2, "nan": 3, "beyond": 4, "silent": 5, "ends": 6, "coarse": 7}
"""What the parameter `droop` of the drive below stands for."""


def discards(text: str) -> str:
    """lifecycle.c that discards steps of more than 0.3 ms, having made 0.3 ms of them, and tells of it as `droop` says.

    1: as it is. 2: it has made nothing. 3: NaN. 4: later than was asked. 5: it does not say. 6: it wants to end.
    7: it has made nothing, and makes 0.3 ms and less. All but 1 and 7 from t = 0.01 s on.
    """
    step = "fmi2Status fmi2DoStep("
    text = text.replace(step, "static fmi2Status honest_step(").replace(
        "fmi2Status fmi2GetRealStatus(", "fmi2Status real("
    )
    text = text.replace("fmi2Status fmi2GetBooleanStatus(", "static fmi2Status boolean(")
    return (
        text
        + """
fmi2Status fmi2DoStep(fmi2Component c, fmi2Real t, fmi2Real h, fmi2Boolean b)
{
    Slave *slave = c;
    const int trick = (int)slave->state.v.droop;
    if (fabs(t - slave->state.time) > 1e-12)
        return refuse(slave, "not where the last step ended");
    if (h < 0.3e-3 * (1.0 + 1e-9) || (trick != 1 && trick != 7 && t < 0.0095))
        return trick == 2 && t > 0.0095 ? fmi2Discard : honest_step(c, t, h, b);
    if (trick != 2 && trick != 7 && honest_step(c, t, 0.3e-3, b) != fmi2OK)
        return fmi2Error;
    return fmi2Discard;
}

fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Real *value)
{
    const Slave *slave = c;
    const int trick = (int)slave->state.v.droop;
    *value = trick == 3 ? NAN : slave->state.time + (trick == 4 ? 1.0 : 0.0);
    return kind == fmi2LastSuccessfulTime && trick != 5 ? fmi2OK : fmi2Discard;
}

fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *value)
{
    *value = kind == fmi2Terminated && (int)((Slave *)c)->state.v.droop == 6;
    return fmi2OK;
}
"""
    )


@pytest.fixture(scope="module")
def servo(root: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return compiled_drive(root, tmp_path_factory.mktemp("shorter"), "shorter", {"lifecycle.c": discards})


@pytest.mark.parametrize("trick", ["honest", "coarse"])
@pytest.mark.parametrize("plain", [True, False])
def test_a_discarded_step_comes_to_the_same_as_a_whole_one(
    root: Path, servo: Path, monkeypatch: pytest.MonkeyPatch, trick: str, plain: bool
):
    monkeypatch.setattr(Stepping, "_is_plain", lambda *arguments: plain)
    told = {"droop": TRICKS[trick]}
    component = made(servo, parameters=told)
    whole = made(root / "fmus" / "velocity_servo" / "velocity_servo.fmu", parameters=told)
    parts, one = (stepped(c, lambda t: 1.0 + 100.0 * t, 100) for c in (component, whole))
    # rounding of four steps of an exactly solved drive instead of one
    assert np.allclose(parts["theta_m"], one["theta_m"], rtol=0, atol=1e-14)
    ((_, said),) = component.take_messages()
    assert said == "it discards steps, which are then made in parts, since t = 0 s"


@pytest.mark.parametrize(
    ("trick", "said"),
    [
        ("none", "fmi2DoStep returned fmi2Discard and stays at t = 0.01 s, however short its steps"),
        ("nan", "fmi2DoStep reports that it stepped until t = nan s, which lies outside of this step"),
        ("beyond", "fmi2DoStep reports that it stepped until t = 1.0103 s, which lies outside of this step"),
        ("silent", "fmi2DoStep returned fmi2Discard; it may do with shorter steps: raise [drive] substeps"),
        ("ends", "fmi2DoStep asked to terminate the simulation"),
    ],
)
def test_a_discarded_step_that_leads_nowhere_ends_the_run_with_a_sentence(servo: Path, trick: str, said: str):
    with pytest.raises(ComponentFailed) as failure:
        run(made(servo, parameters={"droop": TRICKS[trick]}), 1.0, 0.0, 100)
    assert said in str(failure.value)
    assert "in the step from t = 0.01 s, tick 10." in str(failure.value)


def test_a_tick_that_fits_is_not_discarded(servo: Path):
    component = made(servo, parameters={"droop": TRICKS["honest"]}, substeps=4)
    assert stepped(component, lambda t: 1.0, 10)["theta_m"][-1] > 0.0
    assert component.take_messages() == []
    assert TICK / 4 < 0.3e-3


SIGNATURE = ctypes.CFUNCTYPE(
    ctypes.c_int32, ctypes.c_void_p, ctypes.c_double, ctypes.c_double, ctypes.c_void_p, ctypes.c_void_p
)


def fmu(root: Path, path: str) -> FmuComponent:
    """The FMU of a drive alone, without a velocity loop of ours around it."""
    table = load_drive(str(root / path), root).model_copy(update={"velocity_loop": None, "substeps": 1})
    made = drive("drive_1", plan_drive(table), TICK, 0.0, 0.0)
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
    free = component.instance.free_state

    def forget(state: int) -> None:
        assert component.instance.handle
        freed.append(state)
        free(state)

    monkeypatch.setattr(component.instance, "free_state", forget)
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


def test_every_output_goes_on_from_the_value_that_it_is_taken_to_have_at_the_start(root: Path):
    # Real, unscaled: what goes by the short way if no more than one of them is shifted
    servo = described(root / "fmus/velocity_servo/velocity_servo.fmu")
    inputs, outputs = (
        [FmuPort(Port(name), servo.variables[name]) for name in names]
        for names in (("omega_ref", "tau_load"), ("theta_m", "omega_m"))
    )
    folder, start = unpacked(servo.path, servo.sha256), {"theta_m": 0.2, "omega_m": 0.3}
    component = FmuComponent("servo", servo, folder, inputs, outputs, outputs_at_start=start)
    rows, status = play(component, 1e-3 * np.arange(3.0), np.full(3, 1e-3), np.zeros((3, 2)))
    component.close()
    assert status == 0
    # it stands still
    assert rows.tolist() == [[0.2, 0.3]] * 3
