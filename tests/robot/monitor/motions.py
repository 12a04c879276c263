"""What a sound robot tells its monitor while it moves and presses as told, and how a monitor takes it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tests.laws.runs import ComponentStepper, shipped
from twin.robot.assembly.build import monitor_belief, monitor_limits
from twin.robot.mechanism.geometry import geometry_of
from twin.robot.mechanism.kinematics import jacobian, joint_angles
from twin.robot.mechanism.statics import Masses, environment_force
from twin.robot.monitor.component import MonitorBelief, SafetyMonitor
from twin.robot.monitor.limits import Limits
from twin.robot.monitor.limits import Monitor as Section
from twin.robot.monitor.reasons import Trip

BELIEF = monitor_belief(shipped().robot)
GEOMETRY = geometry_of(BELIEF)
MASSES = Masses(BELIEF.m_a, BELIEF.m_b, BELIEF.m_p, 0.0)
LIMITS: Limits = monitor_limits(Section(), speed_limit=8.0)
DT = 2e-3
"""Between two encoder messages, each of which the monitor looks at (s)."""

COUNT_M, COUNT_L, SAMPLE, OMEGA_REF = slice(0, 3), slice(3, 6), 6, slice(7, 10)
"""Columns of the inputs."""


def angles(p_B, F_ee_B) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Motor and joint angles (n, 3), rad, of the robot that rests at `p_B` (n, 3) and exerts `F_ee_B` (n, 3)."""
    theta_l = joint_angles(GEOMETRY, p_B)
    still = [environment_force(GEOMETRY, MASSES, t, p, np.zeros(3)) for t, p in zip(theta_l, p_B, strict=True)]
    tau_l = np.linalg.solve(np.swapaxes(jacobian(GEOMETRY, p_B), -1, -2), (F_ee_B - np.array(still))[..., None])[..., 0]
    deflection = tau_l / (BELIEF.k_s * BELIEF.N * BELIEF.eta)
    return BELIEF.N * theta_l + deflection + np.sign(deflection) * BELIEF.backlash, theta_l


def counts(theta_m, theta_l) -> NDArray[np.float64]:
    """Motor and joint counts (n, 6), rounded to the nearest."""
    motor, joint = theta_m * BELIEF.motor_counts, theta_l * BELIEF.joint_counts
    return np.round(np.concatenate([motor, joint], axis=-1) / (2.0 * np.pi))


def told(theta_m, theta_l) -> NDArray[np.float64]:
    """Inputs of the monitor (n, 10) from a robot at these angles (n, 3) whose drives do exactly as commanded."""
    omega_ref = np.diff(theta_m, axis=0, append=theta_m[-1:]) / DT
    sample = np.arange(len(theta_m), dtype=float)[:, None]
    return np.concatenate([counts(theta_m, theta_l), sample, omega_ref], axis=1)


def inputs(p_B, F_ee_B=(0.0, 0.0, 0.0)) -> NDArray[np.float64]:
    """Inputs of the monitor (n, 10) from a sound robot that moves through `p_B` and presses with `F_ee_B`, (n, 3)."""
    p_B, F_ee_B = np.broadcast_arrays(np.asarray(p_B, dtype=float), np.asarray(F_ee_B, dtype=float))
    return told(*angles(p_B, F_ee_B))


def standing(n: int, p_B=(0.01, -0.015, -0.1), F_z: float = 0.0) -> NDArray[np.float64]:
    """Inputs (n, 10) from a robot that stands still and presses down with `F_z` (N)."""
    return inputs(np.tile(p_B, (n, 1)), (0.0, 0.0, -F_z))


def ramp(n: int, start, end) -> NDArray[np.float64]:
    """(n, 3) from `start` to `end`, evenly."""
    share = np.linspace(0.0, 1.0, n)[:, None]
    return (1.0 - share) * np.array(start, dtype=float) + share * np.array(end, dtype=float)


@dataclass(frozen=True)
class Watched:
    """What a monitor made of its inputs.

    Attributes:
        outputs: by port, (n, size) or (n,). trip: as latched. power_off: tick at which the power went off.
    """

    outputs: dict[str, NDArray[np.float64]]
    trip: Trip | None
    power_off: int | None


def latched(trip: Trip | None) -> Trip:
    """The trip, for a monitor that has to have one."""
    assert trip is not None, "did not trip"
    return trip


def watched(u: NDArray[np.float64], limits: Limits = LIMITS, belief: MonitorBelief = BELIEF) -> Watched:
    """A new monitor, evaluated once per row of `u` (n, 10)."""
    monitor = SafetyMonitor(belief, limits)
    sampled = ComponentStepper(monitor)
    rows = [sampled.outputs_by_port(row, k * DT, DT) for k, row in enumerate(u)]
    outputs = {name: np.array([row[name] for row in rows]).squeeze() for name in rows[0]}
    return Watched(outputs, monitor.trip, monitor.power_off_tick)
