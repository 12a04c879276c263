"""Identification of a robot from a log: every quantity with its interval, or a statement that it is not determined."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components

from twin.kernel.errors import TwinError
from twin.kernel.recording.logs.log import Log, LogError
from twin.robot.controller.controller import Belief
from twin.robot.mechanism.unreachable import Unreachable
from twin.studies.command import Say, Steps, ignore_progress
from twin.studies.identify import parameters as places
from twin.studies.identify.balance import deflections, pose, pressing_force, subtract_dead_zone
from twin.studies.identify.clustered import line
from twin.studies.identify.estimate import Estimate
from twin.studies.identify.fit import MAX_INTERVAL_SIZE, Fit, fit
from twin.studies.identify.one_pose import OnePose, one_pose
from twin.studies.identify.windows import MIN_CONTACT_FORCE, MIN_COUNTS, Windows, in_air, on_scale, windows
from twin.studies.replay.model import RobotModel
from twin.studies.replay.replay import estimates
from twin.studies.replay.samples import robot_samples

PLAUSIBLE_FACTOR = 5.0
"""Maximum factor between identified and believed k_s eta; beyond it units or signs are wrong."""
LEVEL_PARAMETERS = (places.HEIGHT, places.SLOPE, places.SLOPE + 1)
"""Known parameters of a level scale whose height was measured."""
MAX_DEPTH_MISFIT = 2.0
"""Maximum misfit of depths under load by the misfit of the springs, or by rounding (4 micrometres); beyond it the
pressed surface is skin, or not a plane, and its law is left out."""
MIN_LOSS = 0.02
"""Minimum ln(eta) of a lossy belt; friction and the scale's delay leave less."""
SLIDING_SPEED = 1e-3
"""Minimum speed of sliding (m/s)."""
MAX_MU_INTERVAL = 0.1
SETTLED_TIME = 0.35
"""Minimum time in one direction (s): the slowest sweep passes the 0.3 mm of the bristles' stretch."""


class NotIdentifiable(TwinError):
    """Error: a valid log does not determine the requested quantity; the message has the reason and data to record."""

    exit_code = 1


@dataclass(frozen=True)
class Quantity:
    """Identified quantity, SI but for `estimate.unit`: meaning, believed value or None, estimate or None."""

    meaning: str
    believed: float | None
    found: Estimate | None


@dataclass(frozen=True)
class Identification:
    """Result of the identification of a robot.

    Attributes:
        one_pose: the paper's procedure on the same log; None without a gradual press.
        inseparable: groups of unknowns that this log cannot separate.
    """

    model: RobotModel
    fit: Fit
    seen: Windows
    quantities: Mapping[str, Quantity]
    one_pose: OnePose | None
    inseparable: tuple[tuple[str, ...], ...]
    notes: tuple[str, ...]

    @property
    def knows_loss(self) -> bool:
        """Whether ln(eta) is known, for belt losses by direction, from a comparison of loading and unloading."""
        return self.fit.is_determined(self.fit.direction(places.LOSS), self.fit.unknowns[places.LOSS].size)

    def estimate(self, name: str) -> Estimate:
        """Return the estimate of an identified quantity; raise KeyError if it is not determined."""
        found = self.quantities[name].found
        if found is None:
            raise KeyError(name)
        return found


def identify_log(
    log: Log, model: RobotModel, height: float | None = None, motor_torque: bool = False, say: Say = ignore_progress
) -> Identification:
    """Identify springs, zeros, backlash, friction and scale of a robot from a log with encoders and scale.

    Args:
        height: measured height of a level scale (m), which makes the joints' zeros exact; None if unknown.
        motor_torque: whether drive/n.tau_motor is a measured torque.

    Raises:
        LogError: signals are missing, in wrong units or of the wrong sign.
        NotIdentifiable: the log does not determine k_s eta.
    """
    belief, steps = model.belief, Steps(say, 4)
    steps.next("looking for slow motion")
    taken = robot_samples(log, belief)
    # refuses columns that do not fit the map
    estimates(taken, model)
    seen = windows(taken, belief)
    path = log.path
    if len(seen.t) and np.min(seen.lowest) < -MIN_CONTACT_FORCE:
        raise LogError(
            f"{path}: scale.F_z goes down to {np.min(seen.lowest):.2f} N, but a press is positive and no scale is "
            "pulled; turn its sign with --map scale.F_z=-COLUMN[N], or tare it"
        )
    if not len(seen.t):
        raise NotIdentifiable(
            f"{path}: the robot never moves slowly and evenly: no {seen.length:g} s in which the motors cross "
            f"{MIN_COUNTS:g} counts without a jerk; move on the scale and in free air, as "
            "experiments/calibration.toml does"
        )
    if not np.any(in_air(seen)):
        raise LogError(
            f"{path}: scale.F_z never shows free air, its least is {np.min(seen.lowest):.2f} N; tare the scale, and "
            "record motion off it as well"
        )
    unknowns = places.parameters(belief, model.plant.z_s if height is None else height)
    fixed = () if height is None else LEVEL_PARAMETERS
    notes = taken.notes
    steps.next("fitting springs and scale")
    try:
        found = fit(seen, belief, unknowns, model.resolution, fixed)
        springs, depth = found.misfit(0, 1), found.misfit(2)
        if depth > MAX_DEPTH_MISFIT * max(springs, 1.0):
            notes += (
                f"the depths under load are {depth:.0f} times farther from those of a spring on a plane, "
                "F = K d (1 + c d'), than rounding explains: that law was left out, and with it what it says of "
                "height, stiffness and the joints' zeros",
            )
            steps.share("fitting without the surface", 0.5)
            found = fit(seen, belief, unknowns, model.resolution, fixed, surface=False)
    except Unreachable as problem:
        raise LogError(
            f"{path}: {problem}; do units, signs and zeros of the joint encoders match the experiment?"
        ) from None
    _refuse_nonsense(found, belief, log)
    split = _stiffness_quantities(found, belief, log, motor_torque)
    quantities = {**split, **_quantities(found, height)}
    steps.next("friction")
    quantities["friction"] = Quantity("friction under the head", None, friction(found, seen, belief))
    steps.next("one pose")
    press = one_pose(seen, belief, found.x)
    return Identification(model, found, seen, quantities, press, _inseparable_groups(found), notes)


def _refuse_nonsense(found: Fit, belief: Belief, log: Log) -> None:
    """Reject a fit whose k_s eta (stiffness times belt efficiency) is undetermined, implausible or not converged.

    LogError, because units or signs are probably wrong: more than `PLAUSIBLE_FACTOR` times away from the belief, or no
    convergence. NotIdentifiable: the slow motion in the air and on the scale does not determine it.
    """
    k, believed, axis = found.x[places.KAPPA], belief.k_s * belief.eta, found.direction(places.KAPPA)
    pressing, air = int(np.sum(on_scale(found.seen))), int(np.sum(in_air(found.seen)))
    plausible = 1.0 / PLAUSIBLE_FACTOR < k / believed < PLAUSIBLE_FACTOR
    determined = found.is_determined(axis, found.unknowns[places.KAPPA].size)
    if determined and plausible and found.converged:
        return
    doubt = (
        "is the scale in N, are N and counts per turn those of this robot, and do motors and joints count in the same "
        "sense?"
    )
    if not plausible and (found.is_determined(axis, k) or pressing > 10):
        raise LogError(
            f"{log.path}: k_s eta comes out more than {PLAUSIBLE_FACTOR:g} times away from the believed "
            f"{believed:g} N m/rad; {doubt}"
        )
    if not found.converged or not len(found.seen.t):
        raise LogError(f"{log.path}: no k_s eta, zeros and backlash at all meet statics in its slow motion; {doubt}")
    share = found.half_width(axis) / believed
    left = f"{100.0 * share:.0f} % of it" if share < 1.0 else "it"
    raise NotIdentifiable(
        f"{log.path}: k_s eta is undetermined: {air} usable windows in free air and {pressing} on the scale leave "
        f"{left} open; press gradually, in several places, up and down, as experiments/calibration.toml does"
    )


def _stiffness_quantities(found: Fit, belief: Belief, log: Log, motor_torque: bool) -> dict[str, Quantity]:
    """Collect k_s eta, and k_s and eta if motor torque or direction-dependent losses separate them."""
    product = Estimate(float(found.x[places.KAPPA]), found.half_width(found.direction(places.KAPPA)), "N m/rad")
    k_s, eta, meaning = None, None, "k_s eta"
    axis = found.direction(places.LOSS)
    loss, width = float(found.x[places.LOSS]), found.half_width(axis)
    if motor_torque:
        k_s = spring_stiffness(found, belief, log)
        if k_s is not None:
            ratio = product.value / k_s.value
            share = float(np.hypot(product.half_width / product.value, k_s.half_width / k_s.value))
            eta = Estimate(ratio, ratio * share, "1")
    elif found.is_determined(axis, found.unknowns[places.LOSS].size) and loss + width < -MIN_LOSS:
        # with direction-dependent losses (P1) the geometric mean of e^(+loss) and e^(-loss) is free of eta
        meaning = "k_s eta, mean of directions"
        k_s, eta = product, Estimate(float(np.exp(loss)), float(np.exp(loss)) * width, "1")
    return {
        "k_s_eta": Quantity(meaning, belief.k_s * belief.eta, product),
        "k_s": Quantity("k_s alone", belief.k_s, k_s),
        "eta": Quantity("eta alone", belief.eta, eta),
    }


def _quantities(found: Fit, height: float | None) -> dict[str, Quantity]:
    """Collect the identified quantities other than stiffness, with the scale's stiffness instead of its compliance."""
    reported: dict[str, Quantity] = {}
    for index, one in enumerate(found.unknowns):
        if index in (places.KAPPA, places.LOSS, places.RATE) or (index in LEVEL_PARAMETERS and height is not None):
            continue
        axis, x = found.direction(index), float(found.x[index])
        estimate = Estimate(x, found.half_width(axis), one.unit) if found.is_determined(axis, one.size) else None
        if index == places.COMPLIANCE:
            if estimate is not None:
                estimate = Estimate(1.0 / x, estimate.half_width / x**2, "N/m")
            reported["stiffness"] = Quantity("stiffness of the scale", None, estimate)
            continue
        is_believed = index == places.HEIGHT or (one.unit == "rad" and index not in LEVEL_PARAMETERS)
        reported[one.name] = Quantity(one.meaning, one.start if is_believed else None, estimate)
    return reported


def _inseparable_groups(found: Fit) -> tuple[tuple[str, ...], ...]:
    """Group the unknowns that the log cannot separate because they share an undetermined direction."""
    hidden = np.abs(found.unseen @ found.unseen.T)
    # the rate of a loss is meaningless without a loss
    members = np.setdiff1d(np.flatnonzero(np.sqrt(np.diag(hidden)) > MAX_INTERVAL_SIZE), places.RATE)
    _, group = connected_components(hidden[np.ix_(members, members)] > MAX_INTERVAL_SIZE**2, directed=False)
    return tuple(
        tuple(found.unknowns[i].meaning for i in members[group == number]) for number in dict.fromkeys(group.tolist())
    )


def friction(springs: Fit, seen: Windows, belief: Belief) -> Estimate | None:
    """Estimate mu under the head from sliding windows in order of time; None without sliding."""
    at = pose(belief, seen.joint - springs.x[places.JOINT_ZERO : places.JOINT_ZERO + 3])
    v = np.linalg.solve(at.J, seen.speed[..., None])[..., 0]
    sliding = _sliding(seen, v[:, :2])
    if not np.any(sliding):
        return None
    swept = seen.select(sliding)
    along = v[sliding, :2] / np.linalg.norm(v[sliding, :2], axis=1, keepdims=True)
    A = _friction_equations(swept.force, along)

    def sideways(x: NDArray[np.float64]) -> NDArray[np.float64]:
        return pressing_force(x, swept, belief)[:, :2].ravel()

    found = line(A, sideways(springs.x), np.repeat(swept.cluster, 2))
    if found is None:
        return None
    mu = np.linalg.pinv(A)[0]
    through = springs.half_width_through(lambda x: float(mu @ sideways(x)))
    width = float(np.hypot(found.half_widths[0], through))
    return Estimate(float(found.coefficients[0]), width, "1") if width < MAX_MU_INTERVAL else None


def _friction_equations(force: NDArray[np.float64], along: NDArray[np.float64]) -> NDArray[np.float64]:
    """Compute the factors of mu and beta in F_t (2n, 3); `along` (n, 2): direction of each window's motion."""
    A = np.zeros((2 * len(force), 3))
    A[:, 0] = (force[:, None] * along).ravel()
    A[0::2, 1] = A[1::2, 2] = 1.0
    # one-way sweeps cannot separate zeros from friction, and use the identified zeros
    both = np.linalg.norm(along.mean(axis=0)) < 0.7
    return A if both else A[:, :1]


def _sliding(seen: Windows, v: NDArray[np.floating]) -> NDArray[np.bool_]:
    """Mark the windows (n,) on the scale where the head moves in one direction for `SETTLED_TIME`; v (n, 2), m/s."""
    speed = np.linalg.norm(v, axis=1)
    moving = np.flatnonzero(on_scale(seen) & (speed > SLIDING_SPEED))
    heading = v[moving] / speed[moving, None]
    straight = np.sum(heading[1:] * heading[:-1], axis=1) > 0.9
    sliding = np.zeros(len(seen.t), dtype=bool)
    if len(moving):
        for run in seen.runs(moving, straight):
            sliding[run[seen.t[run] > seen.t[run[0]] + SETTLED_TIME]] = True
    return sliding


def spring_stiffness(springs: Fit, belief: Belief, log: Log) -> Estimate | None:
    """Estimate k_s (N m/rad) from drive/1.tau_motor to drive/3.tau_motor; None if the torque does not vary."""
    seen = springs.seen
    torque = np.stack([_mean_torque(log, f"drive/{i}.tau_motor", seen) for i in (1, 2, 3)], axis=1).ravel()

    def equations(x: NDArray[np.float64]) -> NDArray[np.float64]:
        A = np.zeros((3 * len(seen.t), 7))
        A[:, 0] = subtract_dead_zone(deflections(x, seen, belief.N), x[places.BACKLASH]).ravel()
        for i in range(3):
            A[i::3, 1 + i] = np.sign(seen.speed[:, i])
            A[i::3, 4 + i] = 1.0
        return A

    found = line(equations(springs.x), torque, np.repeat(seen.cluster, 3))
    if found is None:
        return None
    through = springs.half_width_through(lambda x: float(np.linalg.pinv(equations(x))[0] @ torque))
    return Estimate(float(found.coefficients[0]), float(np.hypot(found.half_widths[0], through)), "N m/rad")


def _mean_torque(log: Log, name: str, seen: Windows) -> NDArray[np.float64]:
    if name not in log.series:
        raise LogError(
            f"{log.path}: '{name}' is not there; --motor-torque needs the torques of all three motors: choose with "
            f"--map {name}=COLUMN[N m]"
        )
    series = log.series[name]
    if series.unit != "N m":
        raise LogError(f"{log.path}: {name} is in '{series.unit}', expected 'N m'; a current is not a torque")
    total = np.concatenate([[0.0], np.cumsum(series.values)])
    first = np.searchsorted(series.t, seen.t - 0.5 * seen.length)
    last = np.maximum(np.searchsorted(series.t, seen.t + 0.5 * seen.length), first + 1)
    last = np.minimum(last, len(series.t))
    return (total[last] - total[first]) / np.maximum(last - first, 1)
