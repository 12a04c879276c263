"""stepper.fmu: its README's equations by scipy, its micro-steps, and when it loses steps."""

from dataclasses import dataclass, field
from math import floor, pi, sin, sqrt

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from tests.conftest import examples

from .rig import Rig

DRIVE = "stepper"


@dataclass
class Stepper:
    """Step generator and rotor with their default parameters; numbers in brackets: the README's equations."""

    N_r: float = 50.0
    tau_hold: float = 0.4
    tau_detent: float = 0.022
    J_m: float = 5.5e-5
    b_m: float = 4e-3
    micro_steps: float = 32.0
    omega_max: float = 8.0
    alpha_max: float = 200.0
    T_c: float = 50e-6

    x: np.ndarray = field(default_factory=lambda: np.zeros(2))  # theta_m, omega_m
    omega_g: float = 0.0
    theta_g: float = 0.0

    @property
    def micro_step(self) -> float:
        """r in (3)."""
        return 2 * pi / (4 * self.N_r * self.micro_steps)

    @property
    def theta_f(self) -> float:
        """(3)"""
        return self.micro_step * floor(self.theta_g / self.micro_step + 0.5)

    def torque(self, theta: float) -> float:
        """(4)"""
        return self.tau_hold * sin(self.N_r * (self.theta_f - theta))

    def excess(self, theta: float, tau_load: float) -> float:
        """(4) to (6) at rest."""
        return self.torque(theta) - self.tau_detent * sin(4 * self.N_r * theta) - tau_load

    def run(self, omega_ref: float, tau_load: float, ticks: int) -> None:
        """(1) to (6)"""
        for _ in range(ticks):
            target = min(max(omega_ref, -self.omega_max), self.omega_max)
            step = self.alpha_max * self.T_c
            self.omega_g += min(max(target - self.omega_g, -step), step)
            self.theta_g += self.T_c * self.omega_g

            def rates(t: float, x: np.ndarray) -> list[float]:
                return [x[1], (self.excess(x[0], tau_load) - self.b_m * x[1]) / self.J_m]

            self.x = solve_ivp(rates, (0, self.T_c), self.x, "DOP853", rtol=1e-11, atol=1e-14).y[:, -1]


STEPPER = Stepper()
ELECTRICAL_CYCLE = 2 * pi / STEPPER.N_r


@examples(10)
@given(omega_ref=st.floats(-10.0, 10.0), tau_load=st.floats(-0.5, 0.5), omega_m=st.floats(-2.0, 2.0))
def test_drive_follows_its_equations(omega_ref: float, tau_load: float, omega_m: float) -> None:
    reference = Stepper(x=np.array([0.0, omega_m]))
    with Rig(DRIVE).start(omega_ref=omega_ref, tau_load=tau_load, omega_m=omega_m) as drive:
        for _ in range(5):
            reference.run(omega_ref, tau_load, ticks=20)
            drive.step(1e-3)
            # 100 ticks with a relative error of 4e-10 each, on swings of up to 0.1 rad: at worst 4e-10 rad, 1e-7 rad/s
            assert drive["theta_m"] == pytest.approx(reference.x[0], rel=0, abs=2e-9)
            assert drive["omega_m"] == pytest.approx(reference.x[1], rel=0, abs=5e-7)
            assert drive["theta_f"] == pytest.approx(reference.theta_f, rel=0, abs=1e-14)  # rounding
            assert drive["tau_motor"] == pytest.approx(reference.torque(reference.x[0]), rel=0, abs=4e-8)


def test_the_field_moves_in_whole_micro_steps() -> None:
    with Rig(DRIVE).start(omega_ref=0.1) as drive:
        angles = []
        for _ in range(2000):
            drive.step(50e-6)
            angles.append(drive["theta_f"])
    jumps = np.diff(angles)
    assert jumps[jumps != 0.0] == pytest.approx(STEPPER.micro_step, rel=1e-12)  # rounding
    # 0.1 rad/s for 0.1 s, less half a micro-step and the ramp's 0.03 mrad
    assert np.count_nonzero(jumps) == pytest.approx(0.01 / STEPPER.micro_step, abs=1.0)


@pytest.mark.parametrize("omega_ref", [0.01, 0.5, -3.0])
@pytest.mark.parametrize("tau_load", [0.0, 0.1])
def test_the_mean_speed_is_the_commanded_one_under_any_load_it_holds(omega_ref: float, tau_load: float) -> None:
    with Rig(DRIVE).start(omega_ref=omega_ref, tau_load=tau_load) as drive:
        drive.run(1e-3, 500)
        begin = drive["theta_m"]
        drive.run(0.1, 100)
        # the rotor swings by at most 7 mrad about the field, seen twice over 10 s
        assert (drive["theta_m"] - begin) / 10.0 == pytest.approx(omega_ref, abs=1.5e-3)
        assert drive["status"] == 0.0


@pytest.mark.parametrize("tau_load", [0.1, -0.1, 0.3])
def test_a_load_turns_the_rotor_to_where_the_field_carries_it(tau_load: float) -> None:
    expected = brentq(STEPPER.excess, -0.25 * ELECTRICAL_CYCLE, 0.25 * ELECTRICAL_CYCLE, args=(tau_load,))
    with Rig(DRIVE).start(tau_load=tau_load) as drive:
        drive.run(1e-3, 600)
        assert expected * tau_load < 0.0
        assert drive["theta_m"] == pytest.approx(expected, rel=1e-8)  # e^-20 of the swing is left
        assert drive["tau_motor"] == pytest.approx(tau_load + 0.022 * sin(4 * 50 * expected), rel=1e-8)


def loaded_slowly(drive: Rig, tau_load: float) -> None:
    """Raise the load over 0.5 s, hold it for 0.1 s, take it away and wait."""
    for tick in range(600):
        drive["tau_load"] = tau_load * min(1.0, tick / 500)
        drive.step(1e-3)
    drive["tau_load"] = 0.0
    drive.run(1e-3, 1000)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_load_below_the_holding_torque_costs_no_step(sign: float) -> None:
    with Rig(DRIVE).start() as drive:
        loaded_slowly(drive, sign * 0.39)
        assert drive["status"] == 0.0
        assert drive["theta_m"] == pytest.approx(0.0, abs=1e-8)  # the last of the swing


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_an_overload_costs_whole_electrical_cycles_and_the_status_counts_them(sign: float) -> None:
    with Rig(DRIVE).start() as drive:
        loaded_slowly(drive, sign * 0.42)
        cycles = drive["theta_m"] / ELECTRICAL_CYCLE
        assert sign * cycles < -1.0
        assert cycles == pytest.approx(round(cycles), abs=1e-6)  # the last of the swing
        assert drive["status"] == -4.0 * round(cycles)


def test_after_an_overload_the_drive_runs_on_from_where_it_caught() -> None:
    with Rig(DRIVE).start() as drive:
        loaded_slowly(drive, 0.42)
        behind = drive["theta_f"] - drive["theta_m"]
        drive["omega_ref"] = 0.5
        drive.run(1e-3, 1000)
        # the swing of the running rotor
        assert drive["theta_f"] - drive["theta_m"] == pytest.approx(behind, abs=2e-3)


@pytest.mark.parametrize(("alpha_max", "keeps_step"), [(200.0, True), (4000.0, True), (12000.0, False)])
def test_a_ramp_that_asks_more_than_the_holding_torque_loses_steps(alpha_max: float, keeps_step: bool) -> None:
    # J_m alpha_max = 0.011, 0.22 and 0.66 N m, against 0.4
    with Rig(DRIVE).start(omega_ref=60.0, omega_max=60.0, alpha_max=alpha_max) as drive:
        drive.run(1e-3, 500)
        assert (drive["status"] == 0.0) is keeps_step


def test_commanded_speed_and_acceleration_are_limited() -> None:
    with Rig(DRIVE).start(omega_ref=20.0) as drive:
        drive.step(0.02)
        assert drive["omega_g"] == pytest.approx(200.0 * 0.02, rel=1e-12)  # rounding of 400 ticks
        drive.step(0.5)
        assert drive["omega_g"] == STEPPER.omega_max


def ripple(omega_ref: float) -> float:
    """Largest deviation of the angle from its mean line, rad."""
    with Rig(DRIVE).start(omega_ref=omega_ref) as drive:
        drive.run(1e-3, 1000)
        time, angle = [], []
        for _ in range(4000):
            drive.step(50e-6)
            time.append(drive.time)
            angle.append(drive["theta_m"])
    return float(np.max(np.abs(angle - np.polyval(np.polyfit(time, angle, 1), time))))


def test_the_rotor_rings_where_micro_steps_come_at_its_own_frequency() -> None:
    stiffness = STEPPER.N_r * STEPPER.tau_hold
    resonance = sqrt(stiffness / STEPPER.J_m) / (2 * pi) * STEPPER.micro_step
    assert resonance == pytest.approx(0.095, abs=0.005)
    assert ripple(resonance) > 1.5 * ripple(3 * resonance)


def test_a_swing_has_frequency_and_damping_of_the_magnetic_spring() -> None:
    stiffness = STEPPER.N_r * (STEPPER.tau_hold + 4 * STEPPER.tau_detent)
    omega_n, decay = sqrt(stiffness / STEPPER.J_m), STEPPER.b_m / (2 * STEPPER.J_m)
    damped = sqrt(omega_n**2 - decay**2)
    with Rig(DRIVE).start(omega_m=1e-3) as drive:
        drive.step(0.02)
        expected = 1e-3 / damped * np.exp(-decay * 0.02) * np.sin(damped * 0.02)
        # small enough for the sine to be its angle: (N_r theta)^2 = 6e-9
        assert drive["theta_m"] == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("h", [50e-6, 0.25e-3, 0.5e-3])
def test_steps_of_whole_ticks_change_nothing(h: float) -> None:
    start = {"omega_ref": 0.5, "tau_load": 0.1}
    with Rig(DRIVE).start(**start) as whole, Rig(DRIVE).start(**start) as split:
        whole.run(1e-3, 50)
        split.run(h, round(0.05 / h))
        assert split["theta_f"] == whole["theta_f"]
        assert split["theta_m"] == pytest.approx(whole["theta_m"], rel=1e-9)  # rounding of the tick clock


@pytest.mark.parametrize("h", [7e-6, 33e-6, 0.13e-3])
def test_steps_that_cut_ticks_change_nothing_but_integration_error(h: float) -> None:
    steps = round(0.02 / h)
    start = {"omega_ref": 0.5, "tau_load": 0.1}
    with Rig(DRIVE).start(**start) as whole, Rig(DRIVE).start(**start) as cut:
        whole.step(steps * h)
        cut.run(h, steps)
        assert cut["theta_f"] == whole["theta_f"]
        assert cut["theta_m"] == pytest.approx(whole["theta_m"], abs=1e-8)  # 400 ticks of 4e-10 on 5 mrad
        assert cut["until_tick"] == pytest.approx(whole["until_tick"], abs=1e-15)


@pytest.mark.parametrize("deviation", [-5e-7, 5e-7])
def test_nearly_whole_ticks_do_not_make_the_clock_drift(deviation: float) -> None:
    # below what counts as rounding, 1e-6 of a tick: the surplus must add up all the same
    with Rig(DRIVE).start() as drive:
        drive.run(STEPPER.T_c * (1 + deviation), 2000)
        expected = -2000 * deviation * STEPPER.T_c % STEPPER.T_c
        assert drive["until_tick"] == pytest.approx(expected, abs=1e-15)  # 4000 roundings of 1e-20 s


def test_on_a_spring_under_a_slow_position_loop_it_keeps_step() -> None:
    # the robot's use: k_s = 1 N m/rad, a position loop of 1.5 1/s that commands every other millisecond
    with Rig(DRIVE).start() as drive:
        behind = []
        for tick in range(8000):
            if tick % 2 == 0:
                drive["omega_ref"] = 1.5 * (0.1 * sin(2 * pi * 0.125 * drive.time) - drive["theta_m"])
            drive["tau_load"] = 1.0 * drive["theta_m"]
            drive.step(1e-3)
            behind.append(drive["theta_g"] - drive["theta_m"])
        assert drive["status"] == 0.0
    # measured 5.7 mrad: 4 of load angle, a micro-step and its ringing
    assert np.max(np.abs(behind)) < 8e-3
