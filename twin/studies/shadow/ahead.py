"""Predictions for the next second: branches from the estimated state of the robot, every half second, with a band.

The band joins three independent causes, separately upwards and downwards:

    estimate      covariance P of the filter along force, height and speed: three columns of its Cholesky factor, these
                  states first. One branch each, Z deviations away
    surroundings  a higher, lower, stiffer or softer surface, within the spread of healthy robots: one branch each
    model         errors of the branches themselves, calibrated on a fleet of healthy robots, see
                  docs/shadow_reference.md

A branch takes about a millisecond. One is run with each slice of samples; the prediction is given when all are done.
"""

import math
from bisect import bisect_right
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from twin.kernel.cosim.port import Port, port_slices, width
from twin.kernel.errors import ComponentFailed, InputRefused
from twin.robot.assembly.build import surface_motions
from twin.robot.assembly.load import load_experiment
from twin.robot.controller.controller import ESTIMATOR_OUTPUTS, OMEGA_REF
from twin.robot.controller.program import Tap
from twin.robot.experiment.experiment import Experiment
from twin.robot.plant.dynamics import PlantParameters
from twin.robot.run.branch import refuse_fixed_keys
from twin.studies.replay.parts import Happening, Rows
from twin.studies.replay.sample_columns import OMEGA_REF as COMMANDS
from twin.studies.replay.samples import RobotSamples
from twin.studies.shadow.branching import LEAD_TIMES, PREDICTION_HORIZON, BranchChange, Branching, RobotSnapshot
from twin.studies.shadow.contact_estimate import ContactEstimate
from twin.studies.shadow.following import OwnController, PlantPart, RobotState
from twin.studies.shadow.layout import FORCE, OUTPUTS, POSITION, VELOCITY
from twin.studies.shadow.statistics import RunningStatistics

PREDICTION_PERIOD = 0.5
"""Time between two predictions (s)."""
PREDICTION_DELAY = 0.1
"""Delay of a prediction after its estimate (s): long enough for one slice per branch."""
CONTACT_PERIOD = 0.1
"""Time between two updates of the contact estimate, and from a start of the filter to the first one (s)."""
SETTLING_TIME = 0.5
"""Minimum time from a start of the filter to the first prediction (s)."""
Z = 1.96
"""Half width of a 95 % interval of a normal distribution, in standard deviations."""
PRESSING_STATES = (FORCE + 2, POSITION + 2, VELOCITY + 2)
"""Indices of the states with the largest influence on the force to come."""
HEIGHT_ERROR, TOUCHED_HEIGHT_ERROR = 0.5e-3, 0.1e-3
"""Height error of a surface (m), before and after first touch."""
STIFFNESS_ERROR, TOUCHED_STIFFNESS_ERROR = 0.2, 0.05
"""Relative stiffness error of a surface, before and after the robot has pressed on it."""
MODEL_ERROR, MODEL_ERROR_SHARE = np.array([0.12, 0.2e-3]), np.array([0.2, 0.3])
"""Model error of force (N, in contact) and height (m), and its share of the predicted change. Calibrated so that 98 %
of the predictions of 36 robots of the healthy fleet (seeds 501 to 503) are within the band; robots differ most by their
dry friction."""
FOREIGN_DIFFERENCE, FOREIGN_DIFFERENCE_SHARE = 0.1, 0.5
"""Limits of the mean command difference over half a second (rad/s, and relative to the commands' rms). Beyond both,
another controller moves the robot, or one at another point of its program."""
MADE_PORT = Port("made", 1, "s", "time of the estimate that is gone out from")
_TAU_L, _THETA_L = (port_slices(ESTIMATOR_OUTPUTS)[name] for name in ("tau_l", "theta_l"))
_F_Z = port_slices(OUTPUTS)["F_ee_B"].start + 2
_FORCE_DEVIATION = port_slices(OUTPUTS)["deviation"].start + FORCE + 2
_FILTER_STARTED = port_slices(OUTPUTS)["started"].start
UNUSED_TABLES = {
    "contact": "where the surface is, and how stiff, comes from the estimate",
    "monitor": "branches have no monitor",
    "scale": "it moves nothing",
    "fault": "branches have none",
}


def _meaning(what: str) -> str:
    return f"{what} {LEAD_TIMES[0]:g}, {LEAD_TIMES[1]:g} .. {PREDICTION_HORIZON:g} s after the estimate"


PREDICTION_PORTS = (
    Port("F_z", len(LEAD_TIMES), "N", _meaning("predicted pressing force")),
    Port("p_z", len(LEAD_TIMES), "m", _meaning("predicted height of the platform, base frame B,")),
)
BAND_PORTS = tuple(
    Port(f"{port.name}_{side}", port.size, port.unit, f"{side} bound of the band that has 95 % of {port.name}")
    for port in PREDICTION_PORTS
    for side in ("lower", "upper")
)
AHEAD_PORTS = (MADE_PORT, *PREDICTION_PORTS, *BAND_PORTS)


def cholesky_first(P: NDArray[np.float64]) -> NDArray[np.float64]:
    """Compute the Cholesky columns (n, 3) of `P` (n, n) that have the whole variance of `PRESSING_STATES`."""
    left, columns = P.copy(), []
    for k in PRESSING_STATES:
        deviation = math.sqrt(max(left[k, k], 0.0))
        columns.append(left[:, k] / deviation if deviation else np.zeros(len(P)))
        left -= np.outer(columns[-1], columns[-1])
    return np.array(columns).T


def branch_changes(P: NDArray[np.float64], around: ContactEstimate) -> list[list[BranchChange]]:
    """List the changes to simulate for a prediction's band, by cause: one branch for both signs, or one for each."""
    height = TOUCHED_HEIGHT_ERROR if math.isfinite(around.height) else HEIGHT_ERROR
    share = TOUCHED_STIFFNESS_ERROR if math.isfinite(around.share) else STIFFNESS_ERROR
    estimate = [[BranchChange(dx=Z * column)] for column in cholesky_first(P).T]
    heights = [BranchChange(height=by) for by in (height, -height)]
    shares = [BranchChange(share=1.0 + by) for by in (share, -share)]
    return [*estimate, heights, shares]


def band(
    first: NDArray[np.float64],
    others: Sequence[Sequence[NDArray[np.float64]]],
    now: NDArray[np.float64],
    unsure: float = 0.0,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Compute the uncertainty band of a prediction: bounds (leads, 2) of force and height about a branch, lower and
    upper.

    Args:
        first: force and height of the branch (leads, 2).
        others: force and height of the `branch_changes` by cause, without branches that equal the first one.
        now: force and height at the start (2,).
        unsure: standard deviation of the contact force (N) due to encoder zeros and dry friction.
    """
    rest = np.where(first[:, :1] > 0.0, np.hypot(MODEL_ERROR, [Z * unsure, 0.0]), [0.0, MODEL_ERROR[1]])
    up = rest**2 + (MODEL_ERROR_SHARE * (first - now)) ** 2
    low = up.copy()
    for cause in filter(None, others):
        # a branch that failed has no rows after its end
        away = [np.nan_to_num(one - first) for one in cause]
        if len(cause) == 1:
            away.append(-away[0])
        up += np.max(np.maximum(away, 0.0), axis=0) ** 2
        low += np.max(np.maximum(-np.array(away), 0.0), axis=0) ** 2
    lower, upper = first - np.sqrt(low), first + np.sqrt(up)
    lower[:, 0] = np.maximum(lower[:, 0], np.minimum(first[:, 0], 0.0))
    return lower, upper


@dataclass
class PredictionScore:
    """Score of a session's predictions, against the estimates that followed.

    Attributes:
        banded: number of predicted forces with a band.
        in_band: number of estimates inside the band.
        no_band: reason why some predictions have no band; "" if all have one.
        error: predicted less estimated force.
        hold_error: error of a zero-order-hold prediction.
        what_if_differences: difference from the prediction, per `--what-if`.
    """

    predictions: int = 0
    banded: int = 0
    in_band: int = 0
    no_band: str = ""
    error: RunningStatistics = field(default_factory=RunningStatistics)
    hold_error: RunningStatistics = field(default_factory=RunningStatistics)
    what_if_differences: dict[str, RunningStatistics] = field(default_factory=dict)

    JSON_KEYS = "predictions in_band=share error_rms_N=error.rms last_value_rms_N=hold_error.rms what_if"

    @property
    def what_if(self) -> dict[str, dict[str, float | None]]:
        """Differences from the prediction by `--what-if`, with units."""
        return {
            name: {"rms_N": one.rms, "largest_N": one.largest, "at_s": one.largest_time if one.largest else None}
            for name, one in self.what_if_differences.items()
        }

    @property
    def share(self) -> float:
        """Share of the estimates inside the band of their prediction; NaN without a band."""
        return self.in_band / self.banded if self.banded else math.nan


@dataclass
class _PendingPrediction:
    """Prediction in progress: its start, the branches still to run, and the results so far."""

    t: float
    now: RobotSnapshot
    runs: Iterator[None]
    first: NDArray[np.float64]
    others: list[list[NDArray[np.float64]]]
    changed: list[NDArray[np.float64]]
    task: float


class SessionBranches:
    """Branching systems of a session, which predict the robot: one for the twin, and one for each `--what-if`.

    Args:
        changed: `--what-if` text -> changed experiment.
        limit: threshold of the predicted pressing force for a warning (N); infinite for no warnings.
        start: time of the first prediction (s).

    Attributes:
        moves: whether the surface moves, by the twin's clock; its phase is not estimated.
        taps: numbers of the tasks that tap.
        own, changed, branchings: system of the twin, systems of the `--what-if` experiments, all systems.

    Raises:
        InputRefused: a component of the robot has no state that can be set.
    """

    def __init__(
        self,
        experiment: Experiment,
        changed: Mapping[str, Experiment] = MappingProxyType({}),
        limit: float = math.inf,
        start: float = SETTLING_TIME,
    ):
        self.score = PredictionScore(what_if_differences={name: RunningStatistics() for name in changed})
        self.moves = bool(surface_motions(experiment.contact))
        self.taps = [number for number, task in enumerate(experiment.tasks, 1) if isinstance(task, Tap)]
        self.limit, self.start = limit, start
        with ExitStack() as made:
            self.own, self.changed = Branching(experiment), list[Branching]()
            made.callback(self.own.close)
            for name, other in changed.items():
                self.changed.append(Branching(other, f"--what-if {name}"))
                made.callback(self.changed[-1].close)
                self.changed[-1].refuse_other_law(self.own.law, f"--what-if {name}: ")
            self._closing = made.pop_all()
        self.branchings = [self.own, *self.changed]

    def __enter__(self) -> "SessionBranches":
        return self

    def __exit__(self, *failure: object) -> None:
        self._closing.close()

    def predicting_part(self, law: OwnController, state: RobotState) -> PlantPart:
        return _PredictingPart(self, law, state)


def _next_time(t: float, start: float, period: float) -> float:
    """Return the first of the regular times `start`, `start` + `period`, ... after `t` (s)."""
    return start + period * (math.floor((t - start) / period + 1e-6) + 1)


class _PredictingPart:
    """Part of a twin that predicts the next second of the robot; see `SessionBranches.predicting_part`."""

    def __init__(self, ahead: SessionBranches, law: OwnController, state: RobotState):
        self._ahead, self._law, self._state = ahead, law, state
        what_if = {
            f"what_if/{k}": (MADE_PORT, *(replace(p, meaning=f"{p.meaning}, {name}") for p in PREDICTION_PORTS))
            for k, name in enumerate(ahead.score.what_if_differences, start=1)
        }
        self.topics: dict[str, tuple[Port, ...]] = {**law.topics, **state.topics, "ahead": AHEAD_PORTS, **what_if}
        self.happenings: list[Happening] = []
        self._around = ContactEstimate(ahead.branchings[0].parameters)
        self._pending: _PendingPrediction | None = None
        self._next, self._next_look, self._begun = ahead.start, 0.0, 0.0
        self._estimate = state.estimate(-1)
        self._heard: list[NDArray[np.float64]] = []
        self._strange: list[NDArray[np.float64]] = []
        self._command = port_slices(law.topics["controller"])[OMEGA_REF.name]
        self._warned = self._foreign = False
        self._task = port_slices(law.topics["controller"]).get("task")
        self._tasks, self._task_on = np.empty(0), math.nan
        self._open: list[tuple[NDArray[np.float64], NDArray[np.float64], float]] = []
        p = ahead.branchings[0].parameters
        self._per_motor = float(p["N"] * p["eta"])

    def accept(self, plant: PlantParameters) -> None:
        """Replace the plant's parameters, and cancel the pending prediction, which began with the previous plant."""
        self._pending = None
        self._state.accept(plant)
        for branching in self._ahead.branchings:
            branching.accept(plant)

    def feed(self, samples: RobotSamples, rows: Rows) -> Rows:
        made: Rows = {}
        for part in (self._law, self._state):
            made |= part.feed(samples, rows | made)
            self.happenings += part.happenings
            part.happenings.clear()
        t, begin = samples.t, 0
        for topic in [one for one in self.topics if one not in made]:
            made[topic] = np.full((len(t), width(self.topics[topic])), np.nan)
        shadow, estimator, law = made["shadow"], rows["estimator"], made["controller"]
        self._tasks = law[:, self._task] if self._task is not None else np.empty(0)
        heard = np.column_stack(
            [t, samples.u[:, COMMANDS], law[:, self._command], estimator[:, _TAU_L], estimator[:, _THETA_L],
             -shadow[:, _F_Z], shadow[:, _FORCE_DEVIATION]]
        )  # fmt: skip
        starts = np.flatnonzero(shadow[:, _FILTER_STARTED])
        while begin < len(t):
            due = min(self._next, self._next_look, self._pending.t + PREDICTION_DELAY if self._pending else math.inf)
            end = min(int(np.searchsorted(t, due)) + 1, len(t))
            for start in starts[(begin <= starts) & (starts < end)]:
                self._begun, self._pending = float(t[start]), None
            self._heard.append(heard[begin:end])
            self._look(end - 1, float(t[end - 1]), made)
            begin = end
        if self._pending:
            next(self._pending.runs, None)
        return made

    def _look(self, sample: int, t: float, made: Rows) -> None:
        """Do the work due at a sample at `t` (s): write a prediction into `made`, learn the contact, or begin."""
        giving = self._pending is not None and t >= self._pending.t + PREDICTION_DELAY
        looking, beginning = t >= self._next_look, t >= self._next
        if not (giving or looking or beginning):
            return
        self._estimate = self._state.estimate(sample)
        self._catch_up()
        if giving and self._pending:
            self._write_prediction(sample, t, made)
        if looking:
            self._next_look = _next_time(t, 0.0, CONTACT_PERIOD)
            x, _, J = self._estimate
            if np.all(np.isfinite(x)) and t >= self._begun + CONTACT_PERIOD:
                self._around.learn(x, J, self._ahead.branchings[0].surface()[0])
        if beginning:
            self._next = _next_time(t, self._ahead.start, PREDICTION_PERIOD)
            on = self._tasks[: sample + 1]
            self._task_on = float(on[np.isfinite(on)][-1]) if np.isfinite(on).any() else self._task_on
            try:
                for branching in self._ahead.branchings:
                    branching.catch_up()
                if not self._is_foreign(t) and t >= self._begun + SETTLING_TIME:
                    self._pending = self._begin(t, self._law.controller_state(sample))
            except ComponentFailed as problem:
                self._next, self._pending = math.inf, None
                self.happenings.append(Happening(t, f"no more predictions: {problem}"))

    def _catch_up(self) -> None:
        """Advance friction and drives over the buffered samples, and score earlier predictions with these samples."""
        heard = np.concatenate(self._heard)
        self._heard.clear()
        times, robots = heard[:, 0], heard[:, 1:4]
        self._around.drag(times, heard[:, 10:13])
        self._score(times, heard[:, 13], heard[:, 14])
        if self._next == math.inf:
            return
        self._strange.append(heard[:, 1:7])
        missing = np.isnan(robots)
        omega_ref = np.where(missing, heard[:, 4:7], robots) if np.any(missing) else robots
        if np.any(lacking := np.isnan(omega_ref[:, 0])):
            # the last command holds
            newest = np.maximum.accumulate(np.where(lacking, 0, np.arange(1, len(omega_ref) + 1)))
            omega_ref = np.vstack([self._ahead.branchings[0].command, omega_ref])[newest]
        for branching in self._ahead.branchings:
            branching.follow(times, omega_ref, heard[:, 7:10] / self._per_motor)

    def _is_foreign(self, t: float) -> bool:
        """Whether another controller commanded the robot (differences last, unlike lost samples'); reported once."""
        both = np.concatenate(self._strange)
        self._strange.clear()
        away, robots = both[:, 3:] - both[:, :3], both[:, :3]
        known = ~np.isnan(away[:, 0])
        if not np.any(known):
            return False
        lasting, own = np.abs(np.mean(away[known], axis=0)), np.sqrt(np.mean(robots[known] ** 2, axis=0))
        foreign = bool(np.any(lasting > np.maximum(FOREIGN_DIFFERENCE, FOREIGN_DIFFERENCE_SHARE * own)))
        if foreign and not self._foreign:
            text = "no prediction while the robot's commands differ from those of the twin's controller"
            self.happenings.append(Happening(t, text))
        self._foreign = foreign
        return foreign

    def _begin(self, t: float, law: NDArray[np.uint8]) -> _PendingPrediction | None:
        """Begin a prediction at `t` (s), without running a branch yet; `law` is the controller's state."""
        x, P, J = self._estimate
        if not np.all(np.isfinite(x)):
            return None
        own, changed = self._ahead.own, self._ahead.changed
        self._around.correct_in_air(x, P, J, own.surface()[0])
        causes = branch_changes(P, self._around)
        now, *might = (one.present(x, J, law, self._around) for one in (own, *changed))
        pending = _PendingPrediction(t, now, iter(()), np.empty(0), [[] for _ in causes], [], self._task_on)
        asked = zip(causes, pending.others, strict=True)
        wanted = [(into, one) for cause, into in asked for one in cause]

        def runs() -> Iterator[None]:
            pending.first = own.run(now)
            unlike = own.differing_branches(now, wanted)
            yield
            for into, other in unlike:
                into.append(own.run(now, other))
                yield
            for branching, present in zip(changed, might, strict=True):
                pending.changed.append(branching.run(present))
                yield

        pending.runs = runs()
        return pending

    def _write_prediction(self, sample: int, t: float, made: Rows) -> None:
        """Finish the pending prediction, and write it into the output row of a sample at `t` (s)."""
        pending, self._pending = self._pending, None
        assert pending is not None
        for _ in pending.runs:
            pass
        first, now = pending.first, self._ahead.own.beginning(pending.now)
        lower, upper = band(first, pending.others, now, pending.now.contact_estimate.force_deviation(pending.now.J))
        if why := self._no_band(pending.task):
            self._ahead.score.no_band = why
            lower, upper = np.full((2, *first.shape), np.nan)
        bounds = [values[:, k] for k in range(2) for values in (lower, upper)]
        made["ahead"][sample] = np.concatenate([[pending.t], *first.T, *bounds])
        foreseen = self._ahead.score
        foreseen.predictions += 1
        times = pending.t + LEAD_TIMES
        self._open.append((times, np.stack([first[:, 0], lower[:, 0], upper[:, 0]]), float(now[0])))
        for k, (apart, other) in enumerate(
            zip(foreseen.what_if_differences.values(), pending.changed, strict=True), start=1
        ):
            made[f"what_if/{k}"][sample] = np.concatenate([[pending.t], *other.T])
            apart.add(times, other[:, 0] - first[:, 0])
        beyond = np.flatnonzero(first[:, 0] > self._ahead.limit)
        if len(beyond) and not self._warned:
            lead = max(0.0, float(times[beyond[0]]) - t)
            text = f"will press beyond {self._ahead.limit:g} N in {lead:.1f} s"
            self.happenings.append(Happening(t, text))
        self._warned = bool(len(beyond))

    def _no_band(self, task: float) -> str:
        """Return the reason why a prediction during `task` has no uncertainty band; "" if it has a band."""
        if self._ahead.moves:
            return "no band: the surface moves by twin's clock"
        return "no band: a tap's time of touch is not estimated" if task in self._ahead.taps else ""

    def _score(self, t: NDArray[np.float64], F_z: NDArray[np.float64], deviation: NDArray[np.float64]) -> None:
        """Compare predictions with the forces `F_z` (n,), N, estimated since, and their `deviation`, at `t` (n,), s."""
        if not self._open:
            return
        foreseen, begin, end = self._ahead.score, float(t[0]) - 1e-9, float(t[-1])
        J = self._estimate.J
        tare, tare_unsure = float(self._around.tare(J)[2]), self._around.force_deviation(J)
        for times, values, held in self._open:
            due = slice(bisect_right(times, begin), bisect_right(times, end))
            if due.start == due.stop:
                continue
            times, (first, lower, upper) = times[due], values[:, due]
            at = t.searchsorted(times - 1e-9)
            came, unsure = F_z[at] + tare, Z * np.hypot(deviation[at], tare_unsure)
            foreseen.error.add(times, first - came)
            foreseen.hold_error.add(times, held - came)
            foreseen.banded += int(np.count_nonzero(np.isfinite(lower)))
            foreseen.in_band += int(np.count_nonzero((lower - unsure <= came) & (came <= upper + unsure)))
        self._open = [one for one in self._open if one[0][-1] > end]


def changed_experiments(path: Path, settings: Sequence[str], what_if: Sequence[str]) -> dict[str, Experiment]:
    """Load the experiment of each `--what-if`, several keys separated by ";", with the robot's settings."""
    found = {}
    for text in what_if:
        keys = text.split(";")
        for key in keys:
            if "=" not in key:
                raise InputRefused(f"--what-if {key}: expected key=value, for example controller.force.kp_mm_per_N=3")
        refuse_fixed_keys(keys, "--what-if")
        for key in keys:
            table = key.partition("=")[0].strip().partition(".")[0]
            if table in UNUSED_TABLES:
                raise InputRefused(f"--what-if {key}: {table} cannot be another one ahead: {UNUSED_TABLES[table]}")
        found[text] = load_experiment(path, [*settings, *keys])
    return found


def session_branches(
    experiment: Experiment, changed: Mapping[str, Experiment], limit: float | None, note: Callable[[str], None]
) -> SessionBranches | None:
    """Create the predicting systems, or None with a note; `limit` (N), None for the monitor's, if any."""
    if limit is None:
        limit = experiment.monitor.force_limit if experiment.monitor else math.inf
    try:
        return SessionBranches(experiment, changed, limit)
    except InputRefused as problem:
        if changed:
            raise
        note(f"no predictions: {problem}")
        return None
