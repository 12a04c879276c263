"""A log as windows of slow motion: the only samples that say anything about statics.

An encoder is read in steps. While the robot stands, every sample has the same rounding error and a mean of thousands is
no better than one; while it moves across several counts the errors run through their range and their mean vanishes. So
a window is kept if every motor crosses some counts in it, and if it neither starts, stops nor turns.

A number with its interval, and in which unit and with how many digits it is read.

What is estimated: names, units, the size at which an error matters, and where the search starts.

What statics asks of every window: three equations per pose in free air, two on the scale.

With the deflection w = motor - N joint - w_0 as the encoders read it, w_0 its zero, k = k_s eta, b the half width of
the dead zone and s = sign(w) tanh(theta_l'/rate), the spring's torque is (18)-(20) with the losses of (P1)

    tau_l = k N e^(loss s) dead_zone(w, b)

and the slow robot obeys (P5), docs/physics.md, without the terms in the square of speed,

    J^T (tau_l + g_a - b_j theta_l' - I_a theta_l'') - W e_z - m p'' = F_ee,  p'' = J^-1 theta_l''.

In free air F_ee = 0: three equations. On the scale F_ee,z = -F is measured, but the bristles of friction pull sideways
by up to mu F, unmeasured: only the z row holds, whatever they do. All are divided by k N (and by the length
of the z column of J), so that residuals are deflections in rad: the rounding of the encoders is then the error of the
response and not of the regressor, which would bias k low. The second equation on the scale is its own law, Hunt and
Crossley's at a slow speed, on a plane of slopes m_x and m_y:

    p_z = z_s + m_x p_x + m_y p_y - C F / (1 - c p_z')

A scale shows its force late; F is its reading and delay times the reading's slope.

The paper's own calibration (Sec. III.A), and why it is biased. "We allow the massage manipulator to touch the surface
of the electronic scale, gradually increasing the z-axis position. Comparing the force calculated via the proposed
static force model with the force measured by the electronic scale": one place, one press, and k_s eta scaled until F_z
of (27) is what the scale shows, a line through the origin. (27) has no weight in it, the encoders' zeros are what they
are, and the dead zone takes some of the deflection; each of them is put right in turn here.
"""

from dataclasses import dataclass
from math import degrees, floor, log10
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin.kernel.recording.logs.log import LogRefused, in_gap
from twin.robot.controller.controller import Belief
from twin.robot.mechanism.geometry import Geometry
from twin.robot.mechanism.kinematics import jacobian_rows, position
from twin.robot.mechanism.statics import arm_gravity_torque, platform_weight
from twin.studies.replay.samples import RobotSamples

SHOWN = {"rad": (degrees(1.0), "deg"), "m": (1e3, "mm"), "s": (1e3, "ms"), "1": (1.0, "")}
LENGTH = 0.1
"""s: shorter than the 0.2 s of a press's changes of sign, longer than a period of the free modes (75 rad/s)."""
COUNTS = 4.0
"""Motor counts that have to be crossed in a window, on average over the joints."""
ACCELERATION = 0.05
"""m/s2: with 0.3 kg, 0.015 N of inertia, a third of a step of the paper's scale; the balance knows of nine tenths."""
JOINTS_PER_METRE = 17.0
"""rad/m: d theta_l / d p_z at home."""
GUARD = 0.1
"""s: a scale may show what it carries this late; until then it is open whether the robot still touches it."""
CLUSTER = 2.0
"""s: windows this close share errors (a place, a press, a turn of an encoder) and are no independent witnesses."""
KAPPA, LOSS, RATE, OFFSET, JOINT_ZERO, BACKLASH, FRICTION, HEIGHT, SLOPE, COMPLIANCE, DAMPING, DELAY = (
    0, 1, 2, 3, 6, 9, 10, 11, 12, 14, 15, 16
)  # fmt: skip
"""Where each stands in a vector of parameters; offsets and joint zeros are three each, slopes two."""
COUNT = 17
AIR = 0.05
"""N: less is free air; twice the step of the paper's scale."""
CONTACT = 0.15
"""N: more, all through a window, is contact."""
PLAUSIBLE_COMPLIANCE = 1e-3
"""m/N: only weighs the reading's steps against those of the encoders."""
RISE = 1.0
"""N: a press that gains less says nothing."""
PLACE = 2e-3
"""m: a press that moves farther sideways is a sweep."""


class Estimate(NamedTuple):
    """value +- half_width, a 95 % interval, in the SI unit `unit`."""

    value: float
    half_width: float
    unit: str


def shown(value: float, unit: str) -> float:
    """`value` (SI) in the unit that people read."""
    return value * SHOWN.get(unit, (1.0, unit))[0]


def shown_unit(unit: str) -> str:
    """The unit that people read."""
    return SHOWN.get(unit, (1.0, unit))[1]


def decimals(estimate: Estimate) -> int:
    """Digits after the point that an interval with two significant digits needs."""
    width = shown(estimate.half_width, estimate.unit)
    return 0 if not 0.0 < width < 1e6 else min(max(1 - floor(log10(width)), 0), 6)


class Windows(NamedTuple):
    """Means over windows, SI.

    Attributes:
        t: middle of each (n,), s.
        motor, joint: what the encoders read, zeros included (n, 3), rad.
        speed: of the joints (n, 3), rad/s.
        acceleration: of the joints (n, 3), rad/s2.
        spread: half of the range that the deflection motor - N joint runs through (n, 3), rad.
        force: of the scale, pressing positive (n,), N.
        force_rate: its slope (n,), N/s.
        lowest, highest: force in the window and for `GUARD` after it (n,), N.
        cluster: number of the group of windows each belongs to (n,), for the covariance.
        length: of each, s.
    """

    t: NDArray[np.float64]
    motor: NDArray[np.float64]
    joint: NDArray[np.float64]
    speed: NDArray[np.float64]
    acceleration: NDArray[np.float64]
    spread: NDArray[np.float64]
    force: NDArray[np.float64]
    force_rate: NDArray[np.float64]
    lowest: NDArray[np.float64]
    highest: NDArray[np.float64]
    cluster: NDArray[np.int64]
    length: float

    def where(self, chosen: NDArray[np.bool_]) -> "Windows":
        """The `chosen` (n,) ones."""
        columns: dict[str, Any] = {name: getattr(self, name)[chosen] for name in self._fields if name != "length"}
        return self._replace(**columns)

    def runs(self, chosen: NDArray[np.intp], joined: NDArray[np.bool_]) -> list[NDArray[np.intp]]:
        """The windows `chosen` (m,) in runs without a pause, broken also where `joined` (m - 1,) is False.

        Two windows lost in a row are no pause: a motor that takes up its backlash for a moment costs as many.
        """
        pause = np.diff(self.t[chosen]) > 3.5 * self.length
        return np.split(chosen, np.flatnonzero(pause | ~joined) + 1)


def windows(log: RobotSamples, belief: Belief) -> Windows:
    """The windows of `log` that are fit for statics; none is an answer, too.

    Args:
        log: with a measured force.
        belief: of counts per turn and N.

    Raises:
        LogRefused: no force was measured, or never together with the encoders.
    """
    if log.force is None:
        raise LogRefused(
            f"{log.path}: no measured force: without it nothing ties the springs to a newton; name the scale's "
            "column with --map scale.F_z=COLUMN[N], pressing positive"
        )
    force = log.force
    length = max(LENGTH, 10.0 * log.sampling.period, 2.0 * float(np.median(np.diff(force.t))))
    bins = np.floor((log.t - log.t[0]) / length).astype(np.int64)
    known = (log.t >= force.t[0]) & (log.t <= force.t[-1]) & ~in_gap(log.t, force.sampling.gaps)
    F = np.interp(log.t, force.t, force.values)
    known &= np.isfinite(F) & np.all(np.isfinite(log.counts), axis=1)
    if not np.any(known):
        raise LogRefused(f"{log.path}: encoders and scale were never recorded at the same time")
    motor = log.only("count_m") * (2.0 * np.pi / belief.motor_counts)
    joint = log.only("count_l") * (2.0 * np.pi / belief.joint_counts)
    full, late = 0.8 * length / log.sampling.period, round(GUARD / log.sampling.period)
    rows = [
        _window(log.t[a:b], motor[a:b], joint[a:b], F[a:b], F[a : b + late], belief.N)
        for a, b in zip(*_edges(bins), strict=True)
        if b - a >= full and np.all(known[a:b])
    ]
    columns: list[Any] = [np.array(column) for column in zip(*rows, strict=True)] or [
        np.empty((0, 3) if wide else 0) for wide in (0, 1, 1, 1, 1, 1, 0, 0, 0, 0, 1)
    ]
    *means, travel = columns
    every = Windows._make([*means, np.floor(means[0] / CLUSTER).astype(np.int64), length])
    counts = np.mean(travel, axis=1) * belief.motor_counts / (2.0 * np.pi)
    calm = np.all(np.abs(every.acceleration) <= ACCELERATION * JOINTS_PER_METRE, axis=1)
    return every.where((counts >= COUNTS) & calm)


def _edges(bins: NDArray[np.int64]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """First and past-the-last index of each run of equal `bins` (n,)."""
    turns = np.flatnonzero(np.diff(bins)) + 1
    return np.concatenate([[0], turns]), np.concatenate([turns, [len(bins)]])


def _window(t, motor, joint, F, F_and_later, N) -> tuple[object, ...]:
    """One row of the columns of `Windows`, then range of the motors (3,)."""
    half = len(t) // 2
    # slopes of both halves by regression: an encoder's step costs them least
    first, last = (_slope(t[part], joint[part]) for part in (slice(None, half), slice(half, None)))
    acceleration = (last - first) / (t[half:].mean() - t[:half].mean())
    return (
        float(np.mean(t)), motor.mean(axis=0), joint.mean(axis=0), _slope(t, joint), acceleration,
        0.5 * np.ptp(motor - N * joint, axis=0), float(np.mean(F)), float(_slope(t, F)), float(np.min(F_and_later)),
        float(np.max(F_and_later)), np.ptp(motor, axis=0),
    )  # fmt: skip


def _slope(t: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
    """Of the straight lines through y (n, ...) over t (n,)."""
    centred = t - t.mean()
    return centred @ y / (centred @ centred)


@dataclass(frozen=True)
class Parameter:
    """One unknown.

    Attributes:
        name: as in facts; vectors count from 1.
        meaning: for people.
        unit: SI.
        start: the believed value.
        size: plausible difference of belief and truth; only a parameter known to a tenth of it is reported.
    """

    name: str
    meaning: str
    unit: str
    start: float
    size: float


def parameters(belief: Belief, height: float) -> tuple[Parameter, ...]:
    """The unknowns in their order, starting from `belief` and a believed `height` of the scale (m)."""
    k = belief.k_s * belief.eta
    offsets = np.subtract(belief.motor_zero, np.multiply(belief.N, belief.joint_zero))
    degree = float(np.radians(1.0))
    return (
        Parameter("k_s_eta", "k_s eta", "N m/rad", k, k),
        Parameter("loss", "ln(eta) of a belt that loses by direction", "1", 0.0, 0.5),
        Parameter("loss_rate", "speed at which its losses turn over", "rad/s", 0.01, 0.05),
        *(Parameter(f"deflection_zero_{i + 1}", f"zero of deflection {i + 1}", "rad", float(offsets[i]), degree)
          for i in range(3)),
        *(Parameter(f"joint_zero_{i + 1}", f"zero of joint {i + 1}", "rad", belief.joint_zero[i], degree)
          for i in range(3)),
        Parameter("backlash", "backlash, half width", "rad", belief.backlash, 0.5 * degree),
        Parameter("b_j", "viscous friction of a joint", "N m s/rad", 0.0, 0.02),
        Parameter("height", "height of the scale", "m", height, 5e-3),
        *(Parameter(f"slope_{axis}", f"slope of the scale along {axis}", "rad", 0.0, degree) for axis in "xy"),
        Parameter("compliance", "compliance of the scale", "m/N", 1e-3, 1e-3),
        Parameter("damping", "damping of the scale", "s/m", 0.0, 10.0),
        Parameter("delay", "delay of the scale", "s", 0.0, 0.1),
    )  # fmt: skip


def starts(unknowns: tuple[Parameter, ...]) -> NDArray[np.float64]:
    """Where the search starts (n,)."""
    return np.array([one.start for one in unknowns])


def sizes(unknowns: tuple[Parameter, ...]) -> NDArray[np.float64]:
    """How far each may plausibly be off (n,)."""
    return np.array([one.size for one in unknowns])


class Pose(NamedTuple):
    """Where windows are.

    Attributes:
        p_B: (n, 3), m.
        J: d theta_l / d p_B (n, 3, 3), rad/m.
        g_a: weight of the arms (n, 3), N m.
        lift: d p_z / d theta_l (n, 3), m/rad: the third row of J^-1, so that J^-T e_z is the same.
    """

    p_B: NDArray[np.float64]
    J: NDArray[np.float64]
    g_a: NDArray[np.float64]
    lift: NDArray[np.float64]


class Equations(NamedTuple):
    """Equations of all windows.

    Attributes:
        residual: (m,), rad or m.
        sigma: what rounding alone would leave in one of them (m,), of a single sample.
        window: which window each is of (m,).
        kind: 0 free air, 1 force on the scale, 2 depth in the scale (m,).
        per_newton: residual of kind 1 for each newton (k,), rad/N.
    """

    residual: NDArray[np.float64]
    sigma: NDArray[np.float64]
    window: NDArray[np.int64]
    kind: NDArray[np.int64]
    per_newton: NDArray[np.float64]


def pose(belief: Belief, theta_l: NDArray[np.float64]) -> Pose:
    """Kinematics and weight at joint angles theta_l (n, 3), rad.

    Raises:
        Unreachable: some do not close.
    """
    geometry = Geometry(belief.a, belief.b, belief.l_a, belief.l_b)
    p_B = position(geometry, theta_l)
    J = jacobian_rows(geometry, theta_l, p_B)
    inverse = np.asarray(np.linalg.inv(J), dtype=np.float64)
    arms = np.vectorize(lambda theta: arm_gravity_torque(belief, belief, theta), otypes=[float])(theta_l)
    return Pose(p_B, J, arms, inverse[:, 2])


def deflections(x: NDArray[np.float64], seen: Windows, N: float) -> NDArray[np.float64]:
    """motor - N joint - zero (n, 3), rad."""
    return seen.motor - N * seen.joint - x[OFFSET : OFFSET + 3]


def loaded(w: NDArray[np.float64], half_width: float) -> NDArray[np.float64]:
    """Deflection less the dead zone, of the shape of `w`: `sea.dead_zone` for arrays."""
    return np.sign(w) * np.maximum(np.abs(w) - half_width, 0.0)


def clear(x: NDArray[np.float64], seen: Windows, N: float) -> NDArray[np.bool_]:
    """Windows (n,) in which no deflection comes near the edges of its dead zone, where mean and law do not swap."""
    return np.all(np.abs(deflections(x, seen, N)) > max(x[BACKLASH], 0.0) + seen.spread, axis=1)


def in_air(seen: Windows) -> NDArray[np.bool_]:
    """Windows (n,) that touch nothing."""
    return (seen.highest < AIR) & (seen.lowest > -AIR)


def on_scale(seen: Windows) -> NDArray[np.bool_]:
    """Windows (n,) in contact all through."""
    return seen.lowest > CONTACT


def joint_torques(x: NDArray[np.float64], seen: Windows, N: float) -> NDArray[np.float64]:
    """tau_l - b_j theta_l' (n, 3), N m: what the joints pass on to the links."""
    d = loaded(deflections(x, seen, N), x[BACKLASH])
    direction = np.sign(d) * np.tanh(seen.speed / x[RATE])
    return x[KAPPA] * N * np.exp(x[LOSS] * direction) * d - x[FRICTION] * seen.speed


def inertia(seen: Windows, belief: Belief, at: Pose) -> NDArray[np.float64]:
    """Torque that accelerates the robot (n, 3), N m; without I_r, which is not believed: a tenth of it all."""
    I_a = (belief.m_a / 3.0 + belief.m_b / 2.0) * belief.l_a**2
    mass = belief.m_p + 1.5 * belief.m_b
    a_B = np.linalg.solve(at.J, seen.acceleration[..., None])
    torque: NDArray[np.float64] = mass * np.linalg.solve(at.J.transpose(0, 2, 1), a_B)[..., 0]
    return torque + I_a * seen.acceleration


def rows(
    x: NDArray[np.float64], seen: Windows, belief: Belief, resolution: float, at: Pose, surface: bool = True
) -> Equations:
    """Residuals of all equations at parameters `x` (17,).

    Args:
        seen: windows in free air or in contact.
        belief: geometry, masses, N and counts.
        resolution: step of the force (N).
        at: `pose` at x's zeros of the joints.
        surface: whether the depth in the scale is held against the scale's law, too.
    """
    W = platform_weight(belief)
    torque = joint_torques(x, seen, belief.N) + at.g_a - inertia(seen, belief, at)
    air, scale = np.flatnonzero(in_air(seen)), np.flatnonzero(on_scale(seen))
    per_torque = 1.0 / (x[KAPPA] * belief.N)
    step_m, step_l = 2.0 * np.pi / belief.motor_counts, 2.0 * np.pi / belief.joint_counts
    rounding = np.hypot(step_m, belief.N * step_l) / np.sqrt(12.0)

    joints = (torque[air] - W * at.lift[air]) * per_torque

    J_z = at.J[scale, :, 2]
    length = np.linalg.norm(J_z, axis=1)
    F = seen.force[scale] + x[DELAY] * seen.force_rate[scale]
    per_newton = per_torque / length
    force = (np.sum(J_z * torque[scale], axis=1) - W + F) * per_newton
    force_rounding = np.hypot(rounding, resolution / np.sqrt(12.0) * per_newton)

    law = slice(None) if surface else slice(0)
    under = scale[law]
    rate = np.sum(at.lift[under] * seen.speed[under], axis=1)
    plane = x[HEIGHT] + at.p_B[under, :2] @ x[SLOPE : SLOPE + 2]
    depth = at.p_B[under, 2] - plane + x[COMPLIANCE] * F[law] / (1.0 - x[DAMPING] * rate)
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
    """F_ee_B (n, 3) in N by statics with the parameters `x`, the robot's weight taken off."""
    at = pose(belief, seen.joint - x[JOINT_ZERO : JOINT_ZERO + 3])
    F = np.einsum("nij,ni->nj", at.J, joint_torques(x, seen, belief.N) + at.g_a - inertia(seen, belief, at))
    F[:, 2] -= platform_weight(belief)
    return F


class OnePoseStep(NamedTuple):
    """One way to read the press. name: what it takes into account; k_s_eta (N m/rad) of a line through the origin."""

    name: str
    k_s_eta: float


class OnePose(NamedTuple):
    """The paper's procedure on one press.

    Attributes:
        place: (2,), m.
        start, end: s.
        force: scale (n,), N.
        calculated: F_z as (27) has it with the believed k_s eta (n,), N.
        steps: as printed, then with one cause after the other taken away.
    """

    place: NDArray[np.float64]
    start: float
    end: float
    force: NDArray[np.float64]
    calculated: NDArray[np.float64]
    steps: tuple[OnePoseStep, ...]


def one_pose(seen: Windows, belief: Belief, x: NDArray[np.float64]) -> OnePose | None:
    """The paper's procedure on the press nearest to the middle; None if there is no gradual press.

    Args:
        seen: windows in order of time.
        belief: what the robot is taken for.
        x: the identified parameters.
    """
    press = _press(seen, belief)
    if press is None:
        return None
    w = press.motor - belief.N * press.joint
    offset = np.subtract(belief.motor_zero, np.multiply(belief.N, belief.joint_zero))
    k, F = belief.k_s * belief.eta, press.force
    printed, weight = _pressing(k, w - offset, belief, press, np.array(belief.joint_zero))
    zeroed, own_weight = _pressing(k, w - x[OFFSET : OFFSET + 3], belief, press, x[JOINT_ZERO : JOINT_ZERO + 3])
    d = loaded(w - x[OFFSET : OFFSET + 3], x[BACKLASH])
    freed, _ = _pressing(k, d, belief, press, x[JOINT_ZERO : JOINT_ZERO + 3])
    steps = (
        OnePoseStep("as printed", k * _through_origin(printed, F)),
        OnePoseStep("weight taken off", k * _through_origin(printed, F - weight)),
        OnePoseStep("and the zeros", k * _through_origin(zeroed, F - own_weight)),
        OnePoseStep("and the dead zone", k * _through_origin(freed, F - own_weight)),
    )
    p_B = pose(belief, press.joint - np.array(belief.joint_zero)).p_B
    return OnePose(p_B[:, :2].mean(axis=0), float(press.t[0]), float(press.t[-1]), F, printed, steps)


def _press(seen: Windows, belief: Belief) -> Windows | None:
    """The loading half of the press nearest to the base's axis; of those, the one that gains most."""
    chosen = np.flatnonzero(on_scale(seen))
    if len(chosen) < 3:
        return None
    F = seen.force[chosen]
    p_B = pose(belief, seen.joint - np.array(belief.joint_zero)).p_B[:, :2]
    found = []
    for part in seen.runs(chosen, np.diff(F) > 0.0):
        if np.ptp(seen.force[part]) >= RISE and np.max(np.ptp(p_B[part], axis=0)) <= PLACE and len(part) >= 3:
            # to 5 mm: repeated presses of one place are the same place
            distance = round(float(np.linalg.norm(p_B[part].mean(axis=0))) / 5e-3)
            found.append((distance, -float(np.ptp(seen.force[part])), part))
    if not found:
        return None
    mask = np.zeros(len(seen.t), dtype=bool)
    mask[min(found, key=lambda one: one[:2])[2]] = True
    return seen.where(mask)


def _pressing(k, w, belief, press, joint_zero) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """-F_ee,z of (27) without weight for deflections w (n, 3), and what the weight adds to it (n,), N."""
    at = pose(belief, press.joint - joint_zero)
    J_z = at.J[:, :, 2]
    return -np.sum(J_z * (k * belief.N * w), axis=1), platform_weight(belief) - np.sum(J_z * at.g_a, axis=1)


def _through_origin(calculated: NDArray[np.float64], force: NDArray[np.float64]) -> float:
    """Of the line force = s calculated through the origin: what k_s eta has to be multiplied by."""
    return float(calculated @ force / (calculated @ calculated))
