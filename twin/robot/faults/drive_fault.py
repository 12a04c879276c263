"""Faults of commands, constants and drives, and what all faults share.

A drive that cannot run as fast as commanded: the command is limited on its last way into the drive.

When a fault is active, in whole ticks that its component counts itself.

A constant of another component that changes while the robot runs.

A drive that does not do what it should: a shaft of its own between the drive and everyone who sees the shaft.
"""

from collections.abc import Mapping
from dataclasses import replace
from enum import IntEnum
from functools import cache
from typing import NamedTuple

import numpy as np

from twin.kernel.compiled.function import carray, njit
from twin.kernel.cosim.component import Component, NativeComponent, doubles_at, step_function
from twin.kernel.cosim.port import Port, memory_of, record, state, states

WINDOW = record(next=state("i8"), period="i8", onset="i8", end="i8")
"""The tick of the next step, ticks between steps, and the fault's first and first healthy tick."""

ACTIVE = Port("active", 1, "1", "whether the fault is active", "bool")


class Span(NamedTuple):
    """The ticks onset <= k < end in which a fault is active; of a continuous component, steps that begin at these."""

    onset: int
    end: int


def window(span: Span, period: int) -> tuple[int, int, int, int]:
    """A `WINDOW` before the first step of a component of `period` ticks."""
    return 0, period, span.onset, span.end


@njit(cache=True)
def tick_now(window):
    """The tick of the present step; called once per step, because it counts them."""
    k = window.next
    window.next = k + window.period
    return k


@njit(cache=True)
def within(window, k):
    """Whether the fault is active at tick `k`."""
    return window.onset <= k and k < window.end


COMMAND_MEMORY = record(window=WINDOW, size="i8", limit="f8")


@step_function(COMMAND_MEMORY)
def command_step(m, t, h, u, y):
    asked, given = carray(u, m.size), carray(y, m.size + 1)
    active = within(m.window, tick_now(m.window))
    for j in range(m.size):
        given[j] = min(max(asked[j], -m.limit), m.limit) if active else asked[j]
    given[m.size] = active
    return 0


class FaultComponent(NativeComponent):
    """Something that breaks, between the wires of a healthy system.

    Attributes:
        numbers: of its [[fault]] that its memory has, not rounded to counts or ticks: by attribute the field, and how
            many times the number is there.
    """

    numbers: Mapping[str, tuple[str, float]] = {}

    def join(self, tick: int, given: np.ndarray) -> np.ndarray:
        """Come into a run that is at the beginning of `tick`, as if it had been there all the time without acting.

        Args:
            tick: before the onset.
            given: the inputs as they are valid now.

        Returns:
            Its outputs as they are valid now.
        """
        window_ = self.memory["window"]
        window_["next"] = -(-tick // window_["period"]) * window_["period"]
        return self.passed_on(given)

    def passed_on(self, given: np.ndarray) -> np.ndarray:
        """The outputs of a fault that does not act: what it is `given`, and that it does not act."""
        return np.append(given, 0.0)


class CommandFault(FaultComponent):
    """Sampled component, every tick: commanded speeds in, the same within +-limit out while active.

    Args:
        name: of the component.
        span: when it is active.
        limit: of the drives' speed (rad/s).
        size: number of drives behind it.
    """

    def __init__(self, name: str, span: Span, limit: float, size: int):
        port = Port("omega_ref", size, "rad/s", "commanded motor speed, as far as the drive can follow")
        memory = memory_of(COMMAND_MEMORY, window=window(span, 1), size=size, limit=limit)
        super().__init__(name, (port,), (port, ACTIVE), True, command_step, memory)


VALUE = Port("value", 1, "SI", "the parameter as it holds now")
PARAMETER_MEMORY = record(window=WINDOW, address="i8", nominal="f8", chained="i8", factor="f8", added="f8", ramp="i8")
"""`chained`: another fault writes to the same address before; what it wrote is this one's nominal value."""


@step_function(PARAMETER_MEMORY, outputs=(VALUE, ACTIVE))
def parameter_step(m, t, h, u, y):
    parameter = carray(doubles_at(m.address), 1)
    k = tick_now(m.window)
    active = within(m.window, k)
    value = parameter[0] if m.chained else m.nominal
    if active:
        grown = min(1.0, (k - m.window.onset) / m.ramp) if m.ramp else 1.0
        value = value * (1.0 + grown * (m.factor - 1.0)) + grown * m.added
    parameter[0] = value
    y.value, y.active = value, active
    return 0


class ParameterFault(FaultComponent):
    """Sampled component, first in every tick: writes the value that holds from now on.

    Before the onset and after the end that is the nominal value, to the last bit.

    Args:
        name: of the component.
        span: when it is active.
        owner: the component in whose memory the parameter lies.
        parameter: what it is called there.
        cell: the parameter itself, a view (1,) of that memory.
        factor, added: what the nominal value is multiplied by, and what is added to it (SI).
        ramp: ticks in which both grow from nothing; 0: at once.
        chained: whether a fault before it in the tick writes to the same place.
    """

    def __init__(
        self,
        name: str,
        span: Span,
        owner: Component,
        parameter: str,
        cell: np.ndarray,
        factor: float,
        added: float,
        ramp: int,
        chained: bool,
    ):
        memory = memory_of(
            PARAMETER_MEMORY, window=window(span, 1), factor=factor, added=added, ramp=ramp, chained=chained
        )
        memory["address"], memory["nominal"] = cell.ctypes.data, cell[0]
        value = replace(VALUE, meaning=f"{parameter} of {owner.name}, as it holds now")
        super().__init__(name, (), (value, ACTIVE), True, parameter_step, memory, keep=owner)

    def passed_on(self, given: np.ndarray) -> np.ndarray:
        return np.array([self.memory["nominal"][0], 0.0])


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
    """The ports of a shaft, with or without an input that takes its power away."""
    return (DRIVE_SHAFT, TAU_LOAD, POWER) if monitored else (DRIVE_SHAFT, TAU_LOAD)


FAILED = 2

MEMORY = record(
    window=WINDOW, law="i8", omega="f8", **states(stop="f8", drive="f8", offset="f8", theta_m="f8", omega_m="f8")
)
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
    """The step of a shaft, with or without an input that takes its power away."""

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

    def passed_on(self, given: np.ndarray) -> np.ndarray:
        # the shaft is where the drive's own is; how fast it turns shows in the next step
        theta_m = float(given[0])
        self.memory["drive"] = self.memory["theta_m"] = theta_m
        return np.array([theta_m, 0.0, 0.0])

    def explain(self, status: int) -> str:
        return f"made {self.target} fail (drive_failure)"
