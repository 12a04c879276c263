"""Where the robot rests: the springs wound up so far that they carry its weight and the contact."""

import numpy as np
from numpy.typing import ArrayLike

from twin.compiled.native import entry
from twin.cosim.record import memory_of, record
from twin.plant.contact import contact_force
from twin.plant.dynamics import joint_torque, series_share
from twin.plant.friction import stop_torque, unstopped
from twin.plant.mounting import arm_torque, upward
from twin.plant.parameters import PARAMETERS, STATES, PlantParameters
from twin.robot.geometry import Geometry
from twin.robot.gravity import platform_weight
from twin.robot.inverse_kinematics import joint_angles
from twin.robot.jacobian import jacobian

_REST = record(
    parameters=PARAMETERS, **dict.fromkeys(("p_B", "theta_l", "wrench", "arms", "stops", "tau_l", "d"), "3f8")
)
"""Wrench (N) that joints carry at p_B, what arms' weights and stops take of it (N m), springs' torque and wind-up."""


@entry("nothing", _REST)
def _load(m):
    p, (x, y, z) = m.parameters, (m.p_B[0], m.p_B[1], m.p_B[2])
    up, weight = upward(p), platform_weight(p)
    force = contact_force(p, x, y, z, 0.0, 0.0, 0.0, 0.0, 0.0)
    for i in range(3):
        m.wrench[i] = force[i] + weight * up[i]
        m.arms[i], m.stops[i] = arm_torque(p, up, i, m.theta_l[i]), stop_torque(p, m.theta_l[i])


@entry("nothing", _REST)
def _wind(m):
    for leg in range(3):
        d = m.tau_l[leg] / joint_torque(m.parameters, leg, 1.0, 0.0)
        m.d[leg] = unstopped(m.parameters, d / series_share(m.parameters, leg))


def resting(parameters: PlantParameters, p_B: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
    """State x (8,) and motor angles theta_m (3,) at which the platform rests at `p_B` (3,), in m.

    The net force on the platform is zero with velocities and bristle zero; a loaded spring sits at the far side of
    its backlash, an unloaded one in the middle. Springs are as wound up as `joint_torque` asks at speed zero, where
    losses in the direction of the power flow (P1) vanish. Dry friction carries nothing yet, in the middle of what it
    can. No spring may be broken: nothing else would carry its share.

    Raises:
        Unreachable: `p_B` is outside the workspace.
    """
    p = np.asarray(p_B, dtype=float)
    geometry = Geometry(parameters.a, parameters.b, parameters.l_a, parameters.l_b)
    theta_l = joint_angles(geometry, p)
    rest = memory_of(_REST, parameters=tuple(parameters), p_B=p, theta_l=theta_l)
    _load(rest)
    rest["tau_l"] = np.linalg.solve(jacobian(geometry, p).T, rest["wrench"][0]) - rest["arms"][0] - rest["stops"][0]
    _wind(rest)
    d = rest["d"][0]
    backlash = parameters.backlash + np.array(parameters.backlash_added)
    theta_m = parameters.N * theta_l + d + np.sign(d) * backlash + np.array(parameters.slip)
    x = np.zeros(STATES)
    x[:3] = p
    return x, theta_m
