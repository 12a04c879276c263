"""What can be asked of the robot, of the twin's and of the one in the engine, with the same springs."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from twin.robot.mechanism.geometry import LEG_COS, LEG_SIN, NO_ANCHOR, Geometry
from twin.robot.mechanism.kinematics import distal_volume, jacobian, joint_angles, position, transmission_sines
from twin.robot.mechanism.statics import G_ACCELERATION, arm_gravity_torque, environment_force, leg_force
from twin.robot.mechanism.workspace import is_reachable
from twin.robot.plant.component import NO_MOTION
from twin.robot.plant.contact import apex_frame
from twin.robot.plant.dynamics import PlantParameters, acceleration, joint_torque, spring_deflection
from validation.engine.bodies import initial_angle
from validation.engine.constrained import Numbers
from validation.engine.mechanism import Mechanism

WEIGHTLESS = "rods, weightless"
CLEAR = 0.1
"""How far from a singularity, as `twin.robot.mechanism.kinematics` and `holding` measure it: 0 there, at most 1."""
WAY = 21
"""Points of a way that are looked at."""


@dataclass(frozen=True)
class State:
    """Of the robot in the air.

    Attributes:
        p_B, v_B: of the platform (m, m/s), (3,).
        theta_m: motor angles (rad), (3,).
        tau_l: torques of the springs with which it is held at rest (N m), (3,).
    """

    p_B: Numbers
    v_B: Numbers
    theta_m: Numbers
    tau_l: Numbers


class Robot(Protocol):
    """A robot that can be asked."""

    def answers(self, state: State) -> dict[str, Numbers]:
        """Numbers by what they are; of each robot the same."""


class TwinsRobot:
    """As `twin.robot.plant` and `twin.robot.mechanism` have it.

    Args:
        parameters: of it; what it presses on is left out.
    """

    def __init__(self, parameters: PlantParameters):
        self._parameters = parameters._replace(K=0.0)
        self._geometry = Geometry(parameters.a, parameters.b, parameters.l_a, parameters.l_b)

    def answers(self, state: State) -> dict[str, Numbers]:
        c, p = self._parameters, tuple(state.p_B)
        theta, J = joint_angles(self._geometry, state.p_B), jacobian(self._geometry, state.p_B)
        hanging = np.array([arm_gravity_torque(c, c, angle) for angle in theta])
        alone = np.array([leg_force(c, leg, theta[leg], *p, state.tau_l[leg]) for leg in range(3)])
        held = np.array([leg_force(c, leg, theta[leg], *p, (state.tau_l + hanging)[leg]) for leg in range(3)])
        held[:, 2] -= c.m_b / 2.0 * G_ACCELERATION
        return {
            "joint angles": theta,
            "Jacobian": J,
            "mass matrix": self._mass(state.p_B, theta, J),
            "gravity": np.array(environment_force(c, c, theta, p, NO_MOTION)),
            "acceleration": self._accelerated(c, state.p_B, state.v_B, state.theta_m),
            WEIGHTLESS: alone,
            "rods": held,
            "force on what it presses": np.array(environment_force(c, c, theta, p, state.tau_l)),
        }

    def _mass(self, p_B: Numbers, theta: Numbers, J: Numbers) -> Numbers:
        """From what torques of 1 N m do to the acceleration: dv/dt = M^-1 (J^T tau_l + ...)."""
        c = self._parameters._replace(backlash=0.0)
        wound = np.eye(3) / (c.k_s * c.N * c.eta)
        rest = self._accelerated(c, p_B, np.zeros(3), c.N * theta)
        caused = [self._accelerated(c, p_B, np.zeros(3), c.N * theta + more) - rest for more in wound]
        return J.T @ np.linalg.inv(np.array(caused).T)

    @staticmethod
    def _accelerated(c: PlantParameters, p_B: Numbers, v_B: Numbers, theta_m: Numbers) -> Numbers:
        state = tuple(p_B), tuple(v_B), (0.0, 0.0), tuple(theta_m)
        return np.array(acceleration.dispatcher(c, *state, NO_MOTION, NO_MOTION, apex_frame(c), NO_ANCHOR)[0])


class EnginesRobot:
    """As the engine has its bodies, with the twin's springs.

    Args:
        mechanism: of the engine.
        parameters: of the springs.
    """

    def __init__(self, mechanism: Mechanism, parameters: PlantParameters):
        self._mechanism, self._parameters = mechanism, parameters

    def answers(self, state: State) -> dict[str, Numbers]:
        mechanism = self._mechanism
        mechanism.restart()
        mechanism.move(state.p_B)
        moving = mechanism.equations(state.v_B)
        tau_l = spring_torques(self._parameters, state.theta_m, mechanism.theta_l, mechanism.omega_l)
        accelerated = moving.acceleration(mechanism.on_arms(tau_l))
        still = mechanism.equations(np.zeros(3))
        weightless = replace(still, bias=np.zeros_like(still.bias))
        torques = mechanism.on_arms(state.tau_l)
        held, holding = still.reactions(torques, np.zeros_like(torques))
        alone, _ = weightless.reactions(torques, np.zeros_like(torques))
        return {
            "joint angles": mechanism.theta_l,
            "Jacobian": still.directions[mechanism.arms, :3],
            "mass matrix": still.mass(3),
            "gravity": -(still.directions.T @ still.bias)[:3],
            "acceleration": accelerated[mechanism.platform],
            WEIGHTLESS: _of_pairs(alone),
            "rods": _of_pairs(held),
            "force on what it presses": -holding[:3],
        }


def spring_torques(parameters: PlantParameters, theta_m: Numbers, theta_l: Numbers, omega_l: Numbers) -> Numbers:
    """tau_l (N m) of the three joints, (3,), of the twin's springs."""
    return np.array(
        [
            joint_torque(parameters, leg, spring_deflection(parameters, leg, theta_m[leg], theta_l[leg]), omega_l[leg])
            for leg in range(3)
        ]
    )


def _of_pairs(reactions: Numbers) -> Numbers:
    """Forces (N) on the platform by each pair of rods, (3, 3), of those by each rod, (18,)."""
    return reactions.reshape(3, 2, 3).sum(axis=1)


def states(parameters: PlantParameters, number: int, seed: int = 16) -> list[State]:
    """Drawn from the workspace as far as a straight way leads from the engine's initial pose.

    Left out is the neighbourhood of singularities, where every error grows. The platform moves at about 1 m/s, motors
    are off by up to 0.3 rad from where springs are slack, springs hold with about 0.2 N m.
    """
    geometry = Geometry(parameters.a, parameters.b, parameters.l_a, parameters.l_b)
    random, found = np.random.default_rng(seed), list[State]()
    reach = parameters.l_a + parameters.l_b
    first = position(geometry, np.full(3, initial_angle(parameters)))
    while len(found) < number:
        p_B = random.uniform(-reach, reach, 3)
        way = first + np.linspace(0.0, 1.0, WAY)[:, None] * (p_B - first)
        if not is_reachable(geometry, way).all():
            continue
        J = jacobian(geometry, way)
        measures = transmission_sines(geometry, J), np.abs(distal_volume(J)), holding(J)
        if min(measure.min() for measure in measures) < CLEAR:
            continue
        off = random.uniform(-0.3, 0.3, 3)
        theta_m = parameters.N * joint_angles(geometry, p_B) + off
        found.append(State(p_B, random.normal(size=3), theta_m, 0.2 * random.normal(size=3)))
    return found


def holding(J: Numbers) -> Numbers:
    """How well the parallelograms keep the platform from turning, (...): 1 well, 0 not at all.

    Each keeps it from turning about its own normal, so that it is the volume which the three normals span.

    Args:
        J: d theta_l / d p_B (rad/m), (..., 3, 3), whose rows point along the rods.
    """
    sideways = np.array([-np.array(LEG_SIN), LEG_COS, np.zeros(3)]).T
    normals = np.cross(sideways, J)
    return np.abs(np.linalg.det(normals / np.linalg.norm(normals, axis=-1, keepdims=True)))


def differences(one: Robot, other: Robot, given: Sequence[State]) -> dict[str, float]:
    """The largest difference of each answer in all states, as a part of what the other one says there."""
    found: dict[str, float] = {}
    for state in given:
        theirs = other.answers(state)
        for key, ours in one.answers(state).items():
            off = float(np.max(np.abs(ours - theirs[key])) / np.max(np.abs(theirs[key])))
            # keeps nan, which max() may pass over
            found[key] = float(np.maximum(off, found.get(key, 0.0)))
    return found
