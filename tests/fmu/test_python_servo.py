"""python_servo.fmu: its firmware as its README prints it, the machine by scipy, and life inside our own process."""

import zipfile
from collections.abc import Callable
from ctypes import CFUNCTYPE, c_double, c_int, c_size_t, c_void_p, cast
from dataclasses import dataclass
from importlib.util import find_spec
from math import tanh
from pathlib import Path
from threading import Thread

import numpy as np
import pytest
from builder.drive import source_guid
from builder.python_slave import pack_python_drive
from builder.references import carry_references
from fmpy.fmi1 import FMICallException
from fmpy.fmi2 import fmi2Discard
from fmpy.validation import validate_fmu
from hypothesis import given
from hypothesis import strategies as st
from numba import njit
from scipy.integrate import solve_ivp

from tests.conftest import examples

from .rig import FMUS, Rig, described, fmu_path
from .spring_sweep import swept

DRIVE = "python_servo"
SOURCE = FMUS / DRIVE / f"{DRIVE}.py"
NAMES = {name: name for name in ("tau_load", "theta_m", "omega_m")} | {"command": "omega_ref"}


@dataclass
class Servo:
    """The servo's default parameters and its equations (1) to (7)."""

    J_m: float = 1e-4
    b_m: float = 1e-4
    tau_c: float = 0.004
    omega_c: float = 0.1
    phi: float = 0.8
    kp: float = 0.025
    ki: float = 1.56
    tau_max: float = 0.6
    slew: float = 50.0
    T_c: float = 1e-3

    omega_m: float = 0.0
    theta_m: float = 0.0
    tau_motor: float = 0.0
    x: float = 0.0

    def friction(self, omega: float) -> float:
        """(6)"""
        return self.b_m * omega + self.tau_c * tanh(omega / self.omega_c)

    def tick(self, omega_ref: float) -> None:
        """(1) to (5)"""
        e = omega_ref - self.omega_m
        w = self.phi * self.friction(omega_ref) + self.kp * e + self.x
        slewed = np.clip(w, self.tau_motor - self.slew * self.T_c, self.tau_motor + self.slew * self.T_c)
        self.tau_motor = float(np.clip(slewed, -self.tau_max, self.tau_max))
        self.x += self.ki * self.T_c * (e + (self.tau_motor - w) / self.kp)

    def run(self, omega_ref: float, tau_load: float, ticks: int) -> None:
        """Firmware and machine (7) in turn, the machine to a relative tolerance of 1e-11."""

        def rates(t: float, state: np.ndarray) -> list[float]:
            omega = float(state[0])
            return [(self.tau_motor - tau_load - self.friction(omega)) / self.J_m, omega]

        for _ in range(ticks):
            self.tick(omega_ref)
            state = [self.omega_m, self.theta_m]
            end = solve_ivp(rates, (0.0, self.T_c), state, "DOP853", rtol=1e-11, atol=1e-14).y[:, -1]
            self.omega_m, self.theta_m = float(end[0]), float(end[1])


def numbers(low: float, high: float) -> st.SearchStrategy[float]:
    """Multiples of a millionth of the range: 1e-175 would underflow in scipy's error estimate."""
    return st.integers(0, 10**6).map(lambda millionths: low + millionths * 1e-6 * (high - low))


def compared(drive: Rig, servo: Servo, omega_ref: float, tau_load: float, ticks: int) -> np.ndarray:
    """How far speed, angle and torque of the FMU are from the equations after some ticks."""
    drive["tau_load"] = tau_load
    drive.run(servo.T_c, ticks)
    servo.run(omega_ref, tau_load, ticks)
    return np.abs([drive[name] - getattr(servo, name) for name in ("omega_m", "theta_m", "tau_motor")])


@examples(10)
@given(speed=numbers(4.0, 8.0), sign=st.sampled_from([-1.0, 1.0]), tau_load=numbers(-0.1, 0.1))
def test_at_speed_the_servo_is_its_firmware_and_the_integral_of_its_machine(
    speed: float, sign: float, tau_load: float
) -> None:
    omega_ref = sign * speed
    servo = Servo(omega_m=omega_ref)
    with Rig(DRIVE).start(omega_ref=omega_ref, omega_m=omega_ref) as drive:
        # the load turns the shaft by 2.9 rad/s at most: friction keeps its sign, and the rest is linear
        assert np.max(compared(drive, servo, omega_ref, tau_load, 20)) < 1e-8


@examples(10)
@given(omega_ref=numbers(-10.0, 10.0), tau_load=numbers(-0.7, 0.7))
def test_through_standstill_the_error_is_less_than_what_friction_does_in_a_tick(
    omega_ref: float, tau_load: float
) -> None:
    servo = Servo()
    with Rig(DRIVE).start(omega_ref=omega_ref) as drive:
        # a change of friction's sign inside a tick is resolved no better: tau_c T_c/J_m = 0.04 rad/s
        assert compared(drive, servo, omega_ref, 0.0, 10)[0] < 0.04
        assert compared(drive, servo, omega_ref, tau_load, 10)[0] < 0.04


def test_the_firmware_ticks_on_its_own_clock() -> None:
    with Rig(DRIVE).start(omega_ref=0.5) as whole, Rig(DRIVE).start(omega_ref=0.5) as split:
        whole.run(1e-3, 21)
        split.run(0.7e-3, 30)
        # parts of a tick: the Runge-Kutta error of friction's turn at the start
        assert split["theta_m"] == pytest.approx(whole["theta_m"], rel=1e-4)
        assert split["tau_motor"] == pytest.approx(whole["tau_motor"], rel=1e-3)


def test_torque_rises_no_faster_than_its_slew_and_no_further_than_its_limit() -> None:
    torques = [0.0]
    with Rig(DRIVE).start(omega_ref=50.0) as drive:
        for _ in range(20):
            drive.step(1e-3)
            torques.append(drive["tau_motor"])
    assert max(np.diff(torques)) == pytest.approx(0.05, rel=1e-12)  # slew T_c, rounding
    assert max(torques) == 0.6


def test_friction_is_mostly_fed_forward() -> None:
    speeds = {}
    for phi in (0.0, 0.8):
        with Rig(DRIVE).start(omega_ref=0.3, phi=phi, ki=0.0) as drive:
            drive.run(1e-3, 300)
            speeds[phi] = drive["omega_m"]
    # without an integral what is not fed forward costs speed
    assert 0.3 - speeds[0.8] < 0.25 * (0.3 - speeds[0.0])


def test_a_load_costs_angle_once_and_speed_never() -> None:
    with Rig(DRIVE).start(omega_ref=0.5) as loaded, Rig(DRIVE).start(omega_ref=0.5) as free:
        loaded["tau_load"] = 0.1
        for drive in (loaded, free):
            drive.run(1e-3, 1000)
        assert loaded["omega_m"] == pytest.approx(0.5, rel=1e-9)  # settled
        assert free["theta_m"] - loaded["theta_m"] == pytest.approx(0.1 / Servo.ki, rel=1e-5)  # (9), settled


def test_a_slow_sweep_against_the_spring_is_followed() -> None:
    with Rig(DRIVE).start() as drive:
        omega_ref, omega_m = swept(drive, NAMES, None, 4.0).T
    # the README's 0.028 rad/s: d tau_load/dt / ki
    assert np.max(np.abs(omega_ref - omega_m)) < 0.03


def test_three_instances_share_an_interpreter_and_nothing_else() -> None:
    with Rig(DRIVE).start(omega_ref=0.4) as alone:
        alone.run(1e-3, 30)
        expected = alone.values()
    with Rig(DRIVE) as one, Rig(DRIVE) as two, Rig(DRIVE) as three:
        for drive, omega_ref in ((one, 0.4), (two, -7.0), (three, 2.0)):
            drive.start(omega_ref=omega_ref)
        for _ in range(30):
            for drive in (one, two, three):
                drive.step(1e-3)
        assert one.values() == expected


def compiled_steps(rig: Rig) -> Callable[[int, float], int]:
    """Calls fmi2DoStep by address from compiled code that has released the interpreter's lock."""
    address = cast(rig.slave.dll.fmi2DoStep, c_void_p).value
    assert address is not None
    do_step = CFUNCTYPE(c_int, c_size_t, c_double, c_double, c_int)(address)
    instance = np.uint64(rig.slave.component)

    @njit(nogil=True)
    def steps(instance: int, n: int, h: float) -> int:
        for k in range(n):
            status = do_step(instance, k * h, h, 1)
            if status != 0:
                return status
        return 0

    steps(instance, 0, 1e-3)
    return lambda n, h: steps(instance, n, h)


def test_compiled_code_without_the_interpreters_lock_may_step_it_in_any_thread() -> None:
    with Rig(DRIVE).start(omega_ref=0.4) as drive, Rig(DRIVE).start(omega_ref=0.4) as called:
        called.run(1e-3, 90)
        steps = compiled_steps(drive)
        statuses = [steps(30, 1e-3)]
        for _ in range(2):
            thread = Thread(target=lambda: statuses.append(steps(30, 1e-3)))
            thread.start()
            thread.join()
        assert statuses == [0, 0, 0]
        assert drive.values() == called.values()


def test_a_restored_or_moved_state_repeats_the_future_bit_for_bit() -> None:
    with Rig(DRIVE).start(omega_ref=0.5, tau_load=0.03) as drive, Rig(DRIVE).start() as other:
        drive.run(0.7e-3, 10)
        state = drive.slave.getFMUstate()
        drive.run(0.7e-3, 10)
        expected = drive.values()
        drive.slave.setFMUstate(state)
        moved = other.slave.deSerializeFMUstate(drive.slave.serializeFMUstate(state))
        other.slave.setFMUstate(moved)
        for rig in (drive, other):
            rig.run(0.7e-3, 10)
            assert rig.values() == expected
        drive.slave.freeFMUstate(state)
        other.slave.freeFMUstate(moved)


@pytest.mark.parametrize("h", [0.0, -1e-3, float("nan"), float("inf")])
def test_a_step_that_would_never_end_is_discarded(h: float) -> None:
    with Rig(DRIVE).start(omega_ref=0.5) as drive:
        before = drive.values()
        with pytest.raises(FMICallException) as error:
            drive.step(h)
        assert error.value.status == fmi2Discard
        assert drive.values() == before


def test_the_wrapper_lets_a_foreign_guid_pass_as_the_readme_warns() -> None:
    with Rig(DRIVE, guid="{00000000-0000-0000-0000-000000000000}").start() as drive:
        drive.step(1e-3)


def test_the_fmu_holds_this_source_and_this_readme() -> None:
    stale = "fmus/python_servo/python_servo.fmu is stale: run python fmus/build.py python_servo"
    with zipfile.ZipFile(fmu_path(DRIVE)) as archive:
        assert archive.read(f"resources/{DRIVE}.py") == SOURCE.read_bytes(), stale
        assert archive.read("documentation/README.md") == SOURCE.with_name("README.md").read_bytes(), stale
    assert described(DRIVE).guid == source_guid((SOURCE,)), stale


def test_the_description_is_valid_and_asks_for_no_tool() -> None:
    assert validate_fmu(str(fmu_path(DRIVE))) == []
    assert not described(DRIVE).coSimulation.needsExecutionTool


@pytest.mark.skipif(find_spec("pythonfmu") is None, reason="no pythonfmu: pip install .[fmus]")
def test_rebuilding_gives_the_same_bytes(tmp_path: Path) -> None:
    pack_python_drive(DRIVE, tmp_path / "scratch", tmp_path / "rebuilt.fmu")
    carry_references(DRIVE, tmp_path / "rebuilt.fmu")
    assert (tmp_path / "rebuilt.fmu").read_bytes() == fmu_path(DRIVE).read_bytes()


def test_without_friction_and_integral_the_error_shrinks_by_a_quarter_per_tick() -> None:
    with Rig(DRIVE).start(omega_ref=0.05, phi=0.0, ki=0.0, tau_c=0.0, b_m=0.0) as drive:
        for ticks in range(1, 10):
            drive.step(1e-3)
            # kp T_c/J_m = 0.25
            assert 0.05 - drive["omega_m"] == pytest.approx(0.05 * 0.75**ticks, rel=1e-12)  # rounding
