"""Model exchange: how it is chosen, FMUs that play tricks, and steps that are made again."""

import ctypes
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.kernel.fmi.exchange.conftest import Planner
from tests.kernel.fmi.exchange.fmus import FAULTS, exchange_fmu
from twin.kernel.cosim.component import Component
from twin.kernel.cosim.port import Port
from twin.kernel.cosim.python_class import PythonComponent
from twin.kernel.cosim.simulation import Simulation
from twin.kernel.cosim.system import System
from twin.kernel.errors import ComponentFailed, InputRefused
from twin.kernel.fmi.component import FmuComponent
from twin.kernel.fmi.solvers import Solver
from twin.kernel.recording.reader import read
from twin.robot.assembly.drives import drive, plan_drive
from twin.robot.assembly.load import load_experiment
from twin.robot.experiment.drive_files import load_drive
from twin.robot.experiment.recorded import recorded_fmus
from twin.robot.experiment.schema import Drive
from twin.robot.run.run import execute
from twin.studies.qualify.bench import response
from twin.studies.qualify.qualification import qualify_drive


def modelica(root: Path, **keys: Any) -> Drive:
    """The drive that comes as both kinds."""
    return load_drive(str(root / "fmus/modelica_dc"), root).model_copy(update=keys)


def test_an_fmu_of_both_kinds_is_for_co_simulation_unless_the_experiment_says_otherwise(root: Path):
    usual, other = plan_drive(modelica(root)), plan_drive(modelica(root, kind="model_exchange"))
    assert usual.parts[""].kind == "co_simulation" and usual.solver("") is None and usual.tolerance("") is None
    assert other.parts[""].kind == "model_exchange" and other.solver("") == Solver("cvode")
    assert other.tolerance("") == 1e-6
    assert plan_drive(modelica(root, kind="model_exchange", solver="rk4")).tolerance("") is None


@pytest.mark.parametrize(
    ("name", "keys", "said"),
    [
        ("velocity_servo", {"kind": "model_exchange"}, "offers co-simulation alone; remove kind"),
        ("velocity_servo", {"solver": "cvode"}, "brings its own for co-simulation; remove it"),
        ("modelica_dc", {"solver": "rk4"}, 'brings its own for co-simulation; set kind = "model_exchange"'),
    ],
)
def test_a_kind_or_solver_that_does_not_fit_is_refused(root: Path, name: str, keys: dict[str, str], said: str):
    with pytest.raises(InputRefused, match=said):
        plan_drive(load_drive(str(root / "fmus" / name), root).model_copy(update=keys))


def test_a_step_without_the_solver_that_makes_it_is_refused():
    with pytest.raises(ValueError, match='solver_step_ms belongs to solver = "rk4"'):
        Drive.model_validate({"fmu": "a.fmu", "solver_step_ms": 0.1})


def test_a_recording_tells_kind_solver_and_tolerance(root: Path, tmp_path: Path):
    changes = ["duration_s=0.01", "drive.kind=model_exchange", "drive.solver=rk4", "drive.solver_step_ms=0.05"]
    experiment = load_experiment(root / "experiments/fig4_position.toml", changes, drive="modelica_dc")
    recording = read(execute(experiment, tmp_path).recording)
    told = recorded_fmus(recording.metadata, tmp_path)["drive_1"]
    assert told["kind"] == "model_exchange" and told["solver"] == "rk4" and told["solver_step"] == 5e-5


@pytest.mark.parametrize("fmi", [2, 3])
def test_the_bench_qualifies_a_motor_and_finds_reset_and_state_bit_for_bit(motor: Planner, fmi: int):
    facts = qualify_drive(motor(fmi, i_max=0.5).table).to_dict()
    assert facts["qualified"] and facts["fmus"][0]["solver"] == "cvode"
    assert {name: facts["checks"][name]["verdict"] for name in ("repeats", "reset", "state")} == {
        "repeats": "ok", "reset": "ok", "state": "ok",
    }  # fmt: skip


def test_the_bench_tells_of_a_runge_kutta_step_that_is_too_long(motor: Planner):
    # at a time constant of 2 ms a step of 4 ms is close to where it diverges
    measures = qualify_drive(motor(solver="rk4", L=2e-4, solver_step_ms=0.25, kp=20.0).table).to_dict()["measures"]
    assert measures["step_error"]["value"] > 0.0


def test_parts_have_solvers_of_their_own(root: Path, exchange_folder: Path):
    part = {"fmu": str(exchange_fmu(exchange_folder, "motor", 2)), "solver": "rk4"}
    other = {"fmu": str(root / "fmus/velocity_servo/velocity_servo.fmu")}
    table = Drive.model_validate(
        {
            "parts": {"motor": part, "servo": other},
            "wires": {"servo.omega_ref": "motor.omega_m"},
            "inputs": {"omega_ref": "motor.omega_ref", "tau_load": "servo.tau_load"},
            "outputs": {"theta_m": "servo.theta_m", "omega_m": "servo.omega_m"},
        }
    )
    plan = plan_drive(table)
    assert plan.solver("motor") == Solver("rk4") and plan.solver("servo") is None


@pytest.mark.parametrize("solver", ["cvode", "rk4"])
def test_the_equations_of_a_model_are_what_is_called(motor: Planner, solver: str):
    component = drive("drive_1", motor(solver=solver), 1e-3, 0.0, 0.0)
    assert isinstance(component, FmuComponent) and component.step_call == "its equations of model exchange"
    component.close()
    component.close()


TICKS = np.arange(100)
INPUTS = 3.0 * np.sin(0.04 * TICKS), np.zeros(100)
RUNNING = {
    "derivative is NaN": "returned NaN or infinity for derivative 2 of 3",
    "event without end": "did not finish an event at 0.05 s",
    "states grow": "wrote more states|has 4 continuous states after an event",
    "indicators flicker": "made more than 1000 events in one step",
    "event in the past": "asked at 0.05 s for a time event at -0.45 s, which is past",
    "indicator is NaN": "returned NaN or infinity for event indicator 1 of 2",
    "event now, for ever": "made more than 1000 events in one step, the last at 0.05 s",
    "derivatives fail": r"fmi\dGet\w+ returned fmi\dError",
    "terminate": "asked to terminate the simulation",
    "too many states": "wrote more states, derivatives or event indicators than it declares",
}
FLICKER = "indicators flicker"
STARTING = {
    "derivative is NaN": "says nan for number 2 of 3 at the start",
    "event without end": "its first event needs more than 1000 updates",
    "states grow": "writes more numbers than the 3|its binary has 4 continuous states",
    "event in the past": "asks for a time event at -0.5 s, before the start",
    "indicator is NaN": "says nan for number 1 of 2 at the start",
    "derivatives fail": r"fmi\dGet\w+ failed",
    "terminate": "cannot be brought into continuous-time mode: it asks to terminate",
    "too many states": "writes more numbers than the 3 that modelDescription.xml lists",
}


@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize(
    ("fault", "solver"),
    [(fault, solver) for fault in RUNNING for solver in ("cvode", "rk4") if (fault, solver) != (FLICKER, "rk4")],
)
def test_what_goes_wrong_in_a_run_ends_it_with_one_sentence(motor: Planner, fault: str, fmi: int, solver: str):
    plan = motor(fmi, solver=solver, fault=FAULTS[fault], fault_at=0.05, i_max=0.3)
    with pytest.raises(ComponentFailed, match=RUNNING[fault]) as failure:
        response(plan, *INPUTS)
    assert "\n" not in str(failure.value) and re.search(r"in the step from t = 0\.0(49|5) s", str(failure.value))


def test_an_exception_without_a_text_at_the_start_is_a_refusal_too(motor: Planner, monkeypatch: pytest.MonkeyPatch):
    def fail(self: object) -> None:
        raise MemoryError

    monkeypatch.setattr("fmpy.fmi2.FMU2Model.enterContinuousTimeMode", fail)
    with pytest.raises(InputRefused, match="cannot be brought into continuous-time mode: MemoryError"):
        response(motor(), *INPUTS)


@pytest.mark.parametrize("fmi", [2, 3])
def test_indicators_that_flicker_do_not_hold_up_steps_of_one_length(motor: Planner, fmi: int):
    # looked at once per step: events that change nothing, one per step
    plan = motor(fmi, solver="rk4", fault=FAULTS[FLICKER], fault_at=0.05, i_max=0.3)
    assert len(response(plan, *INPUTS).t) == len(INPUTS[0])


@pytest.mark.parametrize("fmi", [2, 3])
def test_nominal_values_that_cannot_be_read_after_an_event_end_a_run_with_one_sentence(motor: Planner, fmi: int):
    # CVODE is scaled by them; the event at 0.05 s says that they have changed
    plan = motor(fmi, solver="cvode", fault=FAULTS["no nominal values"], fault_at=0.05, switch_every=0.05)
    with pytest.raises(ComponentFailed, match=f"fmi{fmi}GetNominalsOfContinuousStates returned fmi{fmi}Error"):
        response(plan, *INPUTS)


@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize("fault", STARTING)
def test_what_is_wrong_at_the_start_is_refused(motor: Planner, fault: str, fmi: int):
    with pytest.raises(InputRefused, match=STARTING[fault]):
        drive("drive_1", motor(fmi, fault=FAULTS[fault]), 1e-3, 0.0, 0.0)


@pytest.mark.parametrize(
    ("fmi", "states", "said"),
    [
        (2, 2, "writes more numbers than the 2"),
        (2, 4, "writes fewer numbers than the 4"),
        (2, 1001, "1001 continuous states; a drive may have 1000"),
        (3, 2, "its binary has 3 continuous states, its modelDescription.xml lists 2"),
    ],
)
def test_a_number_of_states_that_is_not_the_binarys_is_refused(exchange_folder: Path, fmi: int, states: int, said: str):
    plan = plan_drive(Drive.model_validate({"fmu": str(exchange_fmu(exchange_folder, "motor", fmi, states))}))
    with pytest.raises(InputRefused, match=said):
        drive("drive_1", plan, 1e-3, 0.0, 0.0)


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
