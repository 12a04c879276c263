"""Prediction of gains by the linear model at the corners of an experiment: stability, sensitivity, step response.

The tuned gains are P of the position law, and P and I of the force law. A corner is an operating point on one stiffness
with one drive; the goals apply at every corner.

The laws of `twin/robot/controller/` are evaluated in closed form because thousands of gains are tried:

    e_F = F_z_ref - F_z,  I(k) = I(k-1) + ki T e_F,  dp_z = -(kp_F e_F + I(k)),  u = kp (p_ref + dp_z e_z - p).

A test compares the poles with `twin.studies.analyse`, which calls the compiled laws.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from twin.kernel.errors import InputRefused
from twin.kernel.units import parse_float
from twin.robot.experiment.experiment import Experiment
from twin.studies.analyse.linear.loops import ESTIMATED_SIGNALS, LOOPS, TRUE_SIGNALS, Matrix
from twin.studies.analyse.linear.margins import MIN_FREQUENCY, Complex, response
from twin.studies.analyse.linearised import Linearisation
from twin.studies.analyse.operating_point import (
    OperatingPoint,
    operating_points,
    point_on_stiffness,
    undisturbed_experiment,
)
from twin.studies.metrics.response import overshoot, settling_time

STIFFNESS_COUNT = 3
"""Number of stiffnesses for a range: both ends and the geometric mean."""
FREQUENCY_COUNT = 500
"""Number of frequencies from `MIN_FREQUENCY` to half the rate: 2 % apart, closer than the resonances are wide."""
STEP_HORIZON = 8.0
"""Length of a step response (s)."""
SETTLED_BAND = 0.05
"""Settling band around the final value (share of the step)."""
BLOCK_SAMPLES = 64
"""Number of samples per block of a step response, a power of two."""
HALF_POWER = 1.0 / np.sqrt(2.0)
UNIT_FACTORS = (1.0, 1.0, 1.0, 1.0)
"""Neutral factors on the loops x, y, z and force."""
GRID_TOLERANCE = 1.02
"""Largest ratio of M_s between two frequencies to M_s on the frequency grid."""
MAX_FACTOR = 1000.0


@dataclass(frozen=True)
class Goals:
    """Goals of tuning, SI; each applies at the worst corner.

    Attributes:
        sensitivity: maximum M_s of any loop, > 1. It guarantees a gain margin of M_s / (M_s - 1) and a phase margin of
            2 asin(1 / (2 M_s)) (Astrom and Hagglund 2006, Advanced PID Control, Sec. 4.6).
        overshoot: maximum overshoot (share of the step).
        bandwidth: minimum bandwidth (rad/s) of `law`, "force" or, where no force loop acts, "position"; None for none.
    """

    sensitivity: float = 1.6
    overshoot: float = 0.05
    bandwidth: float | None = None
    law: str = "force"

    def __post_init__(self) -> None:
        if not (math.isfinite(self.sensitivity) and self.sensitivity > 1.0):
            raise InputRefused(
                f"--margin {self.sensitivity:g}: no loop has its largest |1/(1+L)| that small; expected more than 1, "
                "usually 1.3 to 2"
            )
        if not 0.0 <= self.overshoot <= 1.0:
            raise InputRefused(f"--overshoot-percent {100 * self.overshoot:g}: expected 0 to 100")
        if self.bandwidth is not None and not (math.isfinite(self.bandwidth) and self.bandwidth > 0.0):
            raise InputRefused(f"--bandwidth-Hz {self.bandwidth_hertz:g}: expected more than 0")

    @property
    def bandwidth_hertz(self) -> float:
        return (self.bandwidth or 0.0) / (2.0 * math.pi)

    def refuse_period(self, period: float) -> None:
        """Refuse a bandwidth goal that a controller with the given period (s) cannot reach."""
        if self.bandwidth is not None and self.bandwidth >= math.pi / period:
            raise InputRefused(
                f"--bandwidth-Hz {self.bandwidth_hertz:g}: beyond half the controller's rate of "
                f"{1.0 / period:g} Hz; ask for less, or lower [controller] period_ms"
            )


def stiffness_range(text: str) -> tuple[float, float]:
    """Parse a stiffness range, "300:5000", into (lowest, highest) (N/m)."""
    numbers = [parse_float(number) or 0.0 for number in text.split(":")]
    low, high = numbers if len(numbers) == 2 else (0.0, 0.0)
    if not (math.isfinite(high) and 0.0 < low <= high):
        raise InputRefused(
            f"--stiffness-N-per-m {text}: expected two numbers above 0, the lower first, for example 300:5000"
        )
    return low, high


class LawGains(NamedTuple):
    """The tuned gains: `kp` (1/s), `force_kp` (m/N) and `force_ki` (m/(N s)), which shift the z reference."""

    kp: float
    force_kp: float
    force_ki: float


def round_gains(gains: LawGains) -> LawGains:
    """Round the tuned gains to three digits, as shown and written."""
    return LawGains(*(float(f"{gain:.2e}") for gain in gains))


def gains_of(experiment: Experiment) -> LawGains:
    """Return the gains of an experiment that tuning changes; refuse it if any other gain is not zero."""
    position, force = experiment.controller.position, experiment.controller.force
    others = {
        "controller.position.ki_per_s2": position.ki,
        "controller.position.kd": position.kd,
        "controller.force.kd_mm_s_per_N": force.kd,
    }
    for key, value in others.items():
        if value:
            raise InputRefused(
                f"{experiment.name}: {key} is not 0; only kp of the position law and kp and ki of the force law are "
                f"tuned, so --set {key}=0"
            )
    return LawGains(position.kp, force.kp, force.ki)


def with_gains(experiment: Experiment, gains: LawGains) -> Experiment:
    c = experiment.controller
    position = c.position.model_copy(update={"kp": gains.kp})
    force = c.force.model_copy(update={"kp": gains.force_kp, "ki": gains.force_ki})
    return replace(experiment, controller=c.model_copy(update={"position": position, "force": force}))


UNITY_GAINS = LawGains(1.0, 1.0, 0.0)
"""Gains used to linearise the robot before its loops are opened."""


@dataclass(frozen=True)
class Corner:
    """Linear model of the robot at one operating point, with one drive and stiffness, both control laws opened.

    x(k+1) = A x + B u with u the platform speed (3,) requested by the position law; y = C x: estimated position (3,),
    low-passed estimated pressing force, true position (3,), and true pressing force, SI.

    Attributes:
        A, B, C: state-space matrices, (n, n), (n, 3), (8, n).
        omega: frequencies (rad/s) (m,).
        P: frequency response (m, 4, 3) of the estimated signals.
    """

    experiment: Experiment
    drive: str
    point: OperatingPoint
    A: Matrix
    B: Matrix
    C: Matrix
    period: float
    omega: Matrix
    P: Complex

    @property
    def name(self) -> str:
        """Name of the operating point and stiffness: `force on 300 N/m`, `position in air`."""
        where = f"on {self.point.parameters.K:.4g} N/m" if self.point.in_contact else "in air"
        return f"{self.law} {where}"

    @property
    def law(self) -> str:
        """Control law whose step response is examined here: the force law if it acts, else the position law."""
        return "force" if self.point.force_on else "position"

    @property
    def axes(self) -> tuple[int, ...]:
        """Axes whose steps are examined here: 3, the force, if its law acts; else z in contact, or all."""
        if self.point.force_on:
            return (3,)
        return (2,) if self.point.in_contact else (0, 1, 2)


def stiffnesses(span: tuple[float, float]) -> list[float]:
    """Return the stiffnesses (N/m) that represent a range in tuning: both ends and the geometric mean."""
    low, high = span
    return [float(K) for K in np.geomspace(low, high, STIFFNESS_COUNT)] if high > low else [low]


def corners(
    experiments: Sequence[Experiment], stiffness: tuple[float, float] | None
) -> tuple[list[Corner], list[str], list[Linearisation]]:
    """Return (corners, messages of points without a model, linearisations) per point, stiffness and drive."""
    points, problems = operating_points(experiments[0])
    if stiffness is not None:
        low, high = stiffness
        each = stiffnesses(stiffness)
        air = [point for point in points if not point.in_contact]
        try:
            points = air + [point_on_stiffness(point, K) for point in points if point.in_contact for K in each]
        except InputRefused as refusal:
            raise InputRefused(f"--stiffness-N-per-m {low:g}:{high:g}: {refusal}; raise the lower end") from None
    found, drives = [], []
    for experiment in experiments:
        shared = Linearisation(with_gains(experiment, UNITY_GAINS), points)
        drives.append(shared)
        found += [open_corner(experiment, shared, point) for point in points]
    return found, problems, drives


def open_corner(experiment: Experiment, shared: Linearisation, point: OperatingPoint) -> Corner:
    """Build the linear model of an experiment at one operating point, with both control laws opened."""
    loops = shared.linear_point(point).loops
    outputs = [loops.output_labels.index(name) for name in (*ESTIMATED_SIGNALS, *TRUE_SIGNALS)]
    rows = loops.C[outputs]
    # The pressing force is -F_ee_B_z.
    rows[-1] *= -1.0
    system = loops[outputs[:4], : len(LOOPS[:3])]
    omega = np.geomspace(MIN_FREQUENCY, 0.999 * np.pi / loops.dt, FREQUENCY_COUNT)
    P = response(system, omega)
    return Corner(experiment, shared.labels[0], point, loops.A, loops.B[:, :3], rows, loops.dt, omega, P)


def at_stiffness(corner: Corner) -> Experiment:
    """Return the experiment of a corner, undisturbed, with the corner's surface stiffness and height."""
    p = corner.point.parameters
    return undisturbed_experiment(corner.experiment, stiffness=p.K, height=p.z_s)


@dataclass(frozen=True)
class StepAnswer:
    """True, not estimated, response to a unit step of the reference of one control law.

    Attributes:
        overshoot: overshoot (share of the step).
        settling: time until it stays within `SETTLED_BAND` (s); infinity if it does not settle in `STEP_HORIZON`.
        error: integrated absolute error over `STEP_HORIZON`, of a unit step (s).
        bandwidth: frequency where |L/(1+L)| first falls below 1/sqrt(2) (rad/s).
    """

    overshoot: float
    settling: float
    error: float
    bandwidth: float

    JSON_KEYS = "overshoot settling bandwidth"


@dataclass(frozen=True)
class Prediction:
    """Predicted behaviour of some gains at one corner, by the linear model.

    Attributes:
        radius: spectral radius; the loop is stable below 1.
        sensitivity: M_s, the largest |1/(1+L)| of any loop with the others closed; infinity if unstable.
        answer: step response, the worst over its axes; None if unstable.
    """

    corner: Corner
    radius: float
    sensitivity: float
    answer: StepAnswer | None

    @property
    def stable(self) -> bool:
        return self.radius < 1.0


def predict(corner: Corner, gains: LawGains) -> Prediction:
    A, _, _ = close_loops(corner, gains)
    radius = float(np.abs(np.linalg.eigvals(A)).max())
    if radius >= 1.0:
        return Prediction(corner, radius, np.inf, None)
    S = sensitivities(corner, gains)
    worst = _worst([_answer(corner, gains, S, i) for i in corner.axes])
    return Prediction(corner, radius, float(np.abs(S).max()), worst)


def close_loops(
    corner: Corner, gains: LawGains, factors: Sequence[float] = UNIT_FACTORS
) -> tuple[Matrix, Matrix, Matrix]:
    """Close both control laws at a corner; return the closed loop as (A, B, C).

    Inputs are p_ref (3,) and F_z_ref, outputs true position (3,) and pressing force. The force law's integral is a
    state only where that law acts with an integral gain. `factors` (4,) apply to the loops x, y, z and force, where
    `sensitivities` opens them.
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
    """Compute the sensitivity 1/(1+L) (m, 3 or 4) of the loops x, y, z and any force, with the others closed.

    The result is the diagonal of (1 + L)^-1 with L the matrix of all loops: opening loop i alone leaves 1/((1 +
    L)^-1)_ii as its return difference (Skogestad and Postlethwaite 2005, Multivariable Feedback Control, Sec. 10.6).
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


def confirms_sensitivity(corner: Corner, gains: LawGains, sensitivity: float) -> bool:
    """Whether the eigenvalues confirm that the sensitivity M_s is at most `sensitivity`, up to `GRID_TOLERANCE`.

    A loop with M_s stays stable with any one factor from M_s / (M_s + 1) to M_s / (M_s - 1) (Astrom and Hagglund 2006,
    Advanced PID Control, Sec. 4.6).
    """
    M_s = GRID_TOLERANCE * sensitivity
    for i in range(4 if corner.point.force_on else 3):
        for factor in (M_s / (M_s + 1.0), min(M_s / (M_s - 1.0), MAX_FACTOR)):
            factors = [factor if loop == i else 1.0 for loop in range(4)]
            if np.abs(np.linalg.eigvals(close_loops(corner, gains, factors)[0])).max() >= 1.0:
                return False
    return True


def step_response(corner: Corner, gains: LawGains, i: int) -> tuple[Matrix, Matrix, float]:
    """Return (t (s), response (n,), final value) of a stable corner to a unit step of axis `i`, 3: the force."""
    A, B, C = close_loops(corner, gains)
    rest = np.linalg.solve(np.eye(len(A)) - A, B[:, i]).astype(np.float64, copy=False)
    final = float(C[i] @ rest)
    # x(k) = rest - A^k rest; C A^(64 a + b) rest is the product of a few rows C A^b and columns A^(64 a) rest
    samples = round(STEP_HORIZON / corner.period)
    rows, power = _powers(C[[i]], A, BLOCK_SAMPLES)
    columns, _ = _powers(rest[None], power.T, -(-samples // BLOCK_SAMPLES))
    y = final - (columns @ rows.T).ravel()[:samples]
    return corner.period * np.arange(samples, dtype=np.float64), y, final


def _powers(row: Matrix, A: Matrix, count: int) -> tuple[Matrix, Matrix]:
    """Return `row` A^k for k = 0 .. count - 1, (count, n), and A^m, m the smallest power of two >= `count`."""
    rows, power = row, A
    while len(rows) < count:
        rows, power = np.vstack([rows, rows @ power]), power @ power
    return rows[:count], power


def answer(t: Matrix, share: Matrix, bandwidth: float) -> StepAnswer:
    return StepAnswer(
        overshoot(share, 1.0),
        settling_time(t, share, 1.0, SETTLED_BAND),
        float(np.mean(np.abs(1.0 - share)) * STEP_HORIZON),
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
