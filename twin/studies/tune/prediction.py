"""What the linear model says of gains at a corner: stability, sensitivity, and the answer to a step.

The laws are those of `twin/controller/`, put in closed form because thousands of gains are tried:

    e_F = F_z_ref - F_z,  I(k) = I(k-1) + ki T e_F,  dp_z = -(kp_F e_F + I(k)),  u = kp (p_ref + dp_z e_z - p).

A test holds the poles against those of `twin.studies.analyse`, which calls the compiled laws.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twin.studies.analyse.linear.drive_model import Matrix
from twin.studies.metrics.response import overshoot, settling_time
from twin.studies.tune.corner import Corner
from twin.studies.tune.gains import LawGains

HORIZON = 8.0
"""Of a step response (s)."""
SETTLED = 0.05
"""Band around the final value (share of the step)."""
BLOCK = 64
"""Samples; a power of two."""
HALF_POWER = 1.0 / np.sqrt(2.0)
ALONE = (1.0, 1.0, 1.0, 1.0)
"""Factors on the loops x, y, z and force that leave them as they are."""
BETWEEN = 1.02
"""What M_s may be larger by between two of the frequencies at which it is looked for."""
LARGEST_FACTOR = 1000.0


@dataclass(frozen=True)
class StepAnswer:
    """The answer to a unit step of the reference of one law, in truth and not as it is estimated.

    Attributes:
        overshoot: share of the step.
        settling: time from which it stays within `SETTLED` (s); infinity: not in `HORIZON`.
        error: integrated absolute error over `HORIZON`, of a unit step (s).
        bandwidth: where |L/(1+L)| first falls below 1/sqrt(2) (rad/s).
    """

    overshoot: float
    settling: float
    error: float
    bandwidth: float


@dataclass(frozen=True)
class Prediction:
    """Gains at a corner.

    Attributes:
        corner: where.
        radius: largest magnitude of a pole; below 1: stable.
        sensitivity: M_s, the largest |1/(1+L)| of any loop with the others closed; infinity if unstable.
        answers: by law; the worst of its axes. Empty if unstable.
    """

    corner: Corner
    radius: float
    sensitivity: float
    answers: dict[str, StepAnswer]

    @property
    def stable(self) -> bool:
        return self.radius < 1.0


def predicted(corner: Corner, gains: LawGains) -> Prediction:
    """Judge `gains` at `corner`."""
    A, _, _ = closed(corner, gains)
    radius = float(np.abs(np.linalg.eigvals(A)).max())
    if radius >= 1.0:
        return Prediction(corner, radius, np.inf, {})
    S = sensitivities(corner, gains)
    names = {"position": corner.axes, "force": (3,)}
    answers = {law: _worst([_answer(corner, gains, S, i) for i in names[law]]) for law in corner.laws}
    return Prediction(corner, radius, float(np.abs(S).max()), answers)


def closed(corner: Corner, gains: LawGains, factors: Sequence[float] = ALONE) -> tuple[Matrix, Matrix, Matrix]:
    """(A, B, C) with the laws closed: p_ref (3,) and F_z_ref in, true position (3,) and pressing force out.

    The force law's integral is a state only where that law acts with an integral gain.

    Args:
        factors: on the loops x, y, z and force, each where it is opened in `sensitivities` (4,).
    """
    T, on = corner.period, corner.point.force_on
    K = gains.kp * np.diag(factors[:3])
    kp_F, ki = factors[3] * gains.force_kp, factors[3] * gains.force_ki
    c_p, c_F = corner.C[:3], corner.C[3]
    e_z = np.array([[0.0], [0.0], [1.0]])
    # u = U_x x + U_I I + U_r (p_ref, F_z_ref)
    gain = (kp_F + ki * T) if on else 0.0
    U_x = K @ (-c_p + gain * e_z * c_F)
    U_r = K @ np.hstack([np.eye(3), -gain * e_z])
    A, B = corner.A + corner.B @ U_x, corner.B @ U_r
    C = corner.C[4:]
    if on and ki:
        A = np.block([[A, -corner.B @ K @ e_z], [-ki * T * c_F[None], np.eye(1)]])
        B = np.vstack([B, [[0.0, 0.0, 0.0, ki * T]]])
        C = np.hstack([C, np.zeros((4, 1))])
    return A, B, C


def sensitivities(corner: Corner, gains: LawGains) -> np.ndarray:
    """1/(1+L) (m, 3 or 4) of the loops x, y, z and, where it acts, force, each opened with the others closed.

    It is the diagonal of (1 + L)^-1 with L the matrix of all loops: opening loop i alone leaves 1/((1 + L)^-1)_ii as
    its return difference (Skogestad and Postlethwaite 2005, Multivariable Feedback Control, Sec. 10.6).
    """
    kp, kp_F, ki = gains
    m, loops = len(corner.omega), 4 if corner.point.force_on else 3
    back = np.zeros((m, 4, 4), dtype=complex)
    z = np.exp(1j * corner.omega * corner.period)
    C_F = kp_F + ki * corner.period * z / (z - 1.0)
    back[:, :3, :3] = -kp * corner.P[:, :3]
    back[:, 2, 3] = kp
    back[:, 3, :3] = C_F[:, None] * corner.P[:, 3]
    S = np.linalg.inv(np.eye(loops) - back[:, :loops, :loops])
    return np.diagonal(S, axis1=1, axis2=2)


def confirmed(corner: Corner, gains: LawGains, sensitivity: float) -> bool:
    """Whether the eigenvalues bear out that M_s is no larger than `sensitivity`, but for what is `BETWEEN`.

    A loop with M_s stays stable with any one factor from M_s / (M_s + 1) to M_s / (M_s - 1) (Astrom and Hagglund 2006,
    Advanced PID Control, Sec. 4.6).
    """
    M_s = BETWEEN * sensitivity
    for i in range(4 if corner.point.force_on else 3):
        for factor in (M_s / (M_s + 1.0), min(M_s / (M_s - 1.0), LARGEST_FACTOR)):
            factors = [factor if loop == i else 1.0 for loop in range(4)]
            if np.abs(np.linalg.eigvals(closed(corner, gains, factors)[0])).max() >= 1.0:
                return False
    return True


def step_response(corner: Corner, gains: LawGains, i: int) -> tuple[Matrix, Matrix, float]:
    """(t in s, response (n,), its final value) of the true position in axis `i`, or of the true pressing force (3), to
    a unit step of its reference at t = 0, over `HORIZON`.

    Args:
        gains: with which the corner is stable.
    """
    A, B, C = closed(corner, gains)
    rest = np.linalg.solve(np.eye(len(A)) - A, B[:, i]).astype(np.float64, copy=False)
    final = float(C[i] @ rest)
    # x(k) = rest - A^k rest; C A^(64 a + b) rest is the product of a few rows C A^b and columns A^(64 a) rest
    samples = round(HORIZON / corner.period)
    rows, power = _powers(C[[i]], A, BLOCK)
    columns, _ = _powers(rest[None], power.T, -(-samples // BLOCK))
    y = final - (columns @ rows.T).ravel()[:samples]
    return corner.period * np.arange(samples, dtype=np.float64), y, final


def _powers(row: Matrix, A: Matrix, count: int) -> tuple[Matrix, Matrix]:
    """(`row` A^k for k = 0 .. count - 1 (count, n), A^m with m the power of two that is not below `count`)."""
    rows, power = row, A
    while len(rows) < count:
        rows, power = np.vstack([rows, rows @ power]), power @ power
    return rows[:count], power


def answer(t: Matrix, share: Matrix, bandwidth: float) -> StepAnswer:
    """What `share` (n,) of the step, 1 in the end, comes to at the times `t` (n,) up to `HORIZON` (s)."""
    return StepAnswer(
        overshoot(share, 1.0),
        settling_time(t, share, 1.0, SETTLED),
        float(np.mean(np.abs(1.0 - share)) * HORIZON),
        bandwidth,
    )


def _answer(corner: Corner, gains: LawGains, S: np.ndarray, i: int) -> StepAnswer:
    below = np.flatnonzero(np.abs(1.0 - S[:, i]) < HALF_POWER)
    t, y, final = step_response(corner, gains, i)
    return answer(t, y / final, float(corner.omega[below[0]]) if len(below) else float(corner.omega[-1]))


def _worst(each: list[StepAnswer]) -> StepAnswer:
    return StepAnswer(
        max(found.overshoot for found in each),
        max(found.settling for found in each),
        max(found.error for found in each),
        min(found.bandwidth for found in each),
    )
