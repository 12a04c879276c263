"""Robot and controller as one sampled system whose loops can be opened one at a time.

The robot's computer is a linear difference equation: estimator, force-position law, damping. The equations are those in
`twin/robot/controller/`, called and not copied. Within its limits the law is linear, so its matrices are exactly its
values at the unit vectors. The estimator is nonlinear and is differentiated at the operating point.

Drives, springs, mechanism and contact map one call of the controller to the next, as the master steps them. The map of
one tick is composed of the parts' own maps in the master's order (`twin/kernel/cosim/master.py`): the drives see
omega_ref(k) and tau_load(k), then the plant sees theta_m(k+1), or theta_m(k) with the Jacobi scheme. So the poles and
gains include the coupling error of the co-simulation, unlike those from the differential equations.

A drive is a linear model per tick, fitted to its frequency response: the shaft's advance per tick, w(k) = theta_m(k+1)
- theta_m(k), over the command omega_ref(k) and the load tau_load(k), both held over the tick. The angle itself has a
pole at z = 1 in every drive, which the fit thus need not find.

The fit is rational, both transfer functions over one denominator, by the iteration of Sanathanan and Koerner (1963,
IEEE Trans Autom Control 8:56). Its variable is not z but

    lambda = (z - p) / (1 - p z),  p = exp(-2 pi f_p tick):

an all-pass map that keeps the unit circle and spreads the frequencies around f_p over it (Wahlberg 1991, IEEE Trans
Autom Control 36:551), because in z a slow drive's poles crowd at 1 and the equations become ill-conditioned.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

import control
import numpy as np
from numpy.typing import NDArray

from twin.kernel.compiled.native import entry
from twin.kernel.cosim.port import memory_of, record
from twin.kernel.errors import InputRefused
from twin.robot.controller.compliance import DAMPER_RECORD, Damping, damp, damper
from twin.robot.controller.controller import BELIEF_RECORD, ESTIMATE_RECORD, Belief, estimate
from twin.robot.controller.pid import PID_RECORD, Gains, accept, low_pass_share, proposal

Matrix = NDArray[np.float64]

CENTRE_FREQUENCY = 20.0
"""f_p (Hz): near the bandwidth of drives and loops."""

MAX_STATES = 8
GOOD_RESIDUAL = 0.003
"""Residual that ends the search for more states, if the measurement is certain."""
STANDSTILL_GAIN = 1e-9
"""Maximum speed per commanded speed of a shaft at standstill; above 0 because of rounding."""
MAX_RESIDUAL = 0.3
"""Maximum residual of a usable linear model."""
FIT_ITERATIONS = 12
MIN_DENOMINATOR = 1e-9
"""Minimum denominator as a share of the largest, below which only rounding remains."""
ANGLE_STEP = 1e-6
"""Step of the central differences (rad): their error is below 1e-9, and the springs are farther from their backlash."""
LOOPS = ("position_x", "position_y", "position_z", "force")
"""Points where the loops can be opened: the three outputs of the position law (m/s), and dp_z of the force law (m)."""
REFERENCE_SIGNALS = ("p_ref_B_x", "p_ref_B_y", "p_ref_B_z", "F_z_ref")
ESTIMATED_SIGNALS = ("p_B_x_estimated", "p_B_y_estimated", "p_B_z_estimated", "F_z")
_ESTIMATION_RECORD = record(belief=BELIEF_RECORD, gravity_compensation="i8", counts=("f8", (6,)), y=ESTIMATE_RECORD)
LAW_STATES = 9 + 3 + 1 + 3
"""Integral, derivative and last error of three position loops and the force loop, low-passed force, slow torques."""
MEASURED_ANGLES = ("theta_m_1", "theta_m_2", "theta_m_3", "theta_l_1", "theta_l_2", "theta_l_3")
TRUE_SIGNALS = ("p_B_x", "p_B_y", "p_B_z", "F_ee_B_z")
SPEED_COMMANDS = ("omega_ref_1", "omega_ref_2", "omega_ref_3")
LOAD_TORQUES = ("tau_load_1", "tau_load_2", "tau_load_3")
Loops: TypeAlias = control.StateSpace
"""All loops of the robot, open, as `open_loops` names their inputs and outputs."""


@dataclass(frozen=True)
class DriveModel:
    """Linear model of a drive per tick: x(k+1) = A x + B u, theta_m(k+1) - theta_m(k) = C x + D u.

    The input u is (omega_ref, tau_load) of the tick, SI; A to D are (n, n), (n, 2), (1, n), (1, 2); n may be 0.

    Attributes:
        residual: rms distance of the model from the measured response, the larger of command and load. It is relative
            to the response at each frequency, to a tenth of the largest, or to ten times the measurement's uncertainty,
            whichever is largest.
        turning: whether it was measured while the shaft turned, because the drive is nonlinear at rest.
    """

    A: Matrix
    B: Matrix
    C: Matrix
    D: Matrix
    residual: float = 0.0
    turning: bool = False

    @property
    def steady_gain(self) -> Matrix:
        """Advance of the drive's shaft per tick (2,) for a constant command and a constant load."""
        return (self.D + self.C @ np.linalg.solve(np.eye(len(self.A)) - self.A, self.B))[0]

    def response(self, z: NDArray[np.complex128]) -> NDArray[np.complex128]:
        """Return the transfer functions of the drive model (n, 2) at the points `z` (n,)."""
        states = np.eye(len(self.A))
        return np.array([(self.D + self.C @ np.linalg.solve(point * states - self.A, self.B))[0] for point in z])


def fit_drive(
    frequencies: Matrix, response: NDArray[np.complex128], uncertainty: Matrix, tick: float, label: str
) -> DriveModel:
    """Fit the smallest stable linear model that is close to a drive's measured frequency response, else refuse it.

    Args:
        frequencies: Hz (n,), below half the tick rate; 0 for the steady gain.
        response: (n, 2), advance per tick over omega_ref (rad per rad/s) and tau_load (rad per N m); `tick` in s.
        uncertainty: standard deviation of `response` (n, 2).
    """
    z = np.exp(2j * np.pi * tick * frequencies)
    p = np.exp(-2.0 * np.pi * CENTRE_FREQUENCY * tick)
    size = np.abs(response)
    if not size[:, 0].max() > STANDSTILL_GAIN * tick:
        raise InputRefused(
            f"{label}: no linear model describes it: its shaft does not respond to small commands; "
            "see `twin drive check`"
        )
    # avoid a division by zero for a drive that no load can move
    largest = np.maximum(size.max(axis=0), 1e-9 * size.max())
    weight = 1.0 / np.maximum(np.maximum(size, 0.1 * largest), 10.0 * uncertainty)
    # a model as accurate as the measurement needs no more states
    enough = GOOD_RESIDUAL + np.sqrt(np.mean((uncertainty * weight) ** 2, axis=0)).max()
    best: DriveModel | None = None
    for states in range(MAX_STATES + 1):
        model = _state_space(*_rational_fit((z - p) / (1.0 - p * z), response, weight, states), p)
        if states and np.abs(np.linalg.eigvals(model.A)).max() >= 1.0:
            continue
        distance = np.abs(model.response(z) - response) * weight
        residual = float(np.sqrt(np.mean(distance**2, axis=0)).max())
        if best is None or residual < 0.7 * best.residual:
            best = DriveModel(model.A, model.B, model.C, model.D, residual)
        if best.residual < enough:
            break
    if best is None or best.residual > MAX_RESIDUAL:
        worst = best.residual if best else 1.0
        raise InputRefused(
            f"{label}: no linear model describes it: the best misses its measured frequency response by {worst:.0%}, "
            f"expected at most {MAX_RESIDUAL:.0%}. Its response to small signals is not linear; simulate instead "
            "(twin run)"
        )
    return best


def _rational_fit(
    variable: NDArray[np.complex128], response: NDArray[np.complex128], weight: Matrix, states: int
) -> tuple[Matrix, Matrix]:
    """Fit a rational transfer function to a response; return (denominator, numerators) in 1 / `variable`."""
    powers = (1.0 / variable)[:, None] ** np.arange(states + 1)
    denominator = np.ones(len(variable), dtype=complex)
    for _ in range(FIT_ITERATIONS if states else 1):
        # the denominator may vanish at a frequency: if only the steady gain responds, a pole is there
        scale = weight / np.maximum(np.abs(denominator), MIN_DENOMINATOR * np.abs(denominator).max())[:, None]
        blocks, right = [], []
        for channel in range(2):
            numerator = np.zeros((len(variable), 2 * (states + 1)), dtype=complex)
            numerator[:, channel * (states + 1) : (channel + 1) * (states + 1)] = powers
            rows = np.hstack([numerator, -response[:, [channel]] * powers[:, 1:]]) * scale[:, [channel]]
            blocks += [rows.real, rows.imag]
            target = response[:, channel] * scale[:, channel]
            right += [target.real, target.imag]
        found = np.linalg.lstsq(np.vstack(blocks), np.concatenate(right), rcond=None)[0]
        coefficients = np.concatenate([[1.0], found[2 * (states + 1) :]])
        denominator = powers @ coefficients
    return coefficients, found[: 2 * (states + 1)].reshape(2, states + 1).T


def _state_space(denominator: Matrix, numerators: Matrix, p: float) -> DriveModel:
    """Convert a drive's transfer functions, polynomials in 1/lambda, to a state-space model in z.

    In lambda it is the observer form; with A, B, C, D there, (lambda 1 - A)^-1 = (1 - p z)(z 1 - A_z)^-1 (1 + p A)^-1
    for A_z = (1 + p A)^-1 (A + p 1), and (1 - p z)(z 1 - A_z)^-1 = -p 1 + (1 - p A_z)(z 1 - A_z)^-1.
    """
    n = len(denominator) - 1
    A = np.eye(n, k=1)
    A[:, :1] = -denominator[1:, None]
    D = numerators[:1]
    B = numerators[1:] - denominator[1:, None] * D
    C = np.eye(1, n)
    turned = np.linalg.inv(np.eye(n) + p * A)
    A_z = turned @ (A + p * np.eye(n))
    return DriveModel(A_z, turned @ B, C @ (np.eye(n) - p * A_z), D - p * C @ turned @ B)


@entry("nothing", _ESTIMATION_RECORD)
def _estimate(m):
    estimate(m.belief, m.gravity_compensation, m.counts[:3], m.counts[3:], m.y)


@entry("double", PID_RECORD, "double", "double")
def _control(pid, error, h):
    output, integral = proposal(pid, error, h)
    accept(pid, integral)
    return output


@entry("nothing", DAMPER_RECORD, "double", "doubles", "double", "doubles")
def _damp_motors(felt, torque_per_spring, tau_l, h, lead):
    damp(felt, torque_per_spring, tau_l, h, lead)


class LoopSettings(NamedTuple):
    """The controller's settings for the linear analysis, SI: belt ratio N, believed eta, low-pass `corner` (Hz)."""

    N: float
    eta: float
    position: Gains
    force: Gains
    corner: float
    damping: Damping | None
    period: float


class Estimation(NamedTuple):
    """The linearised estimator at a point: Jacobian J (3, 3), rad/m, and derivatives (3, 6) by theta_m, theta_l.

    Attributes:
        turned: derivative of J u for the steady output u of the position law, i.e. the change of a steady motor command
            due to the change of the estimated Jacobian.
    """

    J: Matrix
    p_B: Matrix
    tau_l: Matrix
    F_ee_B: Matrix
    turned: Matrix


def estimation(belief: Belief, gravity_compensation: bool, read: Matrix, standing: Matrix) -> Estimation:
    """Linearise the controller's estimator around the encoder angles (6,): theta_m, then theta_l, rad.

    `standing` (3,): motor speeds that the law commands at rest, rad/s, to compensate the drives' droop.
    """
    at = memory_of(_ESTIMATION_RECORD, belief=tuple(belief), gravity_compensation=gravity_compensation)
    per_turn = np.repeat([belief.motor_counts, belief.joint_counts], 3) / (2.0 * np.pi)

    def estimated(angles: Matrix) -> np.void:
        at["counts"] = angles * per_turn
        _estimate(at)
        y: np.void = at["y"][0].copy()
        return y

    ahead, behind = ([estimated(read + way * e) for e in np.eye(6)] for way in (ANGLE_STEP, -ANGLE_STEP))

    def slope(port: str) -> Matrix:
        return np.stack([(a[port] - b[port]) / (2.0 * ANGLE_STEP) for a, b in zip(ahead, behind, strict=True)], axis=1)

    J = estimated(read)["J"].reshape(3, 3)
    u = np.linalg.solve(belief.N * J, standing)
    turned = belief.N * np.einsum("ijk,j->ik", slope("J").reshape(3, 3, 6), u)
    return Estimation(J, slope("p_B"), slope("tau_l"), slope("F_ee_B"), turned)


class LinearLaw(NamedTuple):
    """Linear difference equations of the controller at its period, with all loops open.

    c(j+1) = A c + B (angles, a), (omega_ref, b) = C c + D (angles, a).

    The inputs are the six angles, then `LOOPS`, then `REFERENCE_SIGNALS`; the outputs three omega_ref, then `LOOPS`,
    then `ESTIMATED_SIGNALS`. With every loop closed the inputs `LOOPS` are the outputs `LOOPS`.
    """

    A: Matrix
    B: Matrix
    C: Matrix
    D: Matrix


def linear_law(settings: LoopSettings, estimation: Estimation) -> LinearLaw:
    """Compute the controller's linear difference equations, with one call of the controller per unit vector."""
    inputs = 6 + len(LOOPS) + len(REFERENCE_SIGNALS)
    columns = [_call(settings, estimation, z[:LAW_STATES], z[LAW_STATES:]) for z in np.eye(LAW_STATES + inputs)]
    whole = np.stack(columns, axis=1)
    (A, B), (C, D) = (np.split(rows, [LAW_STATES], axis=1) for rows in np.split(whole, [LAW_STATES]))
    return LinearLaw(A, B, C, D)


def _call(settings: LoopSettings, estimation: Estimation, state: Matrix, inputs: Matrix) -> Matrix:
    """Compute the controller's new state and outputs after one call without limits."""
    angles, u_in, dp_in, p_ref, F_ref = np.split(inputs, [6, 9, 10, 13])
    h = settings.period
    p, F_ee_B = estimation.p_B @ angles, estimation.F_ee_B @ angles
    F_z = state[12] + low_pass_share(settings.corner, h) * (-F_ee_B[2] - state[12])
    force, force_state = _pid(settings.force, state[9:12], F_ref[0] - F_z, h)
    error = p_ref - p
    error[2] += dp_in[0]
    position = [_pid(settings.position, state[3 * i : 3 * i + 3], error[i], h) for i in range(3)]
    lead, slow = _damping_speeds(settings, state[13:], estimation.tau_l @ angles)
    omega_ref = settings.N * estimation.J @ u_in + estimation.turned @ angles + lead
    u_out, pid_states = [u for u, _ in position], [state for _, state in position]
    return np.concatenate([*pid_states, force_state, [F_z], slow, omega_ref, u_out, [-force], p, [F_z]])


def _pid(gains: Gains, state: Matrix, error: float, h: float) -> tuple[float, Matrix]:
    """Compute output and new state of one unlimited PID loop; its state is integral, derivative, last error."""
    pid = np.array([(*gains, *state, 1)], dtype=PID_RECORD)
    output = _control(pid, error, h)
    return output, np.concatenate([pid["integral"], pid["derivative"], pid["error"]])


def _damping_speeds(settings: LoopSettings, slow: Matrix, tau_l: Matrix) -> tuple[Matrix, Matrix]:
    """Compute the motor speeds (3,) of the damping by yielding, and its low-passed torques (3,)."""
    lead = np.zeros(3)
    if settings.damping is None:
        return lead, slow
    felt = np.array([damper(settings.damping, slow, started=True)], dtype=DAMPER_RECORD)
    _damp_motors(felt, settings.N * settings.eta, tau_l, settings.period, lead)
    return lead, felt["slow"][0].copy()


class LoopStepping(NamedTuple):
    """Timing of the co-simulation for the linear analysis: tick (s), and substeps of the plant per tick.

    Attributes:
        period, delay: ticks between two calls of the controller, and from its call to the drives.
        jacobi: whether all continuous components see the values at the start of the tick; otherwise the plant sees the
            drives' newest angles.
    """

    tick: float
    substeps: int
    period: int
    delay: int
    jacobi: bool


def runge_kutta_step(A: Matrix, B: Matrix, h: float, substeps: int) -> tuple[Matrix, Matrix]:
    """Discretise dx/dt = A x + B u over `h` (s), u held, as the plant's integrator does; return (A_d, B_d).

    Classical Runge-Kutta multiplies a linear state by R(h A), R(z) = 1 + z + z^2/2 + z^3/6 + z^4/24 (Hairer and Wanner
    1996, Solving Ordinary Differential Equations II, IV.2); the derivative of its step at a state of rest is the same.
    """
    z = A * (h / substeps)
    one = np.eye(len(A))
    input_share = one + z / 2.0 @ (one + z / 3.0 @ (one + z / 4.0))
    A_1, B_1 = one + z @ input_share, h / substeps * input_share @ B
    A_d, B_d = one, np.zeros_like(B)
    for _ in range(substeps):
        A_d, B_d = A_1 @ A_d, A_1 @ B_d + B_1
    return A_d, B_d


def tick_map(plant: control.StateSpace, drives: Sequence[DriveModel], stepping: LoopStepping) -> control.StateSpace:
    """Build the linear model of drives and plant over one tick, from motor speed commands to angles and true signals.

    The plant is linearised, in continuous time, with inputs theta_m_1 .. 3 and the names of outputs used here.
    """
    rows = {name: i for i, name in enumerate(plant.output_labels)}
    A_p, B_p = runge_kutta_step(plant.A, plant.B, stepping.tick, stepping.substeps)
    # states: plant, drives, theta_m, and the tau_load that the plant has published
    n_p, n_d = len(A_p), [len(drive.A) for drive in drives]
    start = n_p + np.concatenate([[0], np.cumsum(n_d)]).astype(int)
    angle, load = start[3] + np.arange(3), start[3] + 3 + np.arange(3)
    n = int(start[3]) + 6
    A, B = np.zeros((n, n)), np.zeros((n, 3))
    for i, drive in enumerate(drives):
        own = slice(start[i], start[i + 1])
        A[own, own], A[own, load[i]], B[own, i] = drive.A, drive.B[:, 1], drive.B[:, 0]
        A[angle[i], own], A[angle[i], load[i]], B[angle[i], i] = drive.C[0], drive.D[0, 1], drive.D[0, 0]
        A[angle[i], angle[i]] = 1.0
    seen, seen_of_command = (np.eye(n)[angle], np.zeros((3, 3))) if stepping.jacobi else (A[angle], B[angle])
    A[:n_p], B[:n_p] = B_p @ seen, B_p @ seen_of_command
    A[:n_p, :n_p] += A_p
    torque = [rows[name] for name in LOAD_TORQUES]
    A[load] = plant.C[torque] @ A[:n_p] + plant.D[torque] @ seen
    B[load] = plant.C[torque] @ B[:n_p] + plant.D[torque] @ seen_of_command
    C = np.zeros((len(MEASURED_ANGLES) + len(TRUE_SIGNALS), n))
    C[range(3), angle] = 1.0
    C[3:, :n_p] = plant.C[[rows[name] for name in (*MEASURED_ANGLES[3:], *TRUE_SIGNALS)]]
    D, outputs = np.zeros((len(C), 3)), [*MEASURED_ANGLES, *TRUE_SIGNALS]
    return control.ss(A, B, C, D, stepping.tick, inputs=list(SPEED_COMMANDS), outputs=outputs, name="tick")


def period_map(tick: control.StateSpace, stepping: LoopStepping) -> control.StateSpace:
    """Extend the linear model of one tick to a controller period, with the command held and delayed.

    A delay of q periods and r ticks means that the command of q + 1 periods ago is still active for the first r ticks.
    """
    q, r = divmod(stepping.delay, stepping.period)
    A, early, late = np.eye(tick.nstates), np.zeros_like(tick.B), np.zeros_like(tick.B)
    for k in range(stepping.period):
        A, early, late = tick.A @ A, tick.A @ early, tick.A @ late
        if k < r:
            early = early + tick.B
        else:
            late = late + tick.B
    n, delays = tick.nstates, q + (1 if r else 0)
    # states: the tick's, then the commands of 1, 2 .. periods ago
    A_, B_ = np.zeros((n + 3 * delays, n + 3 * delays)), np.zeros((n + 3 * delays, 3))
    A_[:n, :n] = A
    A_[n + 3 :, n:-3] = np.eye(3 * max(0, delays - 1))
    for age, share in ((q, late), (q + 1, early)):
        if age == 0:
            B_[:n] += share
        elif age <= delays:
            A_[:n, n + 3 * (age - 1) : n + 3 * age] += share
    if delays:
        B_[n : n + 3] = np.eye(3)
    C = np.hstack([tick.C, np.zeros((len(tick.C), 3 * delays))])
    T = stepping.period * stepping.tick
    return control.ss(A_, B_, C, tick.D, T, inputs=list(SPEED_COMMANDS), outputs=tick.output_labels, name="robot")


def open_loops(robot: control.StateSpace, law: LinearLaw, whole: bool = False) -> Loops:
    """Connect robot and controller to one linear system with all loops open.

    The inputs are `LOOPS`, `REFERENCE_SIGNALS`, `SPEED_COMMANDS`; the outputs `LOOPS`, `ESTIMATED_SIGNALS`,
    `SPEED_COMMANDS` and the true signals. Inputs `SPEED_COMMANDS` are added to the law's commands, after the outputs of
    that name.

    Args:
        robot: result of `period_map`; its outputs must not depend directly on an input.
        whole: whether to keep states that no input reaches or no output sees, the states of `robot` first.
    """
    angles = len(MEASURED_ANGLES)
    C_m, C_true = robot.C[:angles], robot.C[angles:]
    omega, rest = slice(0, 3), slice(3, None)
    moved = [robot.A + robot.B @ law.D[omega, :angles] @ C_m, robot.B @ law.C[omega]]
    A = np.block([moved, [law.B[:, :angles] @ C_m, law.A]])
    at_the_law = np.vstack([robot.B @ law.D[omega, angles:], law.B[:, angles:]])
    at_the_drives = np.vstack([robot.B, np.zeros((len(law.A), len(SPEED_COMMANDS)))])
    B = np.hstack([at_the_law, at_the_drives])
    signals, commands = ([law.D[part, :angles] @ C_m, law.C[part]] for part in (rest, omega))
    C = np.block([signals, commands, [C_true, np.zeros((len(C_true), len(law.A)))]])
    D = np.zeros((len(C), B.shape[1]))
    D[: len(law.D), : at_the_law.shape[1]] = np.vstack([law.D[rest, angles:], law.D[omega, angles:]])
    outputs = [*LOOPS, *ESTIMATED_SIGNALS, *SPEED_COMMANDS, *robot.output_labels[angles:]]
    used = np.arange(len(A)) if whole else linked_states(A, B, C)
    A, B, C = A[np.ix_(used, used)], B[used], C[:, used]
    return control.ss(
        A, B, C, D, robot.dt, inputs=[*LOOPS, *REFERENCE_SIGNALS, *SPEED_COMMANDS], outputs=outputs, name="loops"
    )


def linked_states(A: Matrix, B: Matrix, C: Matrix) -> NDArray[np.int64]:
    """Return the states that inputs reach and outputs see; others stay at rest and would be poles at z = 1."""
    linked = A != 0.0
    reached, seen = np.any(B != 0.0, axis=1), np.any(C != 0.0, axis=0)
    for _ in range(len(A)):
        reached, seen = reached | (linked @ reached), seen | (seen @ linked)
    return np.flatnonzero(reached & seen)


def closed_loops(loops: Loops, gains: Mapping[str, float]) -> Loops:
    """Close some loops, each with a factor on its law's gains; an input at a closed loop is added to its signal."""
    n = len(LOOPS)
    K = np.diag([gains.get(name, 0.0) for name in LOOPS])
    # a = K b + external inputs, b = C_b x + D_b a: solvable because no loop depends directly on itself
    share = np.linalg.inv(np.eye(n) - K @ loops.D[:n, :n])
    back, added = share @ K @ loops.C[:n], np.zeros((n, loops.ninputs))
    added[:, :n] = share
    added[:, n:] = share @ K @ loops.D[:n, n:]
    B_a, D_a = loops.B[:, :n], loops.D[:, :n]
    B, D = B_a @ added, D_a @ added
    B[:, n:] += loops.B[:, n:]
    D[:, n:] += loops.D[:, n:]
    A, C = loops.A + B_a @ back, loops.C + D_a @ back
    return control.ss(A, B, C, D, loops.dt, inputs=loops.input_labels, outputs=loops.output_labels)


def spectral_radius(loops: Loops, gains: Mapping[str, float]) -> float:
    """Return the largest magnitude of a pole of the closed loops; below 1 if stable."""
    return float(np.abs(closed_poles(loops, gains)).max())


def closed_poles(loops: Loops, gains: Mapping[str, float]) -> NDArray[np.complex128]:
    """Return the poles in z (n,) of the linear system with the given loops closed."""
    n = len(LOOPS)
    K = np.diag([gains.get(name, 0.0) for name in LOOPS])
    back = np.linalg.solve(np.eye(n) - K @ loops.D[:n, :n], K @ loops.C[:n])
    return np.linalg.eigvals(loops.A + loops.B[:, :n] @ back).astype(complex)
