"""Model-exchange drives on the bench, against their equations solved by scipy at 1e-12."""

from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.kernel.fmi.exchange.conftest import Planner
from tests.kernel.fmi.exchange.equations import exact_motor
from tests.kernel.fmi.exchange.fmus import exchange_fmu
from twin.kernel.cosim.simulation import Simulation
from twin.kernel.cosim.system import System
from twin.kernel.fmi.component import FmuComponent
from twin.robot.assembly.drives import DrivePlan, drive, plan_drive
from twin.robot.experiment.drive_files import load_drive
from twin.robot.experiment.schema import Drive
from twin.studies.qualify.bench import Response, playback, response

TICK = 1e-3
T = TICK * np.arange(100)
PULSE = np.where((T >= 0.01) & (T < 0.05), 3.0, -1.0), np.where(T > 0.05, 0.05, 0.0)
"""Inputs that jump three times."""
SWINGING = 3.0 * np.sin(40.0 * T), 0.05 * np.sin(70.0 * T)
"""Inputs that jump in every tick: the solver begins anew a hundred times."""
CASES: dict[str, tuple[tuple[np.ndarray, np.ndarray], dict[str, float]]] = {
    "smooth": (PULSE, {}),
    "inputs jump": (SWINGING, {}),
    "state events of a limiter": (SWINGING, {"i_max": 0.3}),
    "state event of an end stop": (PULSE, {"stop": 0.095}),
    "time events": (SWINGING, {"switch_every": 0.0123}),
    "time events on ticks": (PULSE, {"switch_every": 0.02}),
    "all events": (PULSE, {"i_max": 0.3, "stop": 0.095, "switch_every": 0.0123}),
}


def error(plan: DrivePlan, case: str) -> float:
    """Largest error of angle (rad) and speed (of its largest value)."""
    inputs, parameters = CASES[case]
    exact, found = exact_motor(inputs[0], inputs[1], TICK, **parameters), response(plan, *inputs)
    speed = np.max(np.abs(found.omega_m - exact[:, 1])) / max(1.0, np.max(np.abs(exact[:, 1])))
    return float(max(np.max(np.abs(found.theta_m - exact[:, 0])), speed))


@pytest.mark.parametrize("case", CASES)
def test_the_error_falls_with_the_tolerance_and_is_at_most_a_hundred_times_it(motor: Planner, case: str):
    tolerances = [1e-4, 1e-6, 1e-8]
    errors = [error(motor(tolerance=tolerance, **CASES[case][1]), case) for tolerance in tolerances]
    assert all(e <= 100.0 * tolerance for e, tolerance in zip(errors, tolerances, strict=True))
    assert all(finer < 0.2 * coarser for coarser, finer in pairwise(errors))


@pytest.mark.parametrize("case", CASES)
def test_runge_kutta_errs_with_the_fourth_power_of_its_step_events_or_not(motor: Planner, case: str):
    coarse, fine = (error(motor(solver="rk4", solver_step_ms=step, **CASES[case][1]), case) for step in (0.25, 0.0625))
    # 4**4 = 256; an event falls anywhere in a step, so that its share of the error is now larger, now smaller
    assert fine < coarse / 60.0 and fine < 1e-6


def same(one: Response, other: Response) -> bool:
    return np.array_equal(one.theta_m, other.theta_m) and np.array_equal(one.omega_m, other.omega_m)


@pytest.mark.parametrize("parts", [1, 3, 4])
def test_a_step_that_goes_into_the_tick_a_whole_number_of_times_is_not_made_shorter(motor: Planner, parts: int):
    # as many as with one that is longer by a tenth
    whole, longer = (motor(solver="rk4", solver_step_ms=share / parts) for share in (1.0, 1.1))
    assert same(response(whole, *PULSE), response(longer, *PULSE))


@pytest.mark.parametrize("solver", ["cvode", "rk4"])
def test_both_standards_give_the_same_bits(motor: Planner, solver: str):
    inputs, parameters = CASES["all events"]
    assert same(*(response(motor(fmi, solver=solver, **parameters), *inputs) for fmi in (2, 3)))


def test_a_second_run_gives_the_same_bits(motor: Planner):
    inputs, parameters = CASES["all events"]
    assert same(*(response(motor(**parameters), *inputs) for _ in range(2)))


def test_events_that_fall_on_a_tick_happen_once(motor: Planner):
    # a supply that is switched at 20, 40, 60 ms and so on is at half from 20 to 40 ms; twice, and it is never
    inputs, parameters = CASES["time events on ticks"]
    assert error(motor(tolerance=1e-8, **parameters), "time events on ticks") < 1e-6
    whole = response(motor(), *inputs)
    assert np.max(np.abs(response(motor(**parameters), *inputs).omega_m - whole.omega_m)) > 0.01


@pytest.mark.parametrize("solver", ["cvode", "rk4"])
@pytest.mark.parametrize("fmi", [2, 3])
def test_an_fmu_that_asks_for_an_event_after_a_step_gets_it(motor: Planner, fmi: int, solver: str):
    def updates(asks: float) -> float:
        component = drive("drive_1", motor(fmi, solver=solver, asks=asks), TICK, 0.0, 0.0)
        assert isinstance(component, FmuComponent)
        signals = playback(component.inputs, np.array([[3.0, 0.0]]))
        wires = [(f"signals.{port.name}", f"drive_1.{port.name}") for port in component.inputs]
        try:
            Simulation(System([signals, component], wires, TICK), 10).run()
            return float(component.instance.read_floats([component.instance.description.variables["updates"]])[0])
        finally:
            component.close()

    # once at the start and once because the input jumps
    assert updates(0.0) == 2.0 and updates(5.0) == 7.0


@pytest.mark.parametrize("keys", [{"tolerance": 1e-9}, {"solver": "rk4", "solver_step_ms": 0.1}])
def test_the_equations_of_velocity_servo_come_to_what_its_closed_form_does(
    exchange_folder: Path, root: Path, keys: dict[str, Any]
):
    fmu = exchange_fmu(exchange_folder, "servo", 2)
    # without limits: where those bend the equations no Runge-Kutta step sees it
    inputs = np.where(T < 0.05, 0.3, -0.2), np.where(T > 0.02, 0.05, 0.0)
    own = response(plan_drive(load_drive(str(root / "fmus/velocity_servo"), root)), *inputs)
    found = response(plan_drive(Drive.model_validate({"fmu": str(fmu), **keys})), *inputs)
    assert np.max(np.abs(found.theta_m - own.theta_m)) < 1e-8


def test_a_drive_of_both_kinds_moves_as_its_own_solver_says_that_steps_finely(root: Path):
    # forward Euler with ten steps per step: its error falls as its step does, and what is left is ours
    table = load_drive(str(root / "fmus/modelica_dc"), root)
    inputs = 0.5 * np.sin(40.0 * T), 0.05 * np.sin(70.0 * T)
    exact = response(plan_drive(table.model_copy(update={"kind": "model_exchange", "tolerance": 1e-10})), *inputs)
    apart = [
        np.max(np.abs(response(plan_drive(table.model_copy(update={"substeps": n})), *inputs).theta_m - exact.theta_m))
        for n in (4, 40, 400)
    ]
    assert apart[1] < 0.2 * apart[0] and apart[2] < 0.2 * apart[1] and apart[2] < 1e-6
