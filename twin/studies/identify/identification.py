"""A log identified: every quantity with its interval, or the plain statement that it cannot be had from this log.

Least squares that knows what it cannot know.

The unknowns, in units of their sizes, go through a Gauss-Newton search. At each step the singular values of the
whitened Jacobian say how well each direction of parameter space is seen; a direction that rounding alone leaves
uncertain by more than `BLIND` sizes is not moved in at all: what the data cannot see stays as it is believed, and is
named. Intervals are those of clustered errors (`clustered.sandwich`), which asks nothing of the errors within one, but
no narrower than if all errors were independent and of one size: few clusters can agree by chance.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components

from twin.kernel.errors import TwinError
from twin.kernel.recording.logs.log import Log, LogRefused
from twin.robot.controller.controller import Belief
from twin.robot.mechanism.unreachable import Unreachable
from twin.studies.command import Say, Steps, silent
from twin.studies.identify.clustered import line, sandwich, t_factor
from twin.studies.identify.windows import (
    BACKLASH,
    COMPLIANCE,
    CONTACT,
    COUNT,
    COUNTS,
    HEIGHT,
    JOINT_ZERO,
    KAPPA,
    LOSS,
    RATE,
    SLOPE,
    Equations,
    Estimate,
    OnePose,
    Parameter,
    Windows,
    clear,
    deflections,
    in_air,
    loaded,
    on_scale,
    one_pose,
    parameters,
    pose,
    pressing_force,
    rows,
    sizes,
    starts,
    windows,
)
from twin.studies.replay.model import RobotModel
from twin.studies.replay.replay import estimates
from twin.studies.replay.samples import robot_samples

BLIND = 0.3
"""Sizes: a direction that is known to no better than this is not seen."""
WIDEST = 0.1
"""Sizes: a parameter is reported if its interval and what hides in unseen directions stay within this."""
JOINTS = slice(JOINT_ZERO, JOINT_ZERO + 3)
DIFFERENCE = 1e-5
"""Sizes."""
STEPS = 12
RETURNING = 6
"""Steps; windows that leave later do not return: one at the edge of a dead zone would come and go for ever."""
CONVERGED = 1e-4
"""Sizes: the step that ends the search; what is left after it is its square."""
SMALLEST = 0.05
"""Of what is positive by nature (k_s eta, a rate) and of its start: the search goes no lower."""


@dataclass(frozen=True)
class Fit:
    """Parameters, and how sure.

    Attributes:
        unknowns: what was searched for.
        x: values (17,); what is not seen stands at its start.
        covariance: (17, 17), of what is seen, by the scatter between clusters.
        independent: as if there were none.
        unseen: orthonormal directions in units of sizes that the data do not see (17, k).
        singular: singular values of the whitened Jacobian in units of sizes, descending (k,).
        seen: the windows used.
        rows: their equations at x.
        converged: whether the search came to rest.
        clusters: how many groups of windows.
        t_factor: half width of a 95 % interval in standard deviations.
    """

    unknowns: tuple[Parameter, ...]
    x: NDArray[np.float64]
    covariance: NDArray[np.float64]
    independent: NDArray[np.float64]
    unseen: NDArray[np.float64]
    singular: NDArray[np.float64]
    seen: Windows
    rows: Equations
    converged: bool
    clusters: int
    t_factor: float

    def half_width(self, direction: NDArray[np.float64]) -> float:
        """Of the 95 % interval of direction . x, `direction` (17,); what is not seen counts with its whole size."""
        if self.clusters < 2:
            return np.inf
        scatter = self.t_factor * np.sqrt(direction @ self.covariance @ direction)
        independent = self.t_factor * np.sqrt(direction @ self.independent @ direction)
        hidden = np.linalg.norm((direction * sizes(self.unknowns)) @ self.unseen)
        return float(max(scatter, independent) + hidden)

    def is_determined(self, direction: NDArray[np.float64], size: float) -> bool:
        """Whether direction . x is known to `WIDEST` of `size`."""
        return self.half_width(direction) < WIDEST * size

    @property
    def force_residual(self) -> NDArray[np.float64]:
        """Force by the springs less that of the scale, of the windows in contact (n,), N."""
        at = self.rows.kind == 1
        return self.rows.residual[at] / self.rows.per_newton

    def misfit(self, *kinds: int) -> float:
        """Root mean square of the residuals of `kinds` over what rounding leaves in one sample; 0: there are none."""
        at = np.isin(self.rows.kind, kinds)
        return float(np.sqrt(np.mean((self.rows.residual[at] / self.rows.sigma[at]) ** 2))) if np.any(at) else 0.0

    def half_width_through(self, quantity: Callable[[NDArray[np.float64]], float]) -> float:
        """Of the 95 % interval of a `quantity` that is computed from x (17,), by its gradient at x."""
        steps = np.diag(1e-4 * sizes(self.unknowns))
        slope = [(quantity(self.x + e) - quantity(self.x - e)) / (2.0 * e.sum()) for e in steps]
        return self.half_width(np.array(slope))

    def one(self, index: int) -> NDArray[np.float64]:
        """The direction of parameter `index`."""
        return np.eye(COUNT)[index]


def fit(
    seen: Windows,
    belief: Belief,
    unknowns: tuple[Parameter, ...],
    resolution: float,
    fixed: tuple[int, ...] = (),
    surface: bool = True,
) -> Fit:
    """The parameters that meet `balance.rows` best.

    Args:
        seen: windows of a log; those at the edge of a dead zone, and those neither in air nor in contact, are left out.
        belief: geometry, masses, N, counts.
        unknowns: of `parameters`.
        resolution: step of the force (N).
        fixed: indices of parameters that are known and stay at their start.
        surface: see `rows`.

    Raises:
        Unreachable: joint angles that do not close.
    """
    x, scale = starts(unknowns), sizes(unknowns)
    scale = np.where(np.isin(np.arange(COUNT), fixed), 0.0, scale)
    settled = seen.where(in_air(seen) | on_scale(seen))
    used = settled.where(clear(x, settled, belief.N))
    change = np.inf
    for number in range(STEPS):
        if len(used.t) == 0 or change < CONVERGED:
            break
        at, A = _linearised(x, scale, used, belief, resolution, surface)
        step = _seen(A, fixed)[0] @ (-at.residual / at.sigma)
        there = x + scale * np.clip(step, -0.5, 0.5)
        for index in (KAPPA, RATE):
            there[index] = max(there[index], SMALLEST * unknowns[index].start)
        # held back at its least, a parameter has come to rest
        change = float(np.max(np.abs(there - x)[scale > 0.0] / scale[scale > 0.0]))
        x = there
        candidates = settled if number < RETURNING else used
        used = candidates.where(clear(x, candidates, belief.N))
    at, A = _linearised(x, scale, used, belief, resolution, surface)
    inverse, unseen, singular = _seen(A, fixed)
    r = at.residual / at.sigma
    covariance = sandwich(A, inverse, r, used.cluster[at.window]) * np.outer(scale, scale)
    variance = float(r @ r) / max(len(r) - COUNT, 1)
    independent = variance * inverse @ inverse.T * np.outer(scale, scale)
    clusters = len(np.unique(used.cluster))
    factor = t_factor(clusters)
    return Fit(unknowns, x, covariance, independent, unseen, singular, used, at, change < CONVERGED, clusters, factor)


def _linearised(x, scale, used, belief, resolution, surface) -> tuple[Equations, NDArray[np.float64]]:
    """Equations at x, and d residual / d (x / scale) over their sigma (m, 17), by central differences: the equations
    are smooth away from dead zones. Kinematics are solved anew for the zeros of the joints only."""
    here = pose(belief, used.joint - x[JOINTS])
    at = rows(x, used, belief, resolution, here, surface)
    A = np.zeros((len(at.residual), COUNT))
    for index in np.flatnonzero(scale):
        ends = []
        for side in (DIFFERENCE, -DIFFERENCE):
            near = x.copy()
            near[index] += side * scale[index]
            turned = JOINTS.start <= index < JOINTS.stop
            there = pose(belief, used.joint - near[JOINTS]) if turned else here
            ends.append(rows(near, used, belief, resolution, there, surface).residual)
        A[:, index] = (ends[0] - ends[1]) / (2.0 * DIFFERENCE * at.sigma)
    return at, A


def _seen(A, fixed) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Pseudo-inverse of A over the directions that it sees (17, m); those that it does not, (17, k), without the
    `fixed` parameters, which are no secret of the data; the singular values."""
    free = np.setdiff1d(np.arange(COUNT), fixed)
    n = len(free)
    U, s, Vt = np.linalg.svd(A[:, free], full_matrices=len(A) < n)
    s = np.pad(s, (0, n - len(s)))
    good = s > 1.0 / BLIND
    inverse, unseen = np.zeros((COUNT, len(A))), np.zeros((COUNT, int(np.sum(~good))))
    inverse[free] = (Vt[good].T / s[good]) @ U[:, : np.sum(good)].T
    unseen[free] = Vt[~good].T
    return inverse, unseen, s


SLIDING = 1e-3
"""m/s: slower is rest."""
WIDEST_MU = 0.1
"""A coefficient less sure than this is no number."""
SETTLED = 0.35
"""s in one direction, in which even the slowest sweep is past the 0.3 mm that bristles stretch."""


def friction(springs: Fit, seen: Windows, belief: Belief) -> Estimate | None:
    """Coefficient of friction mu from the windows in which the head slides; None if it never does.

    Args:
        springs: identified; how unsure they are goes into the interval.
        seen: windows in order of time.
        belief: geometry, masses, N.
    """
    at = pose(belief, seen.joint - springs.x[JOINT_ZERO : JOINT_ZERO + 3])
    v = np.linalg.solve(at.J, seen.speed[..., None])[..., 0]
    sliding = _sliding(seen, v[:, :2])
    if not np.any(sliding):
        return None
    swept = seen.where(sliding)
    along = v[sliding, :2] / np.linalg.norm(v[sliding, :2], axis=1, keepdims=True)
    A = _equations(swept.force, along)

    def sideways(x: NDArray[np.float64]) -> NDArray[np.float64]:
        return pressing_force(x, swept, belief)[:, :2].ravel()

    found = line(A, sideways(springs.x), np.repeat(swept.cluster, 2))
    if found is None:
        return None
    mu = np.linalg.pinv(A)[0]
    through = springs.half_width_through(lambda x: float(mu @ sideways(x)))
    width = float(np.hypot(found.half_widths[0], through))
    return Estimate(float(found.coefficients[0]), width, "1") if width < WIDEST_MU else None


def _equations(force: NDArray[np.float64], along: NDArray[np.float64]) -> NDArray[np.float64]:
    """What multiplies mu and beta in F_t (2n, 3); `along` (n, 2): direction of each window's motion."""
    A = np.zeros((2 * len(force), 3))
    A[:, 0] = (force[:, None] * along).ravel()
    A[0::2, 1] = A[1::2, 2] = 1.0
    # a sweep one way only cannot tell a false zero from friction, and takes the zeros as they were identified
    both = np.linalg.norm(along.mean(axis=0)) < 0.7
    return A if both else A[:, :1]


def _sliding(seen: Windows, v: NDArray[np.floating]) -> NDArray[np.bool_]:
    """Windows (n,) on the scale that have gone on in one direction for `SETTLED` already; v (n, 2), m/s."""
    speed = np.linalg.norm(v, axis=1)
    moving = np.flatnonzero(on_scale(seen) & (speed > SLIDING))
    heading = v[moving] / speed[moving, None]
    straight = np.sum(heading[1:] * heading[:-1], axis=1) > 0.9
    sliding = np.zeros(len(seen.t), dtype=bool)
    if len(moving):
        for run in seen.runs(moving, straight):
            sliding[run[seen.t[run] > seen.t[run[0]] + SETTLED]] = True
    return sliding


def spring_stiffness(springs: Fit, belief: Belief, log: Log) -> Estimate | None:
    """k_s (N m/rad) from drive/1.tau_motor to drive/3.tau_motor of `log`; None if the torque does not vary.

    Args:
        springs: identified; how unsure they are goes into the interval.
        belief: N.

    Raises:
        LogRefused: a torque is missing, or in another unit.
    """
    seen = springs.seen
    torque = np.stack([_mean(log, f"drive/{i}.tau_motor", seen) for i in (1, 2, 3)], axis=1).ravel()

    def equations(x: NDArray[np.float64]) -> NDArray[np.float64]:
        A = np.zeros((3 * len(seen.t), 7))
        A[:, 0] = loaded(deflections(x, seen, belief.N), x[BACKLASH]).ravel()
        for i in range(3):
            A[i::3, 1 + i] = np.sign(seen.speed[:, i])
            A[i::3, 4 + i] = 1.0
        return A

    found = line(equations(springs.x), torque, np.repeat(seen.cluster, 3))
    if found is None:
        return None
    through = springs.half_width_through(lambda x: float(np.linalg.pinv(equations(x))[0] @ torque))
    return Estimate(float(found.coefficients[0]), float(np.hypot(found.half_widths[0], through)), "N m/rad")


def _mean(log: Log, name: str, seen: Windows) -> NDArray[np.float64]:
    """Means of a torque over the windows."""
    if name not in log.series:
        raise LogRefused(
            f"{log.path}: '{name}' is not there; --motor-torque needs the torques of all three motors: choose with "
            f"--map {name}=COLUMN[N m]"
        )
    series = log.series[name]
    if series.unit != "N m":
        raise LogRefused(f"{log.path}: {name} is in '{series.unit}', expected 'N m'; a current is not a torque")
    total = np.concatenate([[0.0], np.cumsum(series.values)])
    first = np.searchsorted(series.t, seen.t - 0.5 * seen.length)
    last = np.maximum(np.searchsorted(series.t, seen.t + 0.5 * seen.length), first + 1)
    last = np.minimum(last, len(series.t))
    return (total[last] - total[first]) / np.maximum(last - first, 1)


PLAUSIBLE = 5.0
"""k_s eta farther from its belief than by this factor is a mistake of units or signs, not a spring."""
LEVEL = (HEIGHT, SLOPE, SLOPE + 1)
"""What is known of a level scale whose height was measured."""
NO_SPRING = 2.0
"""Depths under load this many times farther from the scale's law than all else, or than rounding explains (it leaves 4
micrometres), say less than they spoil: what was pressed is skin, or no plane."""
LOSS_SEEN = 0.02
"""A smaller ln(eta) is what friction and the scale's delay leave, not a belt that loses."""


class NotIdentifiable(TwinError):
    """The log is in order, but what was asked cannot be had from it: why, and what to record instead."""

    exit_code = 1


@dataclass(frozen=True)
class Quantity:
    """One quantity. meaning: for people; believed: what the experiment says, None if nothing; found: None if the log
    does not say it. SI, but for what `estimate.unit` says."""

    meaning: str
    believed: float | None
    found: Estimate | None


@dataclass(frozen=True)
class Identification:
    """What a log says.

    Attributes:
        model: what the robot is taken for.
        fit: of the springs and the scale.
        seen: all windows of slow motion.
        quantities: by name.
        one_pose: the paper's procedure on the same log; None: no gradual press.
        alike: unknowns that this log cannot tell apart, names of each such group.
        notes: sentences on the log.
    """

    model: RobotModel
    fit: Fit
    seen: Windows
    quantities: Mapping[str, Quantity]
    one_pose: OnePose | None
    alike: tuple[tuple[str, ...], ...]
    notes: tuple[str, ...]

    @property
    def loss(self) -> Estimate | None:
        """ln(eta) of losses that depend on direction; None: loading and unloading cannot be compared."""
        axis, one = self.fit.one(LOSS), self.fit.unknowns[LOSS]
        if not self.fit.is_determined(axis, one.size):
            return None
        return Estimate(float(self.fit.x[LOSS]), self.fit.half_width(axis), one.unit)

    @property
    def apart(self) -> bool:
        """Whether k_s and eta are known one by one."""
        return self.quantities["k_s"].found is not None

    def estimate(self, name: str) -> Estimate:
        """Of a quantity that was found.

        Raises:
            KeyError: it was not.
        """
        found = self.quantities[name].found
        if found is None:
            raise KeyError(name)
        return found


def identified(
    log: Log, model: RobotModel, height: float | None = None, motor_torque: bool = False, say: Say = silent
) -> Identification:
    """Estimates from the encoders and the scale of `log`.

    Args:
        log: as `read_log` gives it.
        model: geometry, masses, N and counts that are believed.
        height: of the scale (m), if it was measured and the scale is level: that makes the joints' zeros exact.
        motor_torque: whether drive/n.tau_motor is a measured torque.
        say: called with what is being done.

    Raises:
        LogRefused: signals are missing, in wrong units or of the wrong sign.
        NotIdentifiable: the log is in order, but k_s eta cannot be had from it.
    """
    belief, steps = model.belief, Steps(say, 4)
    steps.next("looking for slow motion")
    taken = robot_samples(log, belief)
    # the columns are those of the map
    estimates(taken, model)
    seen = windows(taken, belief)
    path = log.path
    if len(seen.t) and np.min(seen.lowest) < -CONTACT:
        raise LogRefused(
            f"{path}: scale.F_z goes down to {np.min(seen.lowest):.2f} N, but a press is positive and no scale is "
            "pulled; turn its sign with --map scale.F_z=-COLUMN[N], or tare it"
        )
    if not len(seen.t):
        raise NotIdentifiable(
            f"{path}: the robot never moves slowly and evenly: no {seen.length:g} s in which the motors cross "
            f"{COUNTS:g} counts without a jerk; move on the scale and in free air, as experiments/calibration.toml does"
        )
    if not np.any(in_air(seen)):
        raise LogRefused(
            f"{path}: scale.F_z never shows free air, its least is {np.min(seen.lowest):.2f} N; tare the scale, and "
            "record motion off it as well"
        )
    unknowns = parameters(belief, model.plant.z_s if height is None else height)
    fixed = () if height is None else LEVEL
    notes = taken.notes
    steps.next("fitting springs and scale")
    try:
        found = fit(seen, belief, unknowns, model.resolution, fixed)
        springs, depth = found.misfit(0, 1), found.misfit(2)
        if depth > NO_SPRING * max(springs, 1.0):
            notes += (
                f"the depths under load are {depth:.0f} times farther from those of a spring on a plane, "
                "F = K d (1 + c d'), than rounding explains: that law was left out, and with it what it says of "
                "height, stiffness and the joints' zeros",
            )
            steps.share("fitting without the surface", 0.5)
            found = fit(seen, belief, unknowns, model.resolution, fixed, surface=False)
    except Unreachable as problem:
        raise LogRefused(
            f"{path}: {problem}; are units, signs and zeros of the joint encoders those of the experiment?"
        ) from None
    _refuse_nonsense(found, belief, log)
    split = _split(found, belief, log, motor_torque)
    quantities = {**split, **_quantities(found, height)}
    steps.next("friction")
    quantities["friction"] = Quantity("friction under the head", None, friction(found, seen, belief))
    steps.next("one pose")
    press = one_pose(seen, belief, found.x)
    return Identification(model, found, seen, quantities, press, _alike(found), notes)


def _refuse_nonsense(found: Fit, belief: Belief, log: Log) -> None:
    """Raise if there is no k_s eta in the log that could be believed."""
    k, believed, axis = found.x[KAPPA], belief.k_s * belief.eta, found.one(KAPPA)
    pressing, air = int(np.sum(on_scale(found.seen))), int(np.sum(in_air(found.seen)))
    plausible = 1.0 / PLAUSIBLE < k / believed < PLAUSIBLE
    determined = found.is_determined(axis, found.unknowns[KAPPA].size)
    if determined and plausible and found.converged:
        return
    doubt = (
        "is the scale in N, are N and counts per turn those of this robot, and do motors and joints count in the same "
        "sense?"
    )
    if not plausible and (found.is_determined(axis, k) or pressing > 10):
        raise LogRefused(
            f"{log.path}: k_s eta comes out more than {PLAUSIBLE:g} times away from the believed {believed:g} N m/rad; "
            f"{doubt}"
        )
    if not found.converged or not len(found.seen.t):
        raise LogRefused(f"{log.path}: no k_s eta, zeros and backlash at all meet statics in its slow motion; {doubt}")
    share = found.half_width(axis) / believed
    left = f"{100.0 * share:.0f} % of it" if share < 1.0 else "it"
    raise NotIdentifiable(
        f"{log.path}: cannot tell k_s eta: {air} usable windows in free air and {pressing} on the scale leave {left} "
        "open; press gradually, in several places, up and down, as experiments/calibration.toml does"
    )


def _split(found: Fit, belief: Belief, log: Log, motor_torque: bool) -> dict[str, Quantity]:
    """k_s eta, and both apart if motor torque or the direction of the losses says so."""
    product = Estimate(float(found.x[KAPPA]), found.half_width(found.one(KAPPA)), "N m/rad")
    k_s, eta, meaning = None, None, "k_s eta"
    loss, width = float(found.x[LOSS]), found.half_width(found.one(LOSS))
    if motor_torque:
        k_s = spring_stiffness(found, belief, log)
        if k_s is not None:
            ratio = product.value / k_s.value
            eta = Estimate(
                ratio, ratio * float(np.hypot(product.half_width / product.value, k_s.half_width / k_s.value)), "1"
            )
    elif found.is_determined(found.one(LOSS), found.unknowns[LOSS].size) and loss + width < -LOSS_SEEN:
        # with losses by direction (P1) the geometric mean of both, e^(+loss) and e^(-loss), has no eta in it
        meaning = "k_s eta, mean of directions"
        k_s, eta = product, Estimate(float(np.exp(loss)), float(np.exp(loss)) * width, "1")
    return {
        "k_s_eta": Quantity(meaning, belief.k_s * belief.eta, product),
        "k_s": Quantity("k_s alone", belief.k_s, k_s),
        "eta": Quantity("eta alone", belief.eta, eta),
    }


def _quantities(found: Fit, height: float | None) -> dict[str, Quantity]:
    """The other unknowns of the fit, with the scale's stiffness for its compliance."""
    reported: dict[str, Quantity] = {}
    for index, one in enumerate(found.unknowns):
        if index in (KAPPA, LOSS, RATE) or (index in LEVEL and height is not None):
            continue
        axis, x = found.one(index), float(found.x[index])
        estimate = Estimate(x, found.half_width(axis), one.unit) if found.is_determined(axis, one.size) else None
        if index == COMPLIANCE:
            if estimate is not None:
                estimate = Estimate(1.0 / x, estimate.half_width / x**2, "N/m")
            reported["stiffness"] = Quantity("stiffness of the scale", None, estimate)
            continue
        believed = one.start if index == HEIGHT or (one.unit == "rad" and index not in LEVEL) else None
        reported[one.name] = Quantity(one.meaning, believed, estimate)
    return reported


def _alike(found: Fit) -> tuple[tuple[str, ...], ...]:
    """The unknowns that stand in unseen directions, in groups that share one."""
    hidden = np.abs(found.unseen @ found.unseen.T)
    # how fast a loss turns over means nothing where there is none
    members = np.setdiff1d(np.flatnonzero(np.sqrt(np.diag(hidden)) > WIDEST), RATE)
    _, group = connected_components(hidden[np.ix_(members, members)] > WIDEST**2, directed=False)
    return tuple(
        tuple(found.unknowns[i].meaning for i in members[group == number]) for number in dict.fromkeys(group.tolist())
    )
