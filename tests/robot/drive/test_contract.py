"""Drives that leave their shaft to others, and those that have three of them."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from tests.kernel.fmi.archives import redescribed
from tests.kernel.fmi.own_shafts import machine, position_servo, unit
from tests.kernel.fmi.three_axes import three_axes_drive
from twin.kernel.cosim.component import Component
from twin.kernel.cosim.delay import play, values_by_port
from twin.kernel.errors import InputRefused
from twin.kernel.fmi.component import FmuComponent
from twin.kernel.recording.reader import Recording, read
from twin.robot.assembly.drives import drive, plan_drive
from twin.robot.assembly.load import load_experiment
from twin.robot.drive.contract import DriveRotor
from twin.robot.experiment.schema import Drive
from twin.robot.run.run import execute

TICK = 1e-3
START = 0.75
DEGREE = math.pi / 180.0
FOLLOWS = 40.0
"""1/s. How fast the test's servo follows its goal."""

Numbers = NDArray[np.float64]


@pytest.fixture(scope="module")
def servo(root: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return position_servo(root, tmp_path_factory.mktemp("servo"))


@pytest.fixture(scope="module")
def motor(root: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return machine(root, tmp_path_factory.mktemp("machine"))


def servo_table(servo: Path, wraps: bool = False, **table: Any) -> Drive:
    return Drive.model_validate(
        {
            "fmu": str(servo),
            "command": "position",
            "inputs": {"command": "goal_velocity", "tau_load": "load_torque"},
            "outputs": {"theta_m": "shaft_angle", "omega_m": "shaft_speed"},
            "parameters": {"velocity_limit": FOLLOWS, "counts": 2.0 if wraps else 1.0},
            **table,
        }
    )


def moved(table: Drive, omega_ref: Numbers, tau_load: float = 0.0, start: float = START) -> dict[str, Numbers]:
    """What the drive does in ticks of 1 ms with these commanded speeds."""
    component = drive("drive_1", plan_drive(table), TICK, start, 0.0)
    try:
        n = len(omega_ref)
        u = np.column_stack([omega_ref, np.full(n, tau_load)])
        rows, status = play(component, TICK * np.arange(n, dtype=float), np.full(n, TICK), u)
        assert status == 0
        return values_by_port(component.outputs, rows)
    finally:
        component.close()


def test_a_position_servo_is_told_where_to_be_when_the_next_command_comes(servo: Path):
    omega_ref = np.linspace(-2.0, 3.0, 400)
    done = moved(servo_table(servo), omega_ref)
    # sums of 400 rounded increments
    np.testing.assert_allclose(done["command"], START + TICK * np.cumsum(omega_ref), atol=1e-12)


def test_a_position_servo_starts_where_its_shaft_is_coupled_and_follows(servo: Path):
    done = moved(servo_table(servo), np.full(500, 2.0))
    goal, share = START + 2.0 * TICK * np.arange(1, 501), 1.0 - math.exp(-FOLLOWS * TICK)
    theta = np.empty(500)
    now = START
    for k in range(500):
        now = theta[k] = now + share * (goal[k] - now)
    np.testing.assert_allclose(done["theta_m"], theta, atol=1e-12)


@pytest.mark.parametrize("sign", [1, -1])
def test_gear_and_sign_of_a_position_servo_change_nothing_at_the_robots_shaft(servo: Path, sign: int):
    omega_ref = np.linspace(-2.0, 3.0, 400)
    geared = moved(servo_table(servo, sign=sign, gear_ratio=7.0), omega_ref)
    np.testing.assert_allclose(geared["theta_m"], moved(servo_table(servo), omega_ref)["theta_m"], atol=1e-12)


@pytest.mark.parametrize("sign", [1, -1])
def test_a_servo_that_counts_over_one_turn_moves_on_over_many(servo: Path, sign: int):
    omega_ref = 8.0 * np.sin(np.linspace(0.0, 3.0, 3000))
    wrapped = servo_table(servo, wraps=True, sign=sign, gear_ratio=3.0, position_command={"wrap_from_deg": -180.0})
    theta = moved(wrapped, omega_ref)["theta_m"]
    assert 3.0 * (theta.max() - START) > 4.0 * math.tau
    np.testing.assert_allclose(theta, moved(servo_table(servo, gear_ratio=3.0), omega_ref)["theta_m"], atol=1e-10)


def test_a_limit_holds_the_command_and_lets_it_go_at_once(servo: Path):
    omega_ref = np.repeat([5.0, -1.0], 1000)
    table = servo_table(servo, gear_ratio=2.0, position_command={"lower_deg": -10.0, "upper_deg": 20.0})
    command = moved(table, omega_ref)["command"]
    # in degrees of the servo's shaft, which starts at its own 0
    assert command.max() == pytest.approx(START + 20.0 * DEGREE / 2.0, abs=1e-12)
    assert command[1000] == pytest.approx(command[999] - TICK, abs=1e-12)
    assert command.min() == pytest.approx(START - 10.0 * DEGREE / 2.0, abs=1e-12)


def test_limits_turn_with_the_servo(servo: Path):
    table = servo_table(servo, sign=-1, position_command={"lower_deg": -10.0, "upper_deg": 20.0})
    assert moved(table, np.full(1000, 5.0))["command"].max() == pytest.approx(START + 10.0 * DEGREE, abs=1e-12)


def test_a_command_is_no_further_ahead_than_its_lead(servo: Path):
    done = moved(servo_table(servo, position_command={"lead_deg": 3.0}), np.full(500, 8.0))
    ahead = done["command"][1:] - done["theta_m"][:-1]
    # 8 rad/s would be 8/40 rad ahead of a servo that follows with 40 1/s
    assert ahead.max() == pytest.approx(3.0 * DEGREE, abs=1e-12)


def test_a_servo_is_told_at_its_own_period(servo: Path):
    command = moved(servo_table(servo, position_command={"period_ms": 5.0}), np.full(100, 2.0))["command"]
    np.testing.assert_allclose(command, START + 2.0 * 5 * TICK * np.repeat(np.arange(1, 21), 5), atol=1e-12)


@settings(deadline=None, max_examples=30)
@given(st.floats(1e-5, 1e-2), st.one_of(st.just(0.0), st.floats(1e-9, 1.0)), st.floats(-2.0, 2.0), st.floats(-1.0, 1.0))
def test_the_rotor_is_its_equation_solved(J: float, b: float, torque: float, load: float):
    n, h = 50, 1e-3
    u = np.tile([torque, load], (n, 1))
    rows, status = play(DriveRotor(J, b, START), h * np.arange(n, dtype=float), np.full(n, h), u)
    assert status == 0
    t, tau = h * np.arange(1, n + 1), torque - load
    x = b * t / J
    # by their series where the closed forms cancel
    small, slow = x < 1e-4, max(b, 1e-300)
    omega = np.where(small, tau * t / J * (1.0 - x / 2.0 + x * x / 6.0), tau / slow * -np.expm1(-x))
    theta = np.where(
        small, tau * t * t / J * (0.5 - x / 6.0 + x * x / 24.0), tau / slow * (t + np.expm1(-x) * J / slow)
    )
    scale = abs(tau) * t[-1] / J
    # rounding of 50 steps; the closed form of the angle cancels x^2/2 against x, so 1e-16/x of it
    np.testing.assert_allclose(rows[:, 1], omega, atol=1e-12 * scale + 1e-300)
    np.testing.assert_allclose(rows[:, 0] - START, theta, atol=1e-11 * scale * t[-1] + 1e-12 + 1e-300)


def machine_table(motor: Path, **table: Any) -> Drive:
    return Drive.model_validate(
        {
            "fmu": str(motor),
            "inputs": {"omega_ref": "omega_ref", "omega_m": "tau_load"},
            "outputs": {"tau_motor": "tau_motor"},
            "parameters": {"T_m": 0.05},
            "rotor": {"J_kg_m2": 1e-3, "b_Nm_s_per_rad": 0.01},
            **table,
        }
    )


def test_a_machine_without_a_shaft_turns_our_rotor(motor: Path):
    done = moved(machine_table(motor), np.full(2000, 2.0), tau_load=0.02)
    # K (omega_ref - omega) = tau_load + b omega; 20 ms is its time constant
    assert done["omega_m"][-1] == pytest.approx((0.05 * 2.0 - 0.02) / (0.05 + 0.01), rel=1e-10)
    assert done["tau_motor"][-1] == pytest.approx(0.02 + 0.01 * done["omega_m"][-1], rel=1e-10)


def test_the_rotor_is_felt_at_the_robots_shaft_whatever_gear_is_before_it(motor: Path):
    plain = moved(machine_table(motor), np.full(500, 2.0), tau_load=0.02)
    # ten times the speed and a tenth of the torque at the FMU: a hundredth of the torque per speed
    geared = machine_table(motor, gear_ratio=10.0, sign=-1, parameters={"T_m": 0.05 / 100.0})
    np.testing.assert_allclose(moved(geared, np.full(500, 2.0), 0.02)["theta_m"], plain["theta_m"], atol=1e-12)


def test_finer_steps_bring_machine_and_rotor_to_the_coupled_solution(motor: Path):
    exact = 1.0 - math.exp(-(0.05 + 0.01) / 1e-3 * 0.1)
    error = []
    for substeps in (1, 2, 4):
        done = moved(machine_table(motor, substeps=substeps), np.full(100, 2.0))
        error.append(abs(done["omega_m"][-1] / (0.05 * 2.0 / 0.06) - exact))
    # the torque is held over a step: order 1
    assert error[0] / error[1] == pytest.approx(2.0, rel=0.1)
    assert error[1] / error[2] == pytest.approx(2.0, rel=0.1)


def test_a_machine_that_is_not_told_of_its_shaft_is_warned_of(motor: Path, tmp_path: Path):
    blind = redescribed(motor, tmp_path / "blind.fmu", *unit("opposes positive omega_m", "rad/s", "N.m"))
    (warning,) = plan_drive(machine_table(blind, inputs={"omega_ref": "omega_ref"})).warnings()
    assert "[drive.inputs] omega_m" in warning
    assert not plan_drive(machine_table(motor)).warnings()


@pytest.mark.parametrize(
    "table, sentence",
    [
        ({"command": "velocity", "position_command": {}}, 'command = "velocity" takes no position_command'),
        ({"position_command": {"lower_deg": 5.0, "upper_deg": 5.0}}, "lower_deg: expected less than upper_deg"),
        ({"velocity_loop": {"kp": 1, "limit": 1, "period_ms": 1}}, 'command = "position" takes no velocity_loop'),
    ],
)
def test_what_does_not_fit_a_position_command_is_refused(servo: Path, table: dict[str, Any], sentence: str):
    with pytest.raises(ValueError, match=sentence):
        servo_table(servo, **table)


def test_a_drive_without_torque_turns_no_rotor(servo: Path):
    with pytest.raises(InputRefused, match="which of its variables is tau_motor"):
        plan_drive(servo_table(servo, rotor={"J_kg_m2": 1e-4}, inputs={"command": "goal_velocity"}, outputs={}))


def test_an_unmapped_servo_is_proposed_as_one_that_takes_a_position(servo: Path):
    with pytest.raises(InputRefused, match=r'commanded with a position\.\n(.*\n)*command = "position"'):
        plan_drive(Drive.model_validate({"fmu": str(servo), "outputs": {"theta_m": "shaft_angle"}}))


def test_an_unmapped_machine_is_told_how_to_get_a_shaft(motor: Path, tmp_path: Path):
    angle = 'Motor angle, before spring and belt" initial="exact">\n      <Real start="0.0" unit='
    shaftless = redescribed(motor, tmp_path / "shaftless.fmu", f'{angle}"rad"', f'{angle}"s"')
    with pytest.raises(InputRefused, match=r"\[drive.rotor\] J_kg_m2"):
        plan_drive(Drive.model_validate({"fmu": str(shaftless), "inputs": {"omega_ref": "omega_ref"}}))


SPEEDS, LOADS, ANGLES = np.array([1.0, 2.0, 4.0]), np.array([0.1, -0.3, 0.5]), np.array([0.2, 0.7, -0.4])
DROOP = 0.6
"""rad/s per N m, of three_axes.c."""


@pytest.fixture(scope="module")
def fmu(root: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return three_axes_drive(root, tmp_path_factory.mktemp("three_axes"))


def ran(root: Path, folder: Path, fmu: str, *overrides: str) -> Recording:
    folder.mkdir()
    experiment = load_experiment(root / "experiments/fig4_force_position.toml", ["duration_s=7", *overrides], fmu)
    return read(execute(experiment, folder).recording)


def test_three_axes_in_one_fmu_move_the_robot_like_three_drives(root: Path, fmu: Path, tmp_path: Path):
    together = ran(root, tmp_path / "together", str(fmu))
    apart = ran(root, tmp_path / "apart", "velocity_servo")
    assert together["drive.theta_m"].shape == (7001, 3)
    assert np.array_equal(together["controller.triggered"], apart["controller.triggered"])
    # the same solution written differently: rounding, which single encoder counts may pass on to the force
    assert np.abs(together["plant.p_B"] - apart["plant.p_B"]).max() < 1e-9
    assert np.array_equal(
        np.stack([together["drive.theta_m"][0, i] for i in range(3)]),
        np.stack([apart[f"drive/{i + 1}.theta_m"][0] for i in range(3)]),
    )


def stepped(component: Component, omega_ref: Numbers, tau_load: Numbers, ticks: int) -> dict[str, Numbers]:
    """Outputs (3,) after `ticks` of 1 ms with these inputs (3,)."""
    given = {"omega_ref": omega_ref, "tau_load": tau_load}
    u = np.tile(np.concatenate([given[port.name] for port in component.inputs]), (ticks, 1))
    rows, status = play(component, 1e-3 * np.arange(ticks, dtype=float), np.full(ticks, 1e-3), u)
    assert status == 0
    return {name: values[0] for name, values in values_by_port(component.outputs, rows[-1:]).items()}


@pytest.mark.parametrize("plain", [{}, {"substeps": 2}], ids=["alone", "sub-stepped"])
def test_each_axis_has_its_own_command_load_and_angle(fmu: Path, plain: dict[str, Any]):
    """A robot in the plane x = 0 is its own mirror image and cannot tell axis 2 from axis 3."""
    component = drive("drive", plan_drive(Drive.model_validate({"fmu": str(fmu), **plain})), 1e-3, ANGLES, LOADS)
    np.testing.assert_array_equal(component.initial("theta_m"), ANGLES)
    end = stepped(component, SPEEDS, LOADS, 1000)
    component.close()
    speed = SPEEDS - DROOP * LOADS
    # 50 time constants of 20 ms are over; on the way one of them was lost; rounding of 1,000 sums
    np.testing.assert_allclose(end["omega_m"], speed, rtol=1e-12)
    np.testing.assert_allclose(end["theta_m"] - ANGLES, speed * (1.0 - 0.02), rtol=1e-11)


def test_inside_the_fmu_axes_are_in_the_robots_order(fmu: Path):
    """Turned over on the way in and back on the way out nobody outside would see it."""
    component = drive("drive", plan_drive(Drive.model_validate({"fmu": str(fmu)})), 1e-3, ANGLES, LOADS)
    assert isinstance(component, FmuComponent)
    variables = component.instance.description.variables
    np.testing.assert_array_equal(component.instance.read_floats([variables["tau_load"]]), LOADS)
    stepped(component, SPEEDS, -LOADS, 1)
    found = component.instance.read_floats([variables["omega_ref"], variables["tau_load"]])
    component.close()
    np.testing.assert_array_equal(found, [*SPEEDS, *-LOADS])


def test_a_joint_of_its_own_beside_three_axes_is_refused(root: Path, fmu: Path, tmp_path: Path):
    with pytest.raises(InputRefused, match="drives all three joints"):
        ran(root, tmp_path / "run", str(fmu), "drive.joint_2.fmu='fmus/ideal_velocity'")


def test_arrays_of_another_width_are_refused(root: Path, tmp_path: Path):
    fmu = str(three_axes_drive(root, tmp_path, size=2))
    with pytest.raises(InputRefused, match="omega_ref has 2, tau_load has 3"):
        ran(root, tmp_path / "run", fmu)


def test_three_axes_can_be_sub_stepped(root: Path, fmu: Path, tmp_path: Path):
    coarse, fine = ran(root, tmp_path / "a", str(fmu)), ran(root, tmp_path / "b", str(fmu), "drive.substeps=4")
    assert np.abs(coarse["plant.p_B"] - fine["plant.p_B"]).max() < 1e-9
