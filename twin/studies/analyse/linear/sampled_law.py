"""The robot's computer as a linear difference equation: estimator, force-position law, damping.

Nothing of the law is written here a second time: the equations are those of `twin/controller/`, called as they are.
Within its limits the law is linear, so its matrices are its values at the unit vectors, without any error. The
estimator is not, and is differentiated at the operating point.
"""

from typing import NamedTuple

import numpy as np

from twin.compiled.native import entry
from twin.controller.belief import BELIEF, Belief
from twin.controller.damping import DAMPER, Damping, damp, damper
from twin.controller.estimator import ESTIMATE, estimate
from twin.controller.pid import PID, Gains, accept, low_pass_share, proposal
from twin.cosim.record import memory_of, record
from twin.studies.analyse.linear.drive_model import Matrix

STEP = 1e-6
"""Of the central differences (rad): their error is below 1e-9, and no spring is that near its backlash."""

LOOPS = ("position_x", "position_y", "position_z", "force")
"""Where the loops can be opened: the three outputs of the position law (m/s), and dp_z of the force law (m)."""
REFERENCES = ("p_ref_B_x", "p_ref_B_y", "p_ref_B_z", "F_z_ref")
ESTIMATED = ("p_B_x_estimated", "p_B_y_estimated", "p_B_z_estimated", "F_z")


_ESTIMATION = record(belief=BELIEF, gravity_compensation="i8", counts=("f8", (6,)), y=ESTIMATE)


@entry("nothing", _ESTIMATION)
def _estimate(m):
    estimate(m.belief, m.gravity_compensation, m.counts[:3], m.counts[3:], m.y)


@entry("double", PID, "double", "double")
def _control(pid, error, h):
    output, integral = proposal(pid, error, h)
    accept(pid, integral)
    return output


@entry("nothing", DAMPER, "double", "doubles", "double", "doubles")
def _give_way(felt, torque_per_spring, tau_l, h, lead):
    damp(felt, torque_per_spring, tau_l, h, lead)


class Settings(NamedTuple):
    """The controller's settings, SI.

    Attributes:
        N: belt ratio.
        eta: belt efficiency, as believed.
        position, force: gains.
        corner: low-pass on the force (Hz).
        damping: None where the controller has none.
        period: s.
    """

    N: float
    eta: float
    position: Gains
    force: Gains
    corner: float
    damping: Damping | None
    period: float


class Estimation(NamedTuple):
    """The estimator at an operating point; derivatives by the six angles theta_m, theta_l.

    Attributes:
        J: Jacobian there (3, 3), rad/m.
        p_B, tau_l, F_ee_B: derivatives (3, 6).
        turned: derivative (3, 6) of J u for the steady output u of the position law: what a steady command of the
            motors changes to because the estimated Jacobian changes.
    """

    J: Matrix
    p_B: Matrix
    tau_l: Matrix
    F_ee_B: Matrix
    turned: Matrix


def estimation(belief: Belief, gravity_compensation: bool, read: Matrix, standing: Matrix) -> Estimation:
    """The estimator around the angles `read` (6,) that the encoders give, theta_m then theta_l, rad.

    Args:
        standing: motor speeds (3,) that the law commands at rest, rad/s: those that the drives' droop eats up.

    Raises:
        numpy.linalg.LinAlgError: the pose is singular.
    """
    at = memory_of(_ESTIMATION, belief=tuple(belief), gravity_compensation=gravity_compensation)
    per_turn = np.repeat([belief.motor_counts, belief.joint_counts], 3) / (2.0 * np.pi)

    def estimated(angles: Matrix) -> np.void:
        at["counts"] = angles * per_turn
        _estimate(at)
        y: np.void = at["y"][0].copy()
        return y

    ahead, behind = ([estimated(read + way * e) for e in np.eye(6)] for way in (STEP, -STEP))

    def slope(port: str) -> Matrix:
        return np.stack([(a[port] - b[port]) / (2.0 * STEP) for a, b in zip(ahead, behind, strict=True)], axis=1)

    J = estimated(read)["J"].reshape(3, 3)
    u = np.linalg.solve(belief.N * J, standing)
    turned = belief.N * np.einsum("ijk,j->ik", slope("J").reshape(3, 3, 6), u)
    return Estimation(J, slope("p_B"), slope("tau_l"), slope("F_ee_B"), turned)


class LinearLaw(NamedTuple):
    """c(j+1) = A c + B (angles, a), (omega_ref, b) = C c + D (angles, a), with the period of the controller.

    The inputs are the six angles, then `LOOPS`, then `REFERENCES`; the outputs three omega_ref, then `LOOPS`, then
    `ESTIMATED`. With every loop closed the inputs `LOOPS` are the outputs `LOOPS`.
    """

    A: Matrix
    B: Matrix
    C: Matrix
    D: Matrix


STATES = 9 + 3 + 1 + 3
"""Integral, derivative and last error of three position loops and the force loop, low-passed force, slow torques."""


def linear_law(settings: Settings, estimation: Estimation) -> LinearLaw:
    """The controller's matrices: one call of it for each unit vector."""
    inputs = 6 + len(LOOPS) + len(REFERENCES)
    columns = [_call(settings, estimation, z[:STATES], z[STATES:]) for z in np.eye(STATES + inputs)]
    whole = np.stack(columns, axis=1)
    return LinearLaw(whole[:STATES, :STATES], whole[:STATES, STATES:], whole[STATES:, :STATES], whole[STATES:, STATES:])


def _call(settings: Settings, estimation: Estimation, state: Matrix, inputs: Matrix) -> Matrix:
    """(state, outputs) after one call of the controller, as `twin/controller/task_controller.py` puts it together."""
    angles, u_in, dp_in, p_ref, F_ref = np.split(inputs, [6, 9, 10, 13])
    h = settings.period
    p, F_ee_B = estimation.p_B @ angles, estimation.F_ee_B @ angles
    F_z = state[12] + low_pass_share(settings.corner, h) * (-F_ee_B[2] - state[12])
    force, force_state = _pid(settings.force, state[9:12], F_ref[0] - F_z, h)
    error = p_ref - p
    error[2] += dp_in[0]
    position = [_pid(settings.position, state[3 * i : 3 * i + 3], error[i], h) for i in range(3)]
    lead, slow = _damped(settings, state[13:], estimation.tau_l @ angles)
    omega_ref = settings.N * estimation.J @ u_in + estimation.turned @ angles + lead
    u_out, pid_states = [u for u, _ in position], [kept for _, kept in position]
    return np.concatenate([*pid_states, force_state, [F_z], slow, omega_ref, u_out, [-force], p, [F_z]])


def _pid(gains: Gains, state: Matrix, error: float, h: float) -> tuple[float, Matrix]:
    """(output, state) of one loop that nothing limits; its state is integral, derivative, last error."""
    pid = np.array([(*gains, *state, 1)], dtype=PID)
    output = _control(pid, error, h)
    return output, np.concatenate([pid["integral"], pid["derivative"], pid["error"]])


def _damped(settings: Settings, slow: Matrix, tau_l: Matrix) -> tuple[Matrix, Matrix]:
    """(motor speeds (3,) by which the motors give way, low-passed torques (3,))."""
    lead = np.zeros(3)
    if settings.damping is None:
        return lead, slow
    felt = np.array([damper(settings.damping, slow, started=True)], dtype=DAMPER)
    _give_way(felt, settings.N * settings.eta, tau_l, settings.period, lead)
    return lead, felt["slow"][0].copy()
