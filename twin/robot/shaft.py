"""Motor shafts without a driving motor: behind a failed drive, and behind an unpowered one.

A faulty drive has a separate shaft between it and all readers. The shaft of an unpowered drive is held by the friction
of its gears and by its brake, if it has one: they hold a load up to their torque, and yield to more.
"""

from enum import IntEnum
from functools import cache
from typing import NamedTuple

import numpy as np

from twin.kernel.compiled.function import njit
from twin.kernel.cosim.component import NativeComponent, step_function
from twin.kernel.cosim.port import Port, memory_of, record, record_of, states
from twin.kernel.settings import fields_of_form
from twin.robot.faults import ACTIVE_PORT, POWER_PORT, WINDOW_RECORD, FaultComponent, Span, is_active, tick_now, window

SHAFT_INERTIA = 1e-4
"""Inertia of rotor, coupling and spring hub (kg m2), as in the velocity_servo, pmsm_foc and python_servo drives of
fmus/."""
SHAFT_FRICTION = 1e-4
"""Bearing friction of a shaft without current (N m s/rad), as in python_servo."""
DRIVE_SHAFT = Port("theta_m", 1, "rad", "angle of the drive's own shaft")
TAU_LOAD = Port("tau_load", 1, "N m", "torque the spring asks of the shaft")
SHAFT_OUTPUTS = (
    Port("theta_m", 1, "rad", "motor angle as it really is"),
    Port("omega_m", 1, "rad/s", "motor speed as it really is"),
    ACTIVE_PORT,
)
FAILED_STATUS = 2
SHAFT_MEMORY = record(
    window=WINDOW_RECORD, law="i8", omega="f8", **states(**fields_of_form("f8", "stop drive offset theta_m omega_m"))
)
"""`omega`: speed of a runaway (rad/s). `stop`: maximum angle of a jammed shaft. `drive`: previous angle of the drive's
own shaft. `offset`: angle of the real shaft relative to it. `theta_m`, `omega_m`: the real shaft."""
BRAKE_PORT = Port("brake", 1, "1", "whether brakes with a line of their own may close", "bool")
UNPOWERED_INPUTS = (DRIVE_SHAFT, TAU_LOAD, POWER_PORT, BRAKE_PORT)
UNPOWERED_OUTPUTS = SHAFT_OUTPUTS[:2]


class DriveLaw(IntEnum):
    """Motion of a motor shaft whose drive is faulty; names as in an experiment's file, in capitals."""

    DRIVE_RUNAWAY = 0
    DRIVE_FREEWHEEL = 1
    DRIVE_DEAD = 2
    JOINT_JAM = 3
    DRIVE_FAILURE = 4


def shaft_inputs(monitored: bool) -> tuple[Port, ...]:
    """Return the input ports of a faulty drive's shaft, with or without a power signal."""
    return (DRIVE_SHAFT, TAU_LOAD, POWER_PORT) if monitored else (DRIVE_SHAFT, TAU_LOAD)


@njit(cache=True)
def free_shaft(theta_m, omega_m, tau_load, h):
    """Return angle and speed (theta_m, omega_m) of a freely turning motor shaft after `h` seconds.

    J d omega_m/dt = -b omega_m - tau_load, with friction implicit and the angle moved by the new speed (symplectic
    Euler): `tau_load` is the spring's torque at the old angle, and this scheme keeps an oscillator of k_s on J stable
    for h < 2 sqrt(J/k_s), 20 ms here; the exact solution with the torque held would gain energy in every turn (Hairer,
    Lubich, Wanner, Geometric Numerical Integration, section I.1.2).
    """
    omega_m = (omega_m - h * tau_load / SHAFT_INERTIA) / (1.0 + h * SHAFT_FRICTION / SHAFT_INERTIA)
    return theta_m + h * omega_m, omega_m


@njit(cache=True)
def turn_shaft(m, drive, tau_load, power, h):
    """Turn the shaft behind a faulty drive for `h` seconds; `drive` is the new angle of the drive's own shaft."""
    before = m.theta_m
    if m.law == DriveLaw.DRIVE_FREEWHEEL:
        m.theta_m, m.omega_m = free_shaft(m.theta_m, m.omega_m, tau_load, h)
        return
    if m.law == DriveLaw.DRIVE_RUNAWAY and power != 0.0:
        m.theta_m += h * m.omega
    if m.law == DriveLaw.JOINT_JAM:
        m.theta_m = min(m.theta_m + drive - m.drive, m.stop)
    m.omega_m = (m.theta_m - before) / h


@cache
def make_shaft_step(monitored):
    """Compile the step function of a faulty drive's shaft, with or without a power signal."""

    @step_function(SHAFT_MEMORY, shaft_inputs(monitored), SHAFT_OUTPUTS)
    def step(m, t, h, u, y):
        drive = u.theta_m
        power = 1.0
        if monitored:
            power = u.power
        k = tick_now(m.window)
        active = is_active(m.window, k)
        if active and m.law == DriveLaw.DRIVE_FAILURE:
            return FAILED_STATUS
        if active:
            if k == m.window.onset:
                m.stop = m.theta_m
            turn_shaft(m, drive, u.tau_load, power, h)
            m.offset = m.theta_m - drive
        else:
            m.omega_m = (drive + m.offset - m.theta_m) / h
            m.theta_m = drive + m.offset
        m.drive = drive
        y.theta_m, y.omega_m, y.active = m.theta_m, m.omega_m, active
        return 0

    return step


class DriveFault(FaultComponent):
    """Continuous component behind a faulty drive: the drive's own shaft in, the joint's real shaft out.

    The step that begins at tick k is faulty for onset <= k < end. Afterwards the shaft follows the drive's motion again
    from its present angle: without a jump, with a permanent offset. The drive itself is unaffected.

    Args:
        omega: speed of a runaway (rad/s).
        theta_m: angle of the drive's shaft before tick 0 (rad).
        monitored: whether there is an input `power`; without it the power is always on.
        period: period of the drive, in ticks.
        label, target: displayed names of the fault and its drive.
    """

    def __init__(
        self,
        name: str,
        span: Span,
        law: DriveLaw,
        omega: float,
        theta_m: float,
        monitored: bool,
        period: int,
        label: str,
        target: str,
    ):
        memory = memory_of(
            SHAFT_MEMORY, window=window(span, period), law=law, omega=omega, drive=theta_m, theta_m=theta_m
        )
        initial = np.array([theta_m, 0.0, 0.0])
        super().__init__(
            name, shaft_inputs(monitored), SHAFT_OUTPUTS, False, make_shaft_step(monitored), memory, initial, period
        )
        self.label, self.target = label, target

    def idle_outputs(self, given: np.ndarray) -> np.ndarray:
        # the shaft is at the drive's angle; its speed follows in the next step
        theta_m = float(given[0])
        self.memory["drive"] = self.memory["theta_m"] = theta_m
        return np.array([theta_m, 0.0, 0.0])

    def explain(self, status: int) -> str:
        return f"made {self.target} fail (drive_failure)"


class UnpoweredParameters(NamedTuple):
    """Parameters of an unpowered shaft, SI.

    Attributes:
        holding, brake: maximum holding torque of gears and bearings, and additional torque of a brake (N m).
        own_line: whether the monitor controls the brake directly rather than through the power.
        J, b: inertia (kg m2) and viscous friction (N m s/rad).
    """

    holding: float
    brake: float
    own_line: int
    J: float
    b: float


UNPOWERED_MEMORY = record(
    unpowered=record_of(UnpoweredParameters), **states(off="i8", **fields_of_form("f8", "theta_m omega_m"))
)
"""`off`: whether the power has been cut, which is permanent."""


@njit(cache=True)
def braked_shaft(u, theta_m, omega_m, tau_load, hold, h):
    """Return angle and speed (theta_m, omega_m) after `h` seconds of an unpowered shaft with dry friction.

    J d omega_m/dt = -b omega_m - tau_load - hold sign(omega_m): as `free_shaft`, with a friction that removes as much
    speed as it can in `h`, at most all of it (implicit; Moreau's time stepping for Coulomb friction).
    """
    omega_m = (omega_m - h * tau_load / u.J) / (1.0 + h * u.b / u.J)
    most = h * hold / u.J
    omega_m = max(0.0, omega_m - most) if omega_m > 0.0 else min(0.0, omega_m + most)
    return theta_m + h * omega_m, omega_m


@step_function(UNPOWERED_MEMORY, UNPOWERED_INPUTS, UNPOWERED_OUTPUTS)
def unpowered_step(m, t, h, u, y):
    if u.power == 0.0:
        m.off = 1
    if m.off:
        closed = u.brake != 0.0 or m.unpowered.own_line == 0
        hold = m.unpowered.holding + (m.unpowered.brake if closed else 0.0)
        m.theta_m, m.omega_m = braked_shaft(m.unpowered, m.theta_m, m.omega_m, u.tau_load, hold, h)
    else:
        m.omega_m = (u.theta_m - m.theta_m) / h
        m.theta_m = u.theta_m
    y.theta_m, y.omega_m = m.theta_m, m.omega_m
    return 0


class UnpoweredShaft(NativeComponent):
    """Continuous component behind a drive and its faults: passes the shaft on until the power is cut for good.

    `theta_m` is the angle before tick 0 (rad).
    """

    def __init__(self, name: str, unpowered: UnpoweredParameters, theta_m: float):
        memory = memory_of(UNPOWERED_MEMORY, unpowered=tuple(unpowered), theta_m=theta_m)
        initial = np.array([theta_m, 0.0])
        super().__init__(name, UNPOWERED_INPUTS, UNPOWERED_OUTPUTS, False, unpowered_step, memory, initial)
