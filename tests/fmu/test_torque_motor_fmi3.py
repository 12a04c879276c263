"""torque_motor_fmi3.fmu: the equations of its README, integrated by scipy, and the job it has in the robot."""

from collections.abc import Callable
from math import cos, exp, hypot, sin

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from tests.conftest import examples

from .rig_fmi3 import Rig3
from .spring_sweep import mapped_loop, mapping, swept

DRIVE = "torque_motor_fmi3"
K_T, R, I_MAX, T_I = 0.25, 1.2, 2.4, 0.32e-3
RIPPLE, N_RIPPLE, TAU_COG, N_COG = 0.01, 60.0, 0.002, 120.0
J_M, B_M, TAU_C, OMEGA_C = 1.5e-4, 1e-4, 0.003, 0.05
ALPHA, T_AMB, R_TH, C_TH, T_LOW, T_HIGH = 0.0039, 25.0, 5.0, 40.0, 80.0, 110.0

Rates = Callable[[float, np.ndarray], list[float]]


def rates(tau_cmd: float, tau_load: float) -> Rates:
    """(1) to (7): rates of current, speed, angle and temperature."""

    def of(t: float, x: np.ndarray) -> list[float]:
        i, omega, theta, T_w = x
        limit = I_MAX * min(max((T_HIGH - T_w) / (T_HIGH - T_LOW), 0.0), 1.0)
        i_ref = min(max(tau_cmd / K_T, -limit), limit)
        tau_motor = K_T * i * (1 + RIPPLE * cos(N_RIPPLE * theta))
        friction = B_M * omega + TAU_C * omega / hypot(omega, OMEGA_C)
        loss = R * (1 + ALPHA * (T_w - T_AMB)) * i**2
        return [
            (i_ref - i) / T_I,
            (tau_motor - TAU_COG * sin(N_COG * theta) - friction - tau_load) / J_M,
            omega,
            (loss - (T_w - T_AMB) / R_TH) / C_TH,
        ]

    return of


def numbers(low: float, high: float) -> st.SearchStrategy[float]:
    """Multiples of a millionth of the range: 1e-175 would underflow in scipy's error estimate."""
    return st.integers(0, 10**6).map(lambda millionths: low + millionths * 1e-6 * (high - low))


# below, and well within, the range of derating: the bend of (1) between them is no place for a Runge-Kutta step
temperatures = st.sampled_from([25.0, 70.0, 90.0, 100.0])
angles = numbers(-3.0, 3.0)


def compare_with_scipy(
    tau_cmd: float, tau_load: float, omega_m: float, theta_m: float, temperature: float, h: float, omega_error: float
) -> None:
    """One step of h from a start with no current; `omega_error` (rad/s) is what the speed may be off."""
    x = [0.0, omega_m, theta_m, temperature]
    x = solve_ivp(rates(tau_cmd, tau_load), (0.0, h), x, "DOP853", rtol=1e-11, atol=1e-14).y[:, -1]
    start = {"omega_m": omega_m, "theta_m": theta_m, "temperature": temperature}
    with Rig3(DRIVE).start(tau_cmd=tau_cmd, tau_load=tau_load, **start) as drive:
        drive.step(h)
        # a Runge-Kutta step of 50 us errs by (50/320)^5/120 = 8e-7 of the current's way, at most 2.4 A, and before
        # they decay up to three such errors add up
        assert drive["current"] == pytest.approx(x[0], abs=6e-6)
        assert drive["tau_motor"] == pytest.approx(K_T * x[0] * (1 + RIPPLE * cos(N_RIPPLE * x[2])), abs=2e-6)
        assert drive["omega_m"] == pytest.approx(x[1], abs=omega_error)
        assert drive["theta_m"] == pytest.approx(x[2], abs=omega_error * h + 1e-8)
        # a Float32
        assert drive["temperature"] == pytest.approx(x[3], rel=1e-7)


@examples(30)
@given(
    tau_cmd=numbers(-0.3, 0.3),
    tau_load=numbers(-0.1, 0.1),
    speed=numbers(4.0, 8.0),
    sign=st.sampled_from([-1.0, 1.0]),
    theta_m=angles,
    temperature=temperatures,
    h=numbers(1e-5, 1e-3),
)
def test_at_speed_a_step_is_the_integral_of_the_equations(
    tau_cmd: float, tau_load: float, speed: float, sign: float, theta_m: float, temperature: float, h: float
) -> None:
    # the error of current, 1e-6 N m, at 7e3 rad/s2 per N m over the 1 ms in which it lasts
    compare_with_scipy(tau_cmd, tau_load, sign * speed, theta_m, temperature, h, omega_error=1e-5)


@examples(30)
@given(
    tau_cmd=numbers(-1.0, 1.0),
    tau_load=numbers(-0.6, 0.6),
    omega_m=numbers(-8.0, 8.0),
    theta_m=angles,
    temperature=temperatures,
    h=numbers(1e-5, 5e-3),
)
def test_through_standstill_a_step_misses_a_third_of_frictions_reversal_at_most(
    tau_cmd: float, tau_load: float, omega_m: float, theta_m: float, temperature: float, h: float
) -> None:
    # a sudden 0.6 N m crosses standstill faster than a part of 50 us lasts; Simpson's rule, which a Runge-Kutta step
    # is to a jump, puts the jump up to a third of the part aside: friction/J_m is 20 rad/s2 either way
    compare_with_scipy(tau_cmd, tau_load, omega_m, theta_m, temperature, h, omega_error=40.0 * 50e-6 / 3)


def test_the_current_follows_a_command_with_one_time_constant() -> None:
    with Rig3(DRIVE).start(tau_cmd=0.1) as drive:
        drive.step(T_I)
        assert drive["current"] == pytest.approx(0.1 / K_T * (1 - exp(-1)), rel=1e-5)  # the Runge-Kutta error
        assert drive["status"] == 0


def test_a_disabled_motor_lets_its_current_go_and_coasts() -> None:
    with Rig3(DRIVE).start(tau_cmd=0.3) as drive:
        drive.run(1e-3, 10)
        before = drive["current"]
        drive["enable"] = False
        drive.step(2 * T_I)
        assert drive["current"] == pytest.approx(before * exp(-2), rel=3e-5)  # the Runge-Kutta error
        assert drive["status"] == 3
        drive.run(1e-3, 10)
        omega_m = drive["omega_m"]
        drive.run(1e-3, 200)
        assert 0.0 < drive["omega_m"] < omega_m


def test_enabled_is_where_it_starts() -> None:
    with Rig3(DRIVE) as drive:
        assert drive["enable"] is True


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_current_limit_bounds_the_torque_and_shows_in_the_status(sign: float) -> None:
    with Rig3(DRIVE).start(tau_cmd=sign * 5.0) as drive:
        drive.run(1e-3, 10)
        assert drive["current"] == pytest.approx(sign * I_MAX, rel=1e-9)  # e^-31 is gone
        assert drive["status"] == 1


@pytest.mark.parametrize(("temperature", "share"), [(95.0, 0.5), (110.0, 0.0), (130.0, 0.0)])
def test_heat_takes_the_current_limit_away(temperature: float, share: float) -> None:
    with Rig3(DRIVE).start(tau_cmd=0.6, temperature=temperature) as drive:
        drive.run(1e-3, 10)
        # the winding cools by 0.01 K meanwhile, 4e-4 of the way from T_low to T_high
        assert drive["current"] == pytest.approx(share * I_MAX, abs=1e-3 * I_MAX)
        assert drive["status"] == 2


def test_the_cold_current_limit_can_be_held_for_ever() -> None:
    with Rig3(DRIVE).start(tau_cmd=0.6, tau_load=0.6, C_th=1e-2) as drive:
        drive.run(1e-3, 1000)
        excess = R * I_MAX**2 * R_TH
        # (7) at rest, resistance included; 20 time constants of C_th R_th = 50 ms are over
        assert drive["temperature"] == pytest.approx(T_AMB + excess / (1 - ALPHA * excess), rel=1e-6)
        assert drive["temperature"] < T_LOW


def test_cogging_holds_a_small_load_and_lets_go_of_a_larger_one() -> None:
    for tau_load, moves in ((0.5 * TAU_COG, False), (3.0 * TAU_COG, True)):
        with Rig3(DRIVE).start(tau_load=tau_load) as drive:
            drive.run(1e-3, 1000)
            assert (abs(drive["theta_m"]) > 2 * np.pi / N_COG) == moves


def test_positive_load_drives_the_shaft_backwards() -> None:
    with Rig3(DRIVE).start(tau_load=0.1) as drive:
        drive.step(1e-3)
        # friction and cogging are 3 % of the load
        assert drive["omega_m"] == pytest.approx(-0.1 / J_M * 1e-3, rel=0.03)


def test_parts_of_50_us_make_any_split_of_a_step_the_same() -> None:
    with Rig3(DRIVE).start(tau_cmd=0.2) as whole, Rig3(DRIVE).start(tau_cmd=0.2) as split:
        whole.step(2e-3)
        split.run(0.25e-3, 8)
        assert split["omega_m"] == pytest.approx(whole["omega_m"], rel=1e-12)  # rounding of the parts
        assert split["theta_m"] == pytest.approx(whole["theta_m"], rel=1e-12)


def test_the_mapped_velocity_loop_winds_the_spring() -> None:
    roles = mapping(DRIVE)
    with Rig3(DRIVE).start() as drive:
        omega_ref, omega_m = swept(drive, roles["inputs"] | roles["outputs"], mapped_loop(DRIVE), 5.0).T
    # the README's 0.0062 rad/s, from cogging and from the spring's pull on the integral
    assert np.max(np.abs(omega_ref - omega_m)) < 0.007
    # nothing rings: from tick to tick the speed changes by less than friction's reversal makes it
    assert np.max(np.abs(np.diff(omega_m))) < 0.005
