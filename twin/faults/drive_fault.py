"""A drive that does not do what it should: a shaft of its own between the drive and everyone who sees the shaft."""

from enum import IntEnum
from functools import cache

import numpy as np

from twin.compiled.function import njit
from twin.cosim.native import step_function
from twin.cosim.port import Port, memory_of, record
from twin.faults.command_fault import ACTIVE, WINDOW, FaultComponent, Span, tick_now, window, within


class DriveLaw(IntEnum):
    """How the shaft moves while the fault is active; by the names in an experiment's file, in capitals."""

    DRIVE_RUNAWAY = 0
    DRIVE_FREEWHEEL = 1
    DRIVE_DEAD = 2
    JOINT_JAM = 3
    DRIVE_FAILURE = 4


# plain integers: what compiled code compares with
_RUNAWAY, _FREEWHEEL, _DEAD, _JAM, _FAILURE = (int(law) for law in DriveLaw)

INERTIA = 1e-4
"""Of rotor, coupling and spring hub (kg m2), as the velocity_servo, pmsm_foc and python_servo drives of fmus/ have."""
FRICTION = 1e-4
"""Of the bearings of a shaft without current (N m s/rad), as python_servo has."""

DRIVE_SHAFT = Port("theta_m", 1, "rad", "angle of the drive's own shaft")
TAU_LOAD = Port("tau_load", 1, "N m", "torque the spring asks of the shaft")
POWER = Port("power", 1, "1", "whether the drives may have power", "bool")
OUTPUTS = (
    Port("theta_m", 1, "rad", "motor angle as it really is"),
    Port("omega_m", 1, "rad/s", "motor speed as it really is"),
    ACTIVE,
)


def inputs(monitored: bool) -> tuple[Port, ...]:
    """The ports of a shaft whose power somebody may take away, or nobody."""
    return (DRIVE_SHAFT, TAU_LOAD, POWER) if monitored else (DRIVE_SHAFT, TAU_LOAD)


FAILED = 2

MEMORY = record(window=WINDOW, law="i8", omega="f8", stop="f8", drive="f8", offset="f8", theta_m="f8", omega_m="f8")
"""`omega`: speed of a runaway (rad/s). `stop`: angle beyond
which a jam lets nothing turn. `drive`: where the drive's own shaft was. `offset`: how far the real shaft is from it.
`theta_m`, `omega_m`: the real shaft."""


@njit(cache=True)
def free_shaft(theta_m, omega_m, tau_load, h):
    """(theta_m, omega_m) after `h` seconds of a shaft that nothing drives.

    J d omega_m/dt = -b omega_m - tau_load, with friction implicit and the angle moved by the new speed (symplectic
    Euler): `tau_load` is the spring's torque at the old angle, and so stepped an oscillator of k_s on J is stable for
    h < 2 sqrt(J/k_s), 20 ms here; the exact solution with the torque held would gain energy in every turn (Hairer,
    Lubich, Wanner, Geometric Numerical Integration, section I.1.2).
    """
    omega_m = (omega_m - h * tau_load / INERTIA) / (1.0 + h * FRICTION / INERTIA)
    return theta_m + h * omega_m, omega_m


@njit(cache=True)
def move(m, drive, tau_load, power, h):
    """Turn the shaft of `m` over a step in which the fault is active; `drive` is where the drive's own has gone."""
    before = m.theta_m
    if m.law == _FREEWHEEL:
        m.theta_m, m.omega_m = free_shaft(m.theta_m, m.omega_m, tau_load, h)
        return
    if m.law == _RUNAWAY and power != 0.0:
        m.theta_m += h * m.omega
    if m.law == _JAM:
        m.theta_m = min(m.theta_m + drive - m.drive, m.stop)
    m.omega_m = (m.theta_m - before) / h


@cache
def step_of(monitored):
    """The step of a shaft whose power somebody may take away, or nobody."""

    @step_function(MEMORY, inputs(monitored), OUTPUTS)
    def step(m, t, h, u, y):
        drive = u.theta_m
        power = 1.0
        if monitored:
            power = u.power
        k = tick_now(m.window)
        active = within(m.window, k)
        if active and m.law == _FAILURE:
            return FAILED
        if active:
            if k == m.window.onset:
                m.stop = m.theta_m
            move(m, drive, u.tau_load, power, h)
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
        memory = memory_of(MEMORY, window=window(span, period), law=law, omega=omega, drive=theta_m, theta_m=theta_m)
        initial = np.array([theta_m, 0.0, 0.0])
        super().__init__(name, inputs(monitored), OUTPUTS, False, step_of(monitored), memory, initial, period)
        self.label, self.target = label, target

    def explain(self, status: int) -> str:
        return f"made {self.target} fail (drive_failure)"
