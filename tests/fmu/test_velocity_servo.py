"""velocity_servo.fmu against equations (1) to (7) of its README, integrated numerically by scipy."""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from tests.conftest import examples

from .rig import Rig


@dataclass(frozen=True)
class Servo:
    """The servo's parameters with their default values, and its equations."""

    T_m: float = 0.020
    droop: float = 0.6
    omega_max: float = 8.0
    alpha_max: float = 400.0
    tau_max: float = 0.6
    J_m: float = 1e-4

    def target(self, omega_ref: float, tau_load: float) -> float:
        """(1)"""
        return float(np.clip(omega_ref, -self.omega_max, self.omega_max)) - self.droop * tau_load

    def acceleration(self, omega_m: float, omega_ref: float, tau_load: float) -> float:
        """(2), then (3): the torque limit acts on whatever the servo asks for."""
        wanted = (self.target(omega_ref, tau_load) - omega_m) / self.T_m
        asked = min(max(wanted, -self.alpha_max), self.alpha_max)
        return min(max(asked, (-self.tau_max - tau_load) / self.J_m), (self.tau_max - tau_load) / self.J_m)


SERVO = Servo()


def up_to(limit: float) -> st.SearchStrategy[float]:
    """Numbers of at most this size, in millionths of it: 1e-175 would underflow in scipy's error estimate."""
    return st.integers(-(10**6), 10**6).map(lambda millionths: millionths * 1e-6 * limit)


# commands beyond omega_max, loads beyond tau_max and beyond tau_max + J_m alpha_max
commands = up_to(12.0)
loads = up_to(0.8)
steps = st.floats(1e-4, 0.05)
# as fast as a load of 0.8 N m drags the shaft within 20 ms
speeds = up_to(40.0)


def integrated(omega_m: float, omega_ref: float, tau_load: float, h: float) -> tuple[float, float]:
    """theta_m and omega_m after h by scipy, restarted where a limit begins or ends to act (a kink)."""

    def rates(t: float, x: np.ndarray) -> list[float]:
        return [x[1], SERVO.acceleration(x[1], omega_ref, tau_load)]

    def gap_to(limit: float) -> Callable[[float, np.ndarray], float]:
        return lambda t, x: (SERVO.target(omega_ref, tau_load) - x[1]) / SERVO.T_m - limit

    limits = [SERVO.acceleration(omega, omega_ref, tau_load) for omega in (-1e9, 1e9)]
    kinks = [gap_to(limit) for limit in limits]
    # short steps, since scipy finds the kinks by interpolation across them
    first = solve_ivp(rates, (0.0, h), [0.0, omega_m], "DOP853", events=kinks, max_step=h / 200, rtol=1e-13, atol=1e-15)
    assert first.t_events is not None
    x = np.array([0.0, omega_m])
    for start, end in pairwise(sorted({0.0, *np.concatenate(first.t_events), h})):
        x = solve_ivp(rates, (start, end), x, "DOP853", rtol=1e-13, atol=1e-15).y[:, -1]
    return float(x[0]), float(x[1])


@pytest.mark.slow
@examples(60)
@given(omega_ref=commands, tau_load=loads, omega_m=speeds, h=steps)
@example(omega_ref=0.0, tau_load=0.25, omega_m=10.0, h=0.0164)  # leaves the acceleration limit on the way
@example(omega_ref=0.0, tau_load=0.7, omega_m=35.0, h=0.01)  # torque against acceleration limit
@example(omega_ref=-8.0, tau_load=0.605, omega_m=2.0, h=0.05)  # all three phases of an overload
@example(
    omega_ref=6.734388, tau_load=0.4489592, omega_m=22.44796, h=0.039755918106421435
)  # slows down to less than half
def test_a_step_is_the_integral_of_the_equations(omega_ref: float, tau_load: float, omega_m: float, h: float) -> None:
    theta_m, omega_end = integrated(omega_m, omega_ref, tau_load, h)
    with Rig("velocity_servo").start(omega_m=omega_m, omega_ref=omega_ref, tau_load=tau_load) as drive:
        drive.step(h)
        # ten times scipy's tolerance, relative to the fastest speed at the beginning or the end
        scale = 1.0 + max(abs(omega_m), abs(omega_end))
        assert drive["theta_m"] == pytest.approx(theta_m, rel=0, abs=1e-12 * scale)
        assert drive["omega_m"] == pytest.approx(omega_end, rel=0, abs=1e-12 * scale)
        tau_motor = tau_load + SERVO.J_m * SERVO.acceleration(omega_end, omega_ref, tau_load)
        assert drive["tau_motor"] == pytest.approx(tau_motor, abs=1e-12)


@given(omega_ref=commands, tau_load=loads, omega_m=speeds, h=steps, parts=st.integers(2, 9))
def test_splitting_a_step_changes_nothing(
    omega_ref: float, tau_load: float, omega_m: float, h: float, parts: int
) -> None:
    start = {"omega_m": omega_m, "omega_ref": omega_ref, "tau_load": tau_load}
    with Rig("velocity_servo").start(**start) as whole, Rig("velocity_servo").start(**start) as split:
        whole.step(h)
        split.run(h / parts, parts)
        # a few roundings per part
        scale = 1.0 + abs(whole["omega_m"])
        assert split["theta_m"] == pytest.approx(whole["theta_m"], rel=0, abs=2e-14 * scale)
        assert split["omega_m"] == pytest.approx(whole["omega_m"], rel=0, abs=2e-14 * scale)


def test_command_step_is_a_first_order_lag() -> None:
    with Rig("velocity_servo").start(omega_ref=0.5) as drive:
        drive.step(SERVO.T_m)
        assert drive["omega_m"] == pytest.approx(0.5 * (1.0 - np.exp(-1.0)), rel=1e-14)  # rounding


@pytest.mark.parametrize("tau_load", [0.05, -0.1])
def test_load_slows_the_shaft_by_droop_times_torque(tau_load: float) -> None:
    with Rig("velocity_servo").start(omega_ref=0.5, tau_load=tau_load) as drive:
        drive.run(1e-3, 1000)
        assert drive["omega_m"] == pytest.approx(0.5 - SERVO.droop * tau_load, rel=1e-12)  # e^-50 is gone
        assert drive["tau_motor"] == pytest.approx(tau_load, rel=1e-12)


def test_speed_beyond_the_limit_is_not_followed() -> None:
    with Rig("velocity_servo").start(omega_ref=20.0) as drive:
        drive.run(1e-3, 1000)
        assert drive["omega_m"] == pytest.approx(SERVO.omega_max, rel=1e-12)


def test_acceleration_limit_holds_from_rest() -> None:
    with Rig("velocity_servo").start(omega_ref=8.0, alpha_max=100.0) as drive:
        drive.step(0.05)
        assert drive["omega_m"] == pytest.approx(100.0 * 0.05, rel=1e-14)
        assert drive["theta_m"] == pytest.approx(0.5 * 100.0 * 0.05**2, rel=1e-14)


def test_torque_limit_holds_under_load() -> None:
    with Rig("velocity_servo").start(omega_ref=8.0, tau_load=0.58, droop=0.0) as drive:
        drive.step(0.01)
        # 0.02 N m are left for the inertia of 1e-4 kg m2
        assert drive["omega_m"] == pytest.approx(200.0 * 0.01, rel=1e-12)
        assert drive["tau_motor"] == pytest.approx(SERVO.tau_max, rel=1e-14)


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("tau_load", [0.62, 1.0])
def test_load_above_the_torque_limit_drags_the_shaft_backwards(tau_load: float, sign: float) -> None:
    with Rig("velocity_servo").start(omega_ref=sign * 8.0, tau_load=sign * tau_load) as drive:
        drive.run(1e-3, 100)
        alpha = (SERVO.tau_max - tau_load) / SERVO.J_m
        assert drive["omega_m"] == pytest.approx(sign * alpha * 0.1, rel=1e-12)
        assert drive["tau_motor"] == pytest.approx(sign * SERVO.tau_max, rel=1e-14)
