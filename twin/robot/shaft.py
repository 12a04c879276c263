"""Shafts that no drive turns: behind a drive that fails, and behind one that has lost its power.

A drive that does not do what it should has a shaft of its own between it and all that see the shaft. One that has lost
its power is held by the friction of its gears and by its brake, if it has one: they hold a load up to their torque, and
yield to more.
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
"""Of rotor, coupling and spring hub (kg m2), as the velocity_servo, pmsm_foc and python_servo drives of fmus/ have."""
SHAFT_FRICTION = 1e-4
"""Of the bearings of a shaft without current (N m s/rad), as python_servo has."""
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
"""`omega`: speed of a runaway (rad/s). `stop`: angle beyond which a jam lets nothing turn. `drive`: where the drive's
own shaft was. `offset`: how far the real shaft is from it. `theta_m`, `omega_m`: the real shaft."""
BRAKE_PORT = Port("brake", 1, "1", "whether brakes with a line of their own may close", "bool")
UNPOWERED_INPUTS = (DRIVE_SHAFT, TAU_LOAD, POWER_PORT, BRAKE_PORT)
UNPOWERED_OUTPUTS = SHAFT_OUTPUTS[:2]


class DriveLaw(IntEnum):
    """How the shaft moves while the fault is active; by the names in an experiment's file, in capitals."""

    DRIVE_RUNAWAY = 0
    DRIVE_FREEWHEEL = 1
    DRIVE_DEAD = 2
    JOINT_JAM = 3
    DRIVE_FAILURE = 4


# plain integers: what compiled code compares with
_RUNAWAY_LAW, _FREEWHEEL_LAW, _DEAD_LAW, _JAM_LAW, _FAILURE_LAW = (int(law) for law in DriveLaw)


def shaft_inputs(monitored: bool) -> tuple[Port, ...]:
    """The ports of a shaft, with or without an input that takes its power away."""
    return (DRIVE_SHAFT, TAU_LOAD, POWER_PORT) if monitored else (DRIVE_SHAFT, TAU_LOAD)


@njit(cache=True)
def free_shaft(theta_m, omega_m, tau_load, h):
    """(theta_m, omega_m) after `h` seconds of a shaft that nothing drives.

    J d omega_m/dt = -b omega_m - tau_load, with friction implicit and the angle moved by the new speed (symplectic
    Euler): `tau_load` is the spring's torque at the old angle, and so stepped an oscillator of k_s on J is stable for
    h < 2 sqrt(J/k_s), 20 ms here; the exact solution with the torque held would gain energy in every turn (Hairer,
    Lubich, Wanner, Geometric Numerical Integration, section I.1.2).
    """
    omega_m = (omega_m - h * tau_load / SHAFT_INERTIA) / (1.0 + h * SHAFT_FRICTION / SHAFT_INERTIA)
    return theta_m + h * omega_m, omega_m


@njit(cache=True)
def turn_shaft(m, drive, tau_load, power, h):
    """Turn the shaft of `m` over a step in which the fault is active; `drive` is where the drive's own has gone."""
    before = m.theta_m
    if m.law == _FREEWHEEL_LAW:
        m.theta_m, m.omega_m = free_shaft(m.theta_m, m.omega_m, tau_load, h)
        return
    if m.law == _RUNAWAY_LAW and power != 0.0:
        m.theta_m += h * m.omega
    if m.law == _JAM_LAW:
        m.theta_m = min(m.theta_m + drive - m.drive, m.stop)
    m.omega_m = (m.theta_m - before) / h


@cache
def make_shaft_step(monitored):
    """The step of a shaft, with or without an input that takes its power away."""

    @step_function(SHAFT_MEMORY, shaft_inputs(monitored), SHAFT_OUTPUTS)
    def step(m, t, h, u, y):
        drive = u.theta_m
        power = 1.0
        if monitored:
            power = u.power
        k = tick_now(m.window)
        active = is_active(m.window, k)
        if active and m.law == _FAILURE_LAW:
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
    """Continuous component right behind a drive: the drive's shaft in, the shaft that the joint really has out.

    The step that begins at tick k is faulty for onset <= k < end. Afterwards the drive's motion is followed again from
    where the shaft then is: nothing jumps, an offset stays. The drive itself knows of nothing.

    Args:
        name: of the component.
        span: when it is active.
        law: how the shaft moves.
        omega: speed of a runaway (rad/s).
        theta_m: angle of the drive's shaft before tick 0 (rad).
        monitored: whether there is an input `power`; without it the power is always on.
        period: of the drive, in ticks.
        label, target: what people know the fault and its drive by.
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
        # the shaft is where the drive's own is; how fast it turns shows in the next step
        theta_m = float(given[0])
        self.memory["drive"] = self.memory["theta_m"] = theta_m
        return np.array([theta_m, 0.0, 0.0])

    def explain(self, status: int) -> str:
        return f"made {self.target} fail (drive_failure)"


class UnpoweredParameters(NamedTuple):
    """What a shaft without power does, SI.

    Attributes:
        holding: torque up to which gears and bearings hold it (N m).
        brake: torque of a brake, on top (N m).
        own_line: whether the brake closes when the monitor says so, and not with the power.
        J: inertia of the shaft (kg m2).
        b: viscous friction (N m s/rad).
    """

    holding: float
    brake: float
    own_line: int
    J: float
    b: float


UNPOWERED_MEMORY = record(
    unpowered=record_of(UnpoweredParameters), **states(off="i8", **fields_of_form("f8", "theta_m omega_m"))
)
"""`off`: whether the power has gone, which lasts."""


@njit(cache=True)
def braked_shaft(u, theta_m, omega_m, tau_load, hold, h):
    """(theta_m, omega_m) after `h` seconds of a shaft with dry friction `hold` (N m) and nothing that drives it.

    J d omega_m/dt = -b omega_m - tau_load - hold sign(omega_m): as `free_shaft`, and the friction takes away as much
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
    """Continuous component behind a drive and what breaks it: the shaft as it is, until the power goes for good.

    Args:
        name: of the component.
        unpowered: what it does then.
        theta_m: angle before tick 0 (rad).
        period: of the drive, in ticks.
    """

    def __init__(self, name: str, unpowered: UnpoweredParameters, theta_m: float, period: int = 1):
        memory = memory_of(UNPOWERED_MEMORY, unpowered=tuple(unpowered), theta_m=theta_m)
        initial = np.array([theta_m, 0.0])
        super().__init__(name, UNPOWERED_INPUTS, UNPOWERED_OUTPUTS, False, unpowered_step, memory, initial, period)
