"""Equations of statics for each window of an identification: three per pose in free air, two on the scale.

With the deflection w = motor - N joint - w_0 as the encoders read it, w_0 its zero, k = k_s eta, b the half width of
the dead zone and s = sign(w) tanh(theta_l'/rate), the spring's torque is (18)-(20) with the losses of (P1)

    tau_l = k N e^(loss s) dead_zone(w, b)

and the slow robot obeys (P5), docs/physics.md, without the terms in the square of speed:

    J^T (tau_l + g_a - b_j theta_l' - I_a theta_l'') - W e_z - m p'' = F_ee,  p'' = J^-1 theta_l''.

In free air F_ee = 0: three equations. On the scale F_ee,z = -F is measured, but the bristles of friction pull sideways
by up to mu F, unmeasured: only the z row holds, whatever they do. All are divided by k N (and by the length
of the z column of J), so that residuals are deflections in rad: the rounding of the encoders is then the error of the
response and not of the regressor, which would bias k low. The second equation on the scale is its own law, Hunt and
Crossley's at a slow speed, on a plane of slopes m_x and m_y. F is the reading and delay times its slope, since a scale
shows its force late:

    p_z = z_s + m_x p_x + m_y p_y - C F / (1 - c p_z')
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin.robot.controller.controller import Belief
from twin.robot.mechanism.geometry import Geometry
from twin.robot.mechanism.kinematics import jacobian_rows, position
from twin.robot.mechanism.statics import arm_gravity_torque, platform_weight
from twin.studies.identify import parameters as places
from twin.studies.identify.windows import Windows, in_air, on_scale

PLAUSIBLE_COMPLIANCE = 1e-3
"""Compliance of a scale (m/N), used only to weight rounding of the force against rounding of the encoders."""


class Pose(NamedTuple):
    """Robot poses of the windows: positions, Jacobians and weights.

    Attributes:
        p_B: positions (n, 3), m.
        J: d theta_l / d p_B (n, 3, 3), rad/m.
        g_a: torques of the arms' weight (n, 3), N m.
        lift: d p_z / d theta_l (n, 3), m/rad: the third row of J^-1, i.e. J^-T e_z.
    """

    p_B: NDArray[np.float64]
    J: NDArray[np.float64]
    g_a: NDArray[np.float64]
    lift: NDArray[np.float64]


class Equations(NamedTuple):
    """Residuals of the equations of statics of all windows.

    Attributes:
        residual: residuals (m,), rad or m.
        sigma: standard deviation of each due to rounding of a single sample (m,).
        window: index of the window of each (m,).
        kind: 0 free air, 1 force on the scale, 2 depth in the scale (m,).
        per_newton: residual of kind 1 per newton (k,), rad/N.
    """

    residual: NDArray[np.float64]
    sigma: NDArray[np.float64]
    window: NDArray[np.int64]
    kind: NDArray[np.int64]
    per_newton: NDArray[np.float64]


def pose(belief: Belief, theta_l: NDArray[np.float64]) -> Pose:
    """Compute kinematics and arm weight at theta_l (n, 3), rad; raise `Unreachable` if some poses do not close."""
    geometry = Geometry(belief.a, belief.b, belief.l_a, belief.l_b)
    p_B = position(geometry, theta_l)
    J = jacobian_rows(geometry, theta_l, p_B)
    inverse = np.asarray(np.linalg.inv(J), dtype=np.float64)
    arms = np.vectorize(lambda theta: arm_gravity_torque(belief, belief, theta), otypes=[float])(theta_l)
    return Pose(p_B, J, arms, inverse[:, 2])


def deflections(x: NDArray[np.float64], seen: Windows, N: float) -> NDArray[np.float64]:
    """Compute the spring deflections motor - N joint - zero (n, 3), rad."""
    return seen.motor - N * seen.joint - x[places.OFFSET : places.OFFSET + 3]


def subtract_dead_zone(w: NDArray[np.float64], half_width: float) -> NDArray[np.float64]:
    """Subtract the dead zone from spring deflections; `sea.dead_zone` for arrays."""
    return np.sign(w) * np.maximum(np.abs(w) - half_width, 0.0)


def clear_of_edges(x: NDArray[np.float64], seen: Windows, N: float) -> NDArray[np.bool_]:
    """Check per window (n,) that deflections stay off the dead zone's edges, so that the spring law is linear."""
    return np.all(np.abs(deflections(x, seen, N)) > max(x[places.BACKLASH], 0.0) + seen.spread, axis=1)


def joint_torques(x: NDArray[np.float64], seen: Windows, N: float) -> NDArray[np.float64]:
    """Compute the torques on the links, spring torque less viscous friction tau_l - b_j theta_l' (n, 3), N m."""
    d = subtract_dead_zone(deflections(x, seen, N), x[places.BACKLASH])
    direction = np.sign(d) * np.tanh(seen.speed / x[places.RATE])
    return x[places.KAPPA] * N * np.exp(x[places.LOSS] * direction) * d - x[places.FRICTION] * seen.speed


def inertia(seen: Windows, belief: Belief, at: Pose) -> NDArray[np.float64]:
    """Compute the torques that accelerate the robot (n, 3), N m, without I_r: unknown and a tenth of the total."""
    I_a = (belief.m_a / 3.0 + belief.m_b / 2.0) * belief.l_a**2
    mass = belief.m_p + 1.5 * belief.m_b
    a_B = np.linalg.solve(at.J, seen.acceleration[..., None])
    torque: NDArray[np.float64] = mass * np.linalg.solve(at.J.transpose(0, 2, 1), a_B)[..., 0]
    return torque + I_a * seen.acceleration


def rows(
    x: NDArray[np.float64], seen: Windows, belief: Belief, resolution: float, at: Pose, surface: bool = True
) -> Equations:
    """Compute the residuals of all equations of statics at parameters `x` (17,).

    Args:
        resolution: step of the force (N).
        at: `pose` at x's zeros of the joints.
        surface: whether to include the scale's law, kind 2.
    """
    W = platform_weight(belief)
    torque = joint_torques(x, seen, belief.N) + at.g_a - inertia(seen, belief, at)
    air, scale = np.flatnonzero(in_air(seen)), np.flatnonzero(on_scale(seen))
    per_torque = 1.0 / (x[places.KAPPA] * belief.N)
    step_m, step_l = 2.0 * np.pi / belief.motor_counts, 2.0 * np.pi / belief.joint_counts
    rounding = np.hypot(step_m, belief.N * step_l) / np.sqrt(12.0)

    joints = (torque[air] - W * at.lift[air]) * per_torque

    J_z = at.J[scale, :, 2]
    length = np.linalg.norm(J_z, axis=1)
    F = seen.force[scale] + x[places.DELAY] * seen.force_rate[scale]
    per_newton = per_torque / length
    force = (np.sum(J_z * torque[scale], axis=1) - W + F) * per_newton
    force_rounding = np.hypot(rounding, resolution / np.sqrt(12.0) * per_newton)

    law = slice(None) if surface else slice(0)
    under = scale[law]
    rate = np.sum(at.lift[under] * seen.speed[under], axis=1)
    plane = x[places.HEIGHT] + at.p_B[under, :2] @ x[places.SLOPE : places.SLOPE + 2]
    depth = at.p_B[under, 2] - plane + x[places.COMPLIANCE] * F[law] / (1.0 - x[places.DAMPING] * rate)
    turn = np.linalg.norm(at.lift[under], axis=1)
    depth_rounding = np.hypot(turn * step_l, PLAUSIBLE_COMPLIANCE * resolution) / np.sqrt(12.0)
    return Equations(
        np.concatenate([joints.ravel(), force, depth]),
        np.concatenate([np.full(3 * len(air), rounding), force_rounding, depth_rounding]),
        np.concatenate([np.repeat(air, 3), scale, under]),
        np.repeat([0, 1, 2], [3 * len(air), len(scale), len(under)]),
        per_newton,
    )


def pressing_force(x: NDArray[np.float64], seen: Windows, belief: Belief) -> NDArray[np.float64]:
    """Compute the force F_ee_B (n, 3), N, by statics with the parameters `x`, without the robot's weight."""
    at = pose(belief, seen.joint - x[places.JOINT_ZERO : places.JOINT_ZERO + 3])
    F = np.einsum("nij,ni->nj", at.J, joint_torques(x, seen, belief.N) + at.g_a - inertia(seen, belief, at))
    F[:, 2] -= platform_weight(belief)
    return F
