"""What a plant that is taken elsewhere works out for itself before its first step, compiled as its steps are.

Where the robot rests: the springs wound up so far that they carry its weight and the contact.
"""

import math
from functools import cache

import numpy as np
from numpy.typing import ArrayLike

from twin.compiled.function import njit
from twin.compiled.native import entry
from twin.cosim.native import step_function
from twin.cosim.port import Port, memory_of, record
from twin.plant.component import LEFT_WORKSPACE, MEMORY, OUTPUTS, STILL, inputs, outputs_near, triple
from twin.plant.contact import ANCHORS, contact_force, stop_torque, unstopped
from twin.plant.dynamics import joint_torque, series_share, settle_friction
from twin.plant.parameters import PARAMETERS, STATES, PlantParameters
from twin.plant.surface import apex_frame, arm_torque, upward
from twin.robot.geometry import Geometry
from twin.robot.gravity import platform_weight
from twin.robot.inverse_kinematics import joint_angles, leg_angle
from twin.robot.jacobian import jacobian, jacobian_row

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


REST_OUTPUTS = (
    Port("theta_m_rest", 3, "rad", "motor angles at which the platform rests where it starts, to rounding"),
)


@cache
def outputs_at_start(moving, ramp):
    """The outputs of a plant before its first step, from its state and the motor angles in its inputs."""

    @step_function(MEMORY, inputs(moving, ramp), OUTPUTS)
    def start(m, t, h, u, y):
        # a pose may have been set that the old anchors know nothing of
        for leg in range(3):
            for i in range(ANCHORS):
                m.anchors[leg, i] = math.nan
        settle_friction(m.parameters, m.x, triple(u.theta_m), m.anchors)
        inside = outputs_near(
            m.parameters, m.x, triple(u.theta_m), STILL, STILL, apex_frame(m.parameters), m.anchors, y
        )
        return 0 if inside else LEFT_WORKSPACE

    return start


@njit(cache=True)
def cross(a, b):
    """Vector product of two triples."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@njit(cache=True, error_model="numpy")
def _share(w, a, b, c):
    """How much of the triple `a` is in `w`, which is a sum of multiples of `a`, `b` and `c`: Cramer's rule."""
    n = cross(b, c)
    return (w[0] * n[0] + w[1] * n[1] + w[2] * n[2]) / (a[0] * n[0] + a[1] * n[1] + a[2] * n[2])


@step_function(MEMORY, outputs=REST_OUTPUTS)
def rest(m, t, h, u, y):
    # `equilibrium.resting` without a solver of LAPACK, which no FMU has
    p = m.parameters
    px, py, pz = m.x[0], m.x[1], m.x[2]
    fx, fy, fz = contact_force(p, px, py, pz, 0.0, 0.0, 0.0, 0.0, 0.0)
    up, weight = upward(p), platform_weight(p)
    w = fx + weight * up[0], fy + weight * up[1], fz + weight * up[2]
    theta_1, theta_2, theta_3 = leg_angle(p, 0, px, py, pz), leg_angle(p, 1, px, py, pz), leg_angle(p, 2, px, py, pz)
    row_1 = jacobian_row(p, 0, theta_1, px, py, pz)
    row_2 = jacobian_row(p, 1, theta_2, px, py, pz)
    row_3 = jacobian_row(p, 2, theta_3, px, py, pz)
    tau = _share(w, row_1, row_2, row_3), _share(w, row_2, row_3, row_1), _share(w, row_3, row_1, row_2)
    theta = theta_1, theta_2, theta_3
    for leg in range(3):
        left = tau[leg] - arm_torque(p, up, leg, theta[leg]) - stop_torque(p, theta[leg])
        d = unstopped(p, left / joint_torque(p, leg, 1.0, 0.0) / series_share(p, leg))
        slack = p.backlash + p.backlash_added[leg]
        gap = 0.0 if d == 0.0 else math.copysign(slack, d)
        y.theta_m_rest[leg] = p.N * theta[leg] + d + gap + p.slip[leg]
    return 0
