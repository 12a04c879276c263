"""The plant as a co-simulation component: classical Runge-Kutta over a tick, friction settled after each step."""

import math

import numpy as np
from numba import carray, njit
from numpy.typing import ArrayLike

from twin.cosim.component import NativeComponent, Port, width
from twin.cosim.native import step_function
from twin.plant.contact import contact_force, normal_force, settled_bristle
from twin.plant.dynamics import derivative, joint_torque, spring_deflection
from twin.plant.parameters import PARAMETERS, STATES, PlantParameters
from twin.robot.inverse_kinematics import leg_angle
from twin.robot.jacobian import jacobian_row
from twin.robot.sea import motor_load_torque

LEFT_WORKSPACE = 2

INPUTS = (Port("theta_m", 3, "rad", "motor angles, held over the step"),)
OUTPUTS = (
    Port("p_B", 3, "m", "platform position in base frame B"),
    Port("v_B", 3, "m/s", "platform velocity in base frame B"),
    Port("theta_l", 3, "rad", "proximal link angles, positive lowers the platform"),
    Port("omega_l", 3, "rad/s", "proximal link speeds"),
    Port("tau_l", 3, "N m", "torque of the springs on the joints"),
    Port("tau_load", 3, "N m", "torque the springs ask of the motor shafts, tau_l / (N eta)"),
    Port("F_ee_B", 3, "N", "force by the robot on the surface in base frame B; pressing has F_ee_B[2] < 0"),
    Port("F_n", 1, "N", "normal contact force"),
    Port("z_b", 2, "m", "bristle deflection in the surface"),
)

MEMORY = np.dtype(
    [
        ("parameters", PARAMETERS),
        ("substeps", "i8"),
        ("x", "f8", (STATES,)),
        ("last", "f8", (STATES,)),
        ("k", "f8", (4, STATES)),
        ("stage", "f8", (STATES,)),
    ],
    align=True,
)


@njit(cache=True)
def settle(parameters, x):
    """Return mapping of the bristle in the state `x`, in place: what ends every integration step."""
    F_n, _ = normal_force(parameters, x[0], x[1], x[2], x[3], x[4], x[5])
    x[6], x[7] = settled_bristle(parameters, F_n, x[6], x[7])


@njit(cache=True)
def integrate(parameters, x, theta_m, h, k, stage):
    """One classical Runge-Kutta step of `h` seconds, `x` in place; `k` (4, 8) and `stage` (8,) are scratch."""
    derivative(parameters, x, theta_m, k[0])
    for part, weight in ((1, 0.5), (2, 0.5), (3, 1.0)):
        for i in range(STATES):
            stage[i] = x[i] + weight * h * k[part - 1, i]
        derivative(parameters, stage, theta_m, k[part])
    for i in range(STATES):
        x[i] += h / 6.0 * (k[0, i] + 2.0 * k[1, i] + 2.0 * k[2, i] + k[3, i])
    settle(parameters, x)


@njit(cache=True)
def outputs(parameters, x, theta_m, y):
    """The ports `OUTPUTS` of the state `x` at motor angles `theta_m`, into `y`; False outside the workspace."""
    px, py, pz, vx, vy, vz = x[0], x[1], x[2], x[3], x[4], x[5]
    for i in range(6):
        y[i] = x[i]
    inside = True
    for leg in range(3):
        theta_l = leg_angle(parameters, leg, px, py, pz)
        inside = inside and not math.isnan(theta_l)
        jx, jy, jz = jacobian_row(parameters, leg, theta_l, px, py, pz)
        omega_l = jx * vx + jy * vy + jz * vz
        d = spring_deflection(parameters, theta_m[leg], theta_l)
        y[6 + leg] = theta_l
        y[9 + leg] = omega_l
        y[12 + leg] = joint_torque(parameters, d, omega_l)
        y[15 + leg] = motor_load_torque(parameters.k_s, d)
    y[18], y[19], y[20] = contact_force(parameters, px, py, pz, vx, vy, vz, x[6], x[7])
    y[21], _ = normal_force(parameters, px, py, pz, vx, vy, vz)
    y[22], y[23] = x[6], x[7]
    return inside


@step_function(MEMORY)
def step(self, t, h, u, y):
    m = carray(self, 1)[0]
    theta_m = carray(u, 3)
    # where the robot was, for the sentence of a step that leaves nothing but NaN
    m.last[:] = m.x
    for _ in range(m.substeps):
        integrate(m.parameters, m.x, theta_m, h / m.substeps, m.k, m.stage)
    return 0 if outputs(m.parameters, m.x, theta_m, carray(y, 24)) else LEFT_WORKSPACE


class Plant(NativeComponent):
    """Springs, mechanism and contact as one continuous component.

    Args:
        parameters: what is true.
        x: initial state (8,), see `parameters.py`.
        theta_m: initial motor angles (3,), rad.
        substeps: Runge-Kutta steps per co-simulation step.
    """

    def __init__(self, parameters: PlantParameters, x: ArrayLike, theta_m: ArrayLike, substeps: int = 1):
        memory = np.zeros(1, dtype=MEMORY)
        memory["parameters"][0] = tuple(parameters)
        memory["substeps"] = substeps
        memory["x"] = x
        initial = np.empty(width(OUTPUTS))
        outputs(parameters, memory["x"][0], np.asarray(theta_m, dtype=float), initial)
        super().__init__("plant", INPUTS, OUTPUTS, False, step, memory, initial)

    def explain(self, status: int) -> str:
        x, y, z = 1e3 * self.memory["last"][0][:3]
        return f"left the workspace: a leg cannot reach the platform near ({x:.1f}, {y:.1f}, {z:.1f}) mm,"
