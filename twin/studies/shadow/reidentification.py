"""Search for the changed parameter: springs, their zeros and the contact's stiffness from a robot's last samples.

Windows of slow, even motion (`identify.windows`) average out the encoders' rounding; the scatter between groups of
windows gives intervals (`identify.clustered`). For each leg, with w = theta_m - N theta_l - slip, b the half width of
its dead zone, s = sign(tau), and tau the motor's torque without its rotor's,

    w - s b = tau (1/k_s + N^2 c_belt) + zero + s db:

the encoders' error is then an error of the response. db, the excess of the dead zone, is fitted if the leg is loaded
both ways; otherwise it is part of the zero. A measured force cannot replace the torques: dry friction of 0.02 N m in
the joints changes it as much as a spring does. The contact is a spring on a plane, as in `identify`:

    p_z = z_s + m_x p_x + m_y p_y - F/K.

A parameter that the samples do not determine is reported with the reason.
"""

import math
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin.kernel.cosim.port import width
from twin.kernel.errors import TwinError
from twin.kernel.recording.logs.log import LogError, LogSeries
from twin.robot.assembly.build import belief, plant_parameters
from twin.robot.controller.controller import Belief
from twin.robot.experiment.experiment import Experiment
from twin.robot.plant.dynamics import PlantParameters
from twin.robot.run.trace import run_in_memory
from twin.studies.identify.balance import pose
from twin.studies.identify.clustered import Line, line, t_factor
from twin.studies.identify.estimate import Estimate, decimals, display_unit, display_value
from twin.studies.identify.windows import Windows, on_scale, windows
from twin.studies.replay.sample_columns import INPUTS
from twin.studies.replay.samples import RobotSamples
from twin.studies.shadow.alarm import UNKNOWN_PARAMETER
from twin.studies.shadow.contact_estimate import ENCODER_ZERO
from twin.studies.shadow.filter_steps import drive_model

MAX_SAMPLE_AGE = 60.0
"""Maximum age of the samples used (s)."""
MAX_SAMPLES = 60_000
"""Maximum number of stored samples: above 1 kHz less than `MAX_SAMPLE_AGE`."""
NEWS_HALF_WIDTHS = 2.0
"""Minimum change of a proposal in half widths of its 95 % interval; seven parameters are tested after each alarm."""
MAX_UNCERTAINTY = 0.1
"""Maximum relative half width of a reported spring or contact stiffness."""
SPRING_CHANGE, CONTACT_CHANGE = 0.02, 0.25
"""Minimum relative changes of a spring and a contact in a proposal; bodies of healthy robots differ by a fifth."""
PLACE_SIZE = 5e-3
"""Minimum extent (m) of positions that determine a slope."""
MIN_SAMPLES = 100
MIN_GROUPS = 4
"""Minimum number of groups of windows, 2 s each, for their scatter."""
SPRING_PRECISION = 1e-3
"""Best relative precision of a spring, limited by the rotor's inertia and its motion in a window."""
DEAD_ZONE_PRECISION = 4e-3
"""Best relative precision with a fitted dead zone: a torque error that changes sign with it moves both."""
MAX_GROUP_SHARE = 0.85
"""Maximum share of one group in a contact's stiffness: other groups do not reveal errors of a single press."""
NO_SLOW_MOTION = "nothing moves slowly and evenly"
NOT_WITH_DRIVE = "not known with this drive"
TORQUE_ERROR = 0.02
"""Maximum rms difference of motor torques and spring loads, by the largest load, in the twin's own run. With more (gear
friction, cogging) the motor's torque is not the spring's load."""


class ParameterChange(NamedTuple):
    """Believed and identified value of one parameter.

    Attributes:
        field, leg: field of `PlantParameters` and its leg; -1 for all.
        now: found value; None if not determined.
        least: minimum change.
        why: reason if not determined.
    """

    name: str
    field: str
    leg: int
    was: float
    now: Estimate | None
    unit: str
    least: float
    why: str = ""

    @property
    def is_news(self) -> bool:
        """Whether the change of the parameter exceeds its interval and the spread of healthy robots."""
        if self.now is None:
            return False
        return abs(self.now.value - self.was) > max(NEWS_HALF_WIDTHS * self.now.half_width, self.least)

    def __str__(self) -> str:
        if self.now is None:
            return f"{self.name} not known: {self.why}"
        digits, unit = decimals(self.now), display_unit(self.unit)
        was, value, width = (display_value(x, self.unit) for x in (self.was, self.now.value, self.now.half_width))
        of = f" {unit}" if unit else ""
        return f"{self.name} was {was:.{digits}f}, is {value:.{digits}f} +- {width:.{digits}f}{of}"


@dataclass(frozen=True)
class Adaptation:
    """Proposal of at least one changed plant parameter after an alarm, with the time of the search (s)."""

    t: float
    changes: tuple[ParameterChange, ...]

    def __str__(self) -> str:
        return "; ".join(str(one) for one in self.changes)

    def apply_to(self, plant: PlantParameters) -> PlantParameters:
        for one in self.changes:
            assert one.now is not None
            value = one.now.value
            if one.field == "k_s_share":
                value /= plant.k_s
            if one.leg >= 0:
                values = list(getattr(plant, one.field))
                values[one.leg] = value
                plant = plant._replace(**{one.field: tuple(values)})
            else:
                plant = plant._replace(**{one.field: value})
        return plant


class SlowMotion(NamedTuple):
    """Data for the search of changed parameters: windows of slow motion with their torques.

    Attributes:
        seen: windows of slow motion; their force is 0 without a measurement.
        tau: mean motor torques in each window (n, 3), N m; NaN without torques.
        force: whether a force was measured.
    """

    seen: Windows
    tau: NDArray[np.float64]
    force: bool


Spring = tuple[Estimate, Estimate, bool] | None
"""k_s (N m/rad), zero of the deflection (rad), and whether the zero excludes the dead zone. None if not determined."""


def torque_error(experiment: Experiment) -> float:
    """Simulate the twin; return torque less load (rms, by the largest load), infinite without torques."""
    run = run_in_memory(experiment, experiment.controller_ticks)
    if not all(f"drive/{leg}.tau_motor" in run.fields() for leg in (1, 2, 3)):
        return math.inf
    load = run.held("plant.tau_load")
    square = np.mean((run.of_drives("tau_motor") - load) ** 2, axis=0)
    return float(np.max(np.sqrt(square) / np.abs(load).max(axis=0)))


def reidentify(
    samples: RobotSamples, plant: PlantParameters, believed: Belief, rotor: float, loads: bool = True
) -> tuple[ParameterChange, ...]:
    """Identify springs, zeros and contact from `samples`; `rotor` (kg m2), `loads`: see `TORQUE_ERROR`."""
    slow = _slow_motion(samples, believed)
    if slow is None:
        return (*_springs([None] * 3, NO_SLOW_MOTION, plant), _contact(None, NO_SLOW_MOTION, plant))
    springs: list[Spring] = [None] * 3
    if not loads:
        why = NOT_WITH_DRIVE
    elif np.isfinite(slow.tau).any():
        torque = slow.tau - rotor * believed.N * slow.seen.acceleration
        zeros = np.subtract(believed.motor_zero, np.multiply(believed.N, believed.joint_zero))
        w = slow.seen.motor - believed.N * slow.seen.joint - zeros - plant.slip
        # the torque gives the side of the dead zone, independent of the zero
        d = w - np.sign(torque) * (plant.backlash + np.array(plant.backlash_added))
        usable = np.abs(torque) > plant.k_s * slow.seen.spread
        belt = believed.N**2 * plant.belt_compliance
        springs = [_by_torque(d[:, i], torque[:, i], slow.seen.cluster, usable[:, i], belt) for i in range(3)]
        why = "its torque varies too little"
    else:
        why = "no motor torque is measured"
    contact = _by_scale(slow.seen, believed) if slow.force else None
    contact_why = "too few presses vary the force" if slow.force else "no force is measured; it could be the springs"
    return (*_springs(springs, why, plant), _contact(contact, contact_why, plant))


def _slow_motion(samples: RobotSamples, believed: Belief) -> SlowMotion | None:
    """Find windows of slow, even motion in samples; None without such windows."""
    t = samples.t
    if len(t) < MIN_SAMPLES:
        return None
    F = samples.only("F_z")[:, 0]
    known = np.isfinite(F)
    measured = int(known.sum()) >= MIN_SAMPLES
    force = LogSeries(t[known], F[known], "N") if measured else LogSeries(t, np.zeros(len(t)), "N")
    try:
        seen = windows(replace(samples, force=force), believed)
    except LogError:
        return None
    if not len(seen.t):
        return None
    first, last = (np.searchsorted(t, seen.t + side * 0.5 * seen.length) for side in (-1.0, 1.0))
    tau = samples.only("tau_motor")
    there = np.isfinite(tau)
    sums, numbers = (
        np.vstack([np.zeros(3), np.cumsum(x, axis=0)]) for x in (np.where(there, tau, 0.0), there.astype(float))
    )
    with np.errstate(invalid="ignore"):
        means = (sums[last] - sums[first]) / (numbers[last] - numbers[first])
    return SlowMotion(seen, means, measured)


def _cautious_line(A: NDArray[np.float64], y: NDArray[np.float64], cluster: NDArray[np.int64]) -> Line | None:
    """Fit a line to clustered data like `line`, with intervals at least as wide as for independent errors, since few
    groups can agree by chance; None with too few groups.

    Each coefficient beyond a slope and a constant takes one group from the degrees of freedom (Cameron and Miller 2015,
    Sec. VI.D).
    """
    groups = len(np.unique(cluster))
    found = line(A, y, cluster) if groups >= MIN_GROUPS else None
    if found is None:
        return None
    left, inverse = y - A @ found.coefficients, np.linalg.pinv(A)
    variance = left @ left / max(len(y) - A.shape[1], 1)
    factor = t_factor(groups - (A.shape[1] - 2))
    alone = factor * np.sqrt(variance * np.sum(inverse**2, axis=1))
    return Line(found.coefficients, np.maximum(factor / t_factor(groups) * found.half_widths, alone))


def _by_torque(d, torque, cluster, usable, belt: float) -> Spring:
    """Fit the spring of one leg to its loaded deflection and motor torque (n,); `belt`: compliance (rad per N m of the
    motor).

    A spring is fitted together with its dead zone, which is part of the zero if the leg is loaded one way only.
    """
    side = np.sign(torque)
    both = len(np.unique(side[usable])) > 1
    A = np.column_stack([torque, np.ones(len(d)), *([side] if both else [])])
    found = _cautious_line(A[usable], d[usable], cluster[usable])
    if found is None:
        return None
    (yields, zero, *_), (width, zero_width, *_) = found
    k = 1.0 / (yields - belt)
    sure = DEAD_ZONE_PRECISION if both else SPRING_PRECISION
    return Estimate(k, math.hypot(k * k * width, sure * k), "N m/rad"), Estimate(zero, zero_width, "rad"), both


def _by_scale(seen: Windows, believed: Belief) -> Estimate | None:
    """Fit the stiffness K of the contact, p_z = z_s + m_x p_x + m_y p_y - F/K; None if not determined."""
    pressed = seen.select(on_scale(seen))
    if not len(pressed.t):
        return None
    p_B = pose(believed, pressed.joint - np.array(believed.joint_zero)).p_B
    across = p_B[:, :2] - p_B[:, :2].mean(axis=0)
    A = np.column_stack([-pressed.force, np.ones(len(p_B)), across[:, np.ptp(across, axis=0) > PLACE_SIZE]])
    found = _cautious_line(A, p_B[:, 2], pressed.cluster)
    if found is None:
        return None
    _, group = np.unique(pressed.cluster, return_inverse=True)
    if np.bincount(group, np.linalg.pinv(A)[0] * A[:, 0]).max() > MAX_GROUP_SHARE:
        return None
    K = 1.0 / float(found.coefficients[0])
    return Estimate(K, K * K * float(found.half_widths[0]), "N/m")


def _springs(found: Sequence[Spring], why: str, plant: PlantParameters) -> list[ParameterChange]:
    moved = []
    for i, spring in enumerate(found):
        k, zero, apart = spring or (None, None, True)
        was, least = plant.k_s * plant.k_s_share[i], ENCODER_ZERO * (1.0 + plant.N)
        if k is not None and not 0.0 < k.half_width < MAX_UNCERTAINTY * k.value:
            k, zero = None, None
        if zero is not None:
            zero = zero._replace(value=zero.value + plant.slip[i]) if zero.half_width < ENCODER_ZERO else None
        name = f"zero {'' if apart else 'or dead zone '}of deflection {i + 1}"
        moved += [
            ParameterChange(f"k_s of joint {i + 1}", "k_s_share", i, was, k, "N m/rad", SPRING_CHANGE * was, why),
            ParameterChange(name, "slip", i, plant.slip[i], zero, "rad", least, why),
        ]
    return moved


def _contact(K: Estimate | None, why: str, plant: PlantParameters) -> ParameterChange:
    known = K if K is not None and 0.0 < K.half_width < MAX_UNCERTAINTY * K.value else None
    return ParameterChange("stiffness of the contact", "K", -1, plant.K, known, "N/m", CONTACT_CHANGE * plant.K, why)


class SampleRing:
    """Ring buffer of the newest samples of a robot."""

    def __init__(self) -> None:
        self._t, self._u = np.full(MAX_SAMPLES, -np.inf), np.full((MAX_SAMPLES, width(INPUTS)), np.nan)
        self._next = 0

    def keep(self, t: NDArray[np.float64], u: NDArray[np.float64]) -> None:
        """Store samples at `t` (n,), s, ascending from call to call, with the filter's inputs `u` (n, 13)."""
        at = (self._next + np.arange(len(t))) % MAX_SAMPLES
        self._t[at], self._u[at] = t, u
        self._next = (self._next + len(t)) % MAX_SAMPLES

    def samples_since(self, t: float) -> RobotSamples:
        """Return a copy of the buffered samples after `t` (s), at most `MAX_SAMPLE_AGE` old."""
        order = np.argsort(self._t)
        at = order[self._t[order] >= max(t, self._t.max() - MAX_SAMPLE_AGE, 0.0)]
        return RobotSamples(self._t[at], self._u[at])


class Reidentifier:
    """Background search on the newest samples; `wait` gives a log the same result at any speed."""

    def __init__(self, experiment: Experiment, wait: bool):
        self.plant = plant_parameters(experiment.plant, experiment.contact)
        self.proposal: Adaptation | None = None
        self.proposals: list[Adaptation] = []
        self.adaptations: list[Adaptation] = []
        self._belief, self._rotor, self._wait = belief(experiment), drive_model(experiment).inertia, wait
        try:
            self._loads = torque_error(experiment) < TORQUE_ERROR
        except TwinError:
            self._loads = False
        self.ring, self._pool = SampleRing(), ThreadPoolExecutor(1)
        self._answer: Future[tuple[ParameterChange, ...]] | None = None
        self._asked_at = math.nan

    def ask(self, since: float, t: float) -> None:
        """Start a background search for changed parameters in the samples after `since`, at `t` (s)."""
        self._asked_at = t
        self._answer = self._pool.submit(
            reidentify, self.ring.samples_since(since), self.plant, self._belief, self._rotor, self._loads
        )

    def answer(self) -> str:
        assert self._answer is not None
        if not (self._wait or self._answer.done()):
            return ""
        try:
            moved = self._answer.result()
        except TwinError as problem:
            return f"{UNKNOWN_PARAMETER}: {problem}"
        news = tuple(one for one in moved if one.is_news)
        if news:
            self.proposal = Adaptation(self._asked_at, news)
            self.proposals.append(self.proposal)
            return f"{self.proposal}: twin accepts with --adapt or the viewer's button"
        reasons = dict.fromkeys(str(one) if one.now is None else f"{one.name} has not moved" for one in moved)
        return f"{UNKNOWN_PARAMETER}: {'; '.join(reasons)}"

    def accept(self, proposal: Adaptation) -> None:
        self.plant, self.proposal = proposal.apply_to(self.plant), None
        self.adaptations.append(proposal)
