"""Where the robot rests: the springs wound up so far that they carry its weight and the contact."""

import numpy as np
from numpy.typing import ArrayLike

from twin.plant.contact import contact_force
from twin.plant.dynamics import joint_torque, series_share
from twin.plant.friction import stop_torque, unstopped
from twin.plant.mounting import arm_torque, upward
from twin.plant.parameters import STATES, PlantParameters
from twin.robot.geometry import Geometry
from twin.robot.gravity import platform_weight
from twin.robot.inverse_kinematics import joint_angles
from twin.robot.jacobian import jacobian


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
    F_ee_B = np.array(contact_force(parameters, p[0], p[1], p[2], 0.0, 0.0, 0.0, 0.0, 0.0))
    up = upward(parameters)
    wrench = F_ee_B + platform_weight(parameters) * np.array(up)
    arms = np.array([arm_torque(parameters, up, leg, theta) for leg, theta in enumerate(theta_l)])
    stops = np.array([stop_torque(parameters, theta) for theta in theta_l])
    tau_l = np.linalg.solve(jacobian(geometry, p).T, wrench) - arms - stops
    d = tau_l / np.array([joint_torque(parameters, leg, 1.0, 0.0) for leg in range(3)])
    d = np.array([unstopped(parameters, w / series_share(parameters, leg)) for leg, w in enumerate(d)])
    backlash = parameters.backlash + np.array(parameters.backlash_added)
    theta_m = parameters.N * theta_l + d + np.sign(d) * backlash + np.array(parameters.slip)
    x = np.zeros(STATES)
    x[:3] = p
    return x, theta_m
