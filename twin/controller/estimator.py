"""Position and force from encoder counts alone (Fig. 3 C, D): kinematics, then statics, one Jacobian for both."""

import numpy as np
from numba import carray, njit

from twin.controller.belief import BELIEF, Belief
from twin.cosim.component import NativeComponent, Port, width
from twin.cosim.native import step_function
from twin.robot.forward_kinematics import platform_position
from twin.robot.gravity import arm_gravity_torque, platform_weight
from twin.robot.jacobian import jacobian_row
from twin.robot.sea import dead_zone, deflection, load_torque

INPUTS = (Port("count_m", 3, "1", "motor encoder counts"), Port("count_l", 3, "1", "joint encoder counts"))
OUTPUTS = (
    Port("theta_m", 3, "rad", "motor angles, from counts"),
    Port("theta_l", 3, "rad", "proximal link angles, from counts"),
    Port("p_B", 3, "m", "platform position by forward kinematics, base frame B"),
    Port("J", 9, "rad/m", "Jacobian d theta_l / d p_B at p_B, row by row"),
    Port("tau_l", 3, "N m", "joint torques by Eq. 20"),
    Port("F_ee_B", 3, "N", "force by the robot on the environment by statics, base frame B, unfiltered"),
    Port("valid", 1, "1", "whether these follow from the newest counts; if not, from the last that fit a pose", "bool"),
)
ESTIMATES = width(OUTPUTS) - 1
MEMORY = np.dtype(
    [("belief", BELIEF), ("gravity_compensation", "i8"), ("estimated", "i8"), ("newest", "f8", (ESTIMATES,))],
    align=True,
)
NO_POSE = 2


@njit(cache=True)
def angle(count, counts_per_turn, zero):
    """Angle (rad) that an encoder count stands for."""
    return count * (2.0 * np.pi / counts_per_turn) - zero


@njit(cache=True)
def estimate(belief, gravity_compensation, count_m, count_l, y):
    """All but the last of `OUTPUTS` into `y` (24,) from motor and joint counts (3,) each; NaN where no pose fits.

    The springs' dead zone is taken off the deflection as far as the belief knows it.
    F_ee_B = J^T (tau_l + arm gravity) - weight e_z: Eq. 21-27 corrected and gravity-compensated; without compensation
    J^T tau_l, the paper's own form.
    """
    for i in range(3):
        y[i] = angle(count_m[i], belief.motor_counts, belief.motor_zero[i])
        y[3 + i] = angle(count_l[i], belief.joint_counts, belief.joint_zero[i])
    px, py, pz = platform_position(belief, y[3], y[4], y[5])
    y[6], y[7], y[8] = px, py, pz
    fx, fy, fz = 0.0, 0.0, -platform_weight(belief) if gravity_compensation else 0.0
    for i in range(3):
        theta_l = y[3 + i]
        jx, jy, jz = jacobian_row(belief, i, theta_l, px, py, pz)
        y[9 + 3 * i], y[10 + 3 * i], y[11 + 3 * i] = jx, jy, jz
        wound = dead_zone(deflection(y[i], theta_l, belief.N), belief.backlash)
        tau = load_torque(belief.k_s, belief.N, belief.eta, wound)
        y[18 + i] = tau
        if gravity_compensation:
            tau += arm_gravity_torque(belief, belief, theta_l)
        fx, fy, fz = fx + jx * tau, fy + jy * tau, fz + jz * tau
    y[21], y[22], y[23] = fx, fy, fz


@step_function(MEMORY)
def step(self, t, h, u, y):
    m = carray(self, 1)[0]
    counts, y_ = carray(u, 6), carray(y, ESTIMATES + 1)
    estimate(m.belief, m.gravity_compensation, counts[:3], counts[3:], m.newest)
    # one sum is NaN or infinite if any of them is; a lost or garbled sample may not take the controller with it
    valid = np.isfinite(np.sum(m.newest))
    if valid:
        y_[:ESTIMATES] = m.newest
        m.estimated = 1
    y_[ESTIMATES] = valid
    return 0 if m.estimated else NO_POSE


class Estimator(NativeComponent):
    """Sampled component: encoder counts in, position and force out.

    Args:
        belief: the controller's model of the robot.
        gravity_compensation: take the robot's own weight out of the force.
        period: in ticks.
    """

    def __init__(self, belief: Belief, gravity_compensation: bool = True, period: int = 1):
        memory = np.zeros(1, dtype=MEMORY)
        memory["belief"][0] = tuple(belief)
        memory["gravity_compensation"] = gravity_compensation
        super().__init__("estimator", INPUTS, OUTPUTS, True, step, memory, period=period)

    def explain(self, status: int) -> str:
        return "found no pose that fits the first encoder counts"
