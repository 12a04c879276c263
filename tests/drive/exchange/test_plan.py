"""How a drive is told which kind it is of and which solver it gets, and what a recording says of it."""

from pathlib import Path
from typing import Any

import pytest

from tests.drive.exchange.conftest import Planner
from tests.drive.exchange.fmus import exchange_fmu
from twin.drive.component import FmuComponent
from twin.drive.exchange.component import ExchangeComponent
from twin.drive.exchange.solver import Solver
from twin.errors import InputRefused
from twin.experiment.drive_files import lone_drive
from twin.experiment.recorded import recorded_fmus
from twin.experiment.schema import Drive
from twin.recording.reader import read
from twin.runs.assembly.drive_component import drive
from twin.runs.assembly.drives import planned
from twin.runs.assembly.load import load_experiment
from twin.runs.run import execute
from twin.studies.qualify.qualification import qualified


def modelica(root: Path, **keys: Any) -> Drive:
    """The drive that comes as both kinds."""
    return lone_drive(str(root / "fmus/modelica_dc"), root).model_copy(update=keys)


def test_an_fmu_of_both_kinds_is_for_co_simulation_unless_the_experiment_says_otherwise(root: Path):
    usual, other = planned(modelica(root)), planned(modelica(root, kind="model_exchange"))
    assert usual.parts[""].kind == "co_simulation" and usual.solver("") is None and usual.tolerance("") is None
    assert other.parts[""].kind == "model_exchange" and other.solver("") == Solver("cvode")
    assert other.tolerance("") == 1e-6
    assert planned(modelica(root, kind="model_exchange", solver="rk4")).tolerance("") is None


@pytest.mark.parametrize(
    ("name", "keys", "said"),
    [
        ("velocity_servo", {"kind": "model_exchange"}, "offers co-simulation alone; remove kind"),
        ("velocity_servo", {"solver": "cvode"}, "brings its own for co-simulation; remove it"),
        ("modelica_dc", {"solver": "rk4"}, 'brings its own for co-simulation; say kind = "model_exchange"'),
    ],
)
def test_a_kind_or_solver_that_does_not_fit_is_refused(root: Path, name: str, keys: dict[str, str], said: str):
    with pytest.raises(InputRefused, match=said):
        planned(lone_drive(str(root / "fmus" / name), root).model_copy(update=keys))


def test_a_step_without_the_solver_that_makes_it_is_refused():
    with pytest.raises(ValueError, match='solver_step_ms is of solver = "rk4"'):
        Drive.model_validate({"fmu": "a.fmu", "solver_step_ms": 0.1})


def test_a_recording_tells_kind_solver_and_tolerance(root: Path, tmp_path: Path):
    changes = ["duration_s=0.01", "drive.kind=model_exchange", "drive.solver=rk4", "drive.solver_step_ms=0.05"]
    experiment = load_experiment(root / "experiments/fig4_position.toml", changes, drive="modelica_dc")
    recording = read(execute(experiment, tmp_path).recording)
    told = recorded_fmus(recording.metadata, tmp_path)["drive_1"]
    assert told["kind"] == "model_exchange" and told["solver"] == "rk4" and told["solver_step"] == 5e-5


@pytest.mark.parametrize("fmi", [2, 3])
def test_the_bench_qualifies_a_motor_and_finds_reset_and_state_bit_for_bit(motor: Planner, fmi: int):
    facts = qualified(motor(fmi, i_max=0.5).table).facts()
    assert facts["qualified"] and facts["fmus"][0]["solver"] == "cvode"
    assert {name: facts["checks"][name]["verdict"] for name in ("repeats", "reset", "state")} == {
        "repeats": "ok", "reset": "ok", "state": "ok",
    }  # fmt: skip


def test_the_bench_tells_of_a_runge_kutta_step_that_is_too_long(motor: Planner):
    # at a time constant of 2 ms a step of 4 ms is close to where it diverges
    measures = qualified(motor(solver="rk4", L=2e-4, solver_step_ms=0.25, kp=20.0).table).facts()["measures"]
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
    plan = planned(table)
    assert plan.solver("motor") == Solver("rk4") and plan.solver("servo") is None


@pytest.mark.parametrize("solver", ["cvode", "rk4"])
def test_a_model_of_another_kind_is_another_component(motor: Planner, solver: str):
    component = drive("drive_1", motor(solver=solver), 1e-3, 0.0, 0.0)
    assert isinstance(component, ExchangeComponent) and isinstance(component, FmuComponent)
    component.close()
    component.close()
