"""Position and force from encoder counts alone (Fig. 3 C, D): kinematics, then statics, one Jacobian for both."""

import numpy as np

from twin.compiled.function import carray, njit
from twin.controller.belief import BELIEF, Belief
from twin.cosim.component import NativeComponent
from twin.cosim.native import address_of, doubles_at, step_function
from twin.cosim.port import Port, memory_of, port_record, record
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
ESTIMATE = port_record(OUTPUTS[:-1])
"""All of them but `valid`."""
ESTIMATES = ESTIMATE.itemsize // 8
MEMORY = record(belief=BELIEF, gravity_compensation="i8", estimated="i8", newest=ESTIMATE)
NO_POSE = 2


@njit(cache=True)
def angle(count, counts_per_turn, zero):
    """Angle (rad) that an encoder count stands for."""
    return count * (2.0 * np.pi / counts_per_turn) - zero


@njit(cache=True)
def estimate(belief, gravity_compensation, count_m, count_l, y):
    """The record `y` of `ESTIMATE` from motor and joint counts (3,) each; NaN where no pose fits.

    The springs' dead zone is taken off the deflection as far as the belief knows it.
    F_ee_B = J^T (tau_l + arm gravity) - weight e_z: Eq. 21-27 corrected and gravity-compensated; without compensation
    J^T tau_l, the paper's own form.
    """
    for i in range(3):
        y.theta_m[i] = angle(count_m[i], belief.motor_counts, belief.motor_zero[i])
        y.theta_l[i] = angle(count_l[i], belief.joint_counts, belief.joint_zero[i])
    px, py, pz = platform_position(belief, y.theta_l[0], y.theta_l[1], y.theta_l[2])
    y.p_B[0], y.p_B[1], y.p_B[2] = px, py, pz
    fx, fy, fz = 0.0, 0.0, -platform_weight(belief) if gravity_compensation else 0.0
    for i in range(3):
        theta_l = y.theta_l[i]
        jx, jy, jz = jacobian_row(belief, i, theta_l, px, py, pz)
        y.J[3 * i], y.J[3 * i + 1], y.J[3 * i + 2] = jx, jy, jz
        wound = dead_zone(deflection(y.theta_m[i], theta_l, belief.N), belief.backlash)
        tau = load_torque(belief.k_s, belief.N, belief.eta, wound)
        y.tau_l[i] = tau
        if gravity_compensation:
            tau += arm_gravity_torque(belief, belief, theta_l)
        fx, fy, fz = fx + jx * tau, fy + jy * tau, fz + jz * tau
    y.F_ee_B[0], y.F_ee_B[1], y.F_ee_B[2] = fx, fy, fz


@step_function(MEMORY, INPUTS, OUTPUTS)
def step(m, t, h, u, y):
    estimate(m.belief, m.gravity_compensation, u.count_m, u.count_l, m.newest)
    newest = carray(doubles_at(address_of(m.newest)), ESTIMATES)
    # one sum is NaN or infinite if any of them is; a lost or garbled sample may not take the controller with it
    y.valid = np.isfinite(np.sum(newest))
    if y.valid:
        given = carray(doubles_at(address_of(y)), ESTIMATES)
        for i in range(ESTIMATES):
            given[i] = newest[i]
        m.estimated = 1
    return 0 if m.estimated else NO_POSE


class Estimator(NativeComponent):
    """Sampled component: encoder counts in, position and force out.

    Args:
        belief: the controller's model of the robot.
        gravity_compensation: take the robot's own weight out of the force.
        period: in ticks.
    """

    def __init__(self, belief: Belief, gravity_compensation: bool = True, period: int = 1):
        memory = memory_of(MEMORY, belief=tuple(belief), gravity_compensation=gravity_compensation)
        super().__init__("estimator", INPUTS, OUTPUTS, True, step, memory, period=period)

    def explain(self, status: int) -> str:
        return "found no pose that fits the first encoder counts"
