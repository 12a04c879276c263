"""Parts of the twin of a running robot, which turn samples into rows, one after the other.

Each part receives the samples and the rows of the previous parts, in slices of any length; the rows do not depend on
the slices.
"""

import math
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from threading import Lock
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from twin.kernel.cosim.component import Pieces
from twin.kernel.cosim.delay import values_by_port
from twin.kernel.cosim.port import Port, port_slices, width
from twin.kernel.errors import ComponentFailed
from twin.kernel.recording.logs.log import MappedColumn
from twin.kernel.recording.sources.stamps import Sample
from twin.robot.assembly.build import controller
from twin.robot.controller.controller import ESTIMATOR_OUTPUTS, OMEGA_REF, SHARE_PORT
from twin.robot.experiment.experiment import Experiment
from twin.robot.plant.dynamics import PlantParameters
from twin.studies.replay.model import RobotModel
from twin.studies.replay.parts import Estimates, Happening, Part, PlantModel, Rows, SampledSteps
from twin.studies.replay.plausible import MapCheck
from twin.studies.replay.sample_columns import OMEGA_REF as COMMANDS
from twin.studies.replay.samples import RobotSamples
from twin.studies.shadow.alarm import (
    BLOCK_LENGTH,
    FIRST_BLOCKS,
    SETTLING_TIME,
    Blocks,
    RateTolerances,
    ShadowWatch,
    WatchEvent,
    rate_of,
    threshold,
    tolerances_at,
)
from twin.studies.shadow.command_comparison import CommandComparison
from twin.studies.shadow.deviations import HealthyDeviation
from twin.studies.shadow.filter_steps import FilterFeed, shadow_of
from twin.studies.shadow.layout import OUTPUTS, STATES
from twin.studies.shadow.mapping import NS_PER_SECOND
from twin.studies.shadow.reidentification import Adaptation, Reidentifier

ALARM_LEVEL = Port("level", 1, "1", "largest sum of residuals by its threshold; an alarm beyond 1")
COMMAND_RESIDUAL = (Port("omega_ref", 3, "rad/s", "motor speeds that the twin's controller commands less the robot's"),)

DEVIATION_COLUMNS = port_slices(OUTPUTS)["deviation"]
MIN_WATCH_TIME = SETTLING_TIME + (FIRST_BLOCKS + 1) * BLOCK_LENGTH
"""Time from the first sample to the first block compared with the reference (s)."""
RARE_TOPICS = ("ahead", "what_if", "scale")


class PlantPart(Part, Protocol):
    """Part of the twin that depends on the plant's parameters."""

    def accept(self, plant: PlantParameters) -> None:
        """Replace the plant's parameters used by this part."""


class StateEstimate(NamedTuple):
    """The filter's estimate: state x (15,), covariance P (15, 15), Jacobian J of the joints (3, 3), SI."""

    x: NDArray[np.float64]
    P: NDArray[np.float64]
    J: NDArray[np.float64]


class OwnController:
    """Part of a twin that runs the twin's own controller on the robot's counts, and compares its commands with the
    robot's if known.

    It begins with the first sample; if the robot's program is already running, it is at another point.
    """

    def __init__(self, experiment: Experiment):
        self._period = experiment.controller_ticks * experiment.cosim.tick
        self.controller = controller(experiment)
        self._stepped = SampledSteps(self.controller, self._period, Pieces(self.controller.pieces().values()))
        self._next, self._calls = -math.inf, np.empty(0, dtype=np.intp)
        self._inputs = self.controller.inputs
        self.topics: dict[str, tuple[Port, ...]] = {
            "controller": self.controller.outputs,
            "residual/command": COMMAND_RESIDUAL,
        }
        self.happenings: list[Happening] = []

    def feed(self, samples: RobotSamples, rows: Rows) -> Rows:
        estimate = values_by_port(ESTIMATOR_OUTPUTS, rows["estimator"])
        n = len(samples.t)
        inputs = np.hstack(
            [np.ones((n, 1)) if port == SHARE_PORT else estimate[port.name].reshape(n, -1) for port in self._inputs]
        )
        called = self._calls = self._call_samples(samples.t)
        found = np.full((n, width(self.controller.outputs)), np.nan)
        if len(called):
            found[called] = self._stepped.rows(samples.t[called], inputs[called])
        omega_ref = values_by_port(self.controller.outputs, found)[OMEGA_REF.name]
        return {"controller": found, "residual/command": omega_ref - samples.u[:, COMMANDS]}

    def controller_state(self, sample: int) -> NDArray[np.uint8]:
        """Return the state of the twin's own controller after a sample of the last slice, its pieces concatenated."""
        calls = int(np.searchsorted(self._calls, sample, side="right"))
        held: NDArray[np.uint8] = self._stepped.copies[calls if len(self._calls) else -1]
        return held

    def _call_samples(self, t: NDArray[np.float64]) -> NDArray[np.intp]:
        """Find the samples of the controller calls among times `t` (n,), s, by index; slightly early samples count."""
        T, number = self._period, np.arange(-1, len(t))
        # due time of the next call if each sample so far was one
        due = np.maximum.accumulate(np.concatenate([[self._next], t + 0.5 * T]) - T * number) + T * number
        if np.all(t >= due[:-1] - 0.25 * T):
            self._next = float(due[-1])
            return number[1:]
        called = []
        for k, at in enumerate(t.tolist()):
            if at >= self._next - 0.25 * T:
                called.append(k)
                self._next = max(self._next + T, at + 0.5 * T)
        return np.array(called, dtype=np.intp)


class RobotState:
    """Part that estimates state and deviations by the filter, in slices or per sample; residuals are prior."""

    def __init__(self, experiment: Experiment):
        self._shadow = shadow_of(experiment)
        memory = self._shadow.memory[0]
        self._estimated = Pieces([memory["x"], memory["P"][:, :STATES], memory["J"]])
        self._stepped = SampledSteps(self._shadow, math.inf, self._estimated)
        self._omega_ref = np.full(3, np.nan)
        self._one, self._made = FilterFeed(self._shadow), deque[tuple[NDArray[np.float64], NDArray[np.uint8]]]()
        self._estimates, self._healthy = self._stepped.copies, HealthyDeviation(experiment)
        self.topics: dict[str, tuple[Port, ...]] = {"shadow": OUTPUTS}
        self.happenings: list[Happening] = []
        # the estimating thread must not see half of the new parameters
        self._stepping = Lock()

    def accept(self, plant: PlantParameters) -> None:
        with self._stepping:
            self._shadow.accept(plant)

    def estimate_at_once(self, sample: Sample) -> None:
        """Estimate the state from a sample that has just arrived; `feed`, maybe in another thread, returns its row."""
        commands = self._one.inputs["omega_ref"]
        held = commands.tolist()
        self._one.u[:] = sample.row
        for k, command in enumerate(held):
            # a missing command keeps its value
            if commands[k] != commands[k]:
                commands[k] = command
        try:
            with self._stepping:
                self._one(sample.t / NS_PER_SECOND)
            y = self._one.y.copy()
        except ComponentFailed:
            # `Estimates` reports counts without a pose
            y = np.full(width(OUTPUTS), np.nan)
        self._made.append((y, self._estimated.save()))

    def estimate(self, sample: int) -> StateEstimate:
        x, P, J = np.split(self._estimates[sample].view(np.float64).copy(), (STATES, STATES + STATES * STATES))
        return StateEstimate(x, P.reshape(STATES, STATES), J.reshape(3, 3))

    def feed(self, samples: RobotSamples, rows: Rows) -> Rows:
        if self._made:
            made = [self._made.popleft() for _ in samples.t]
            self._estimates = np.array([estimated for _, estimated in made])
            found = np.array([y for y, _ in made])
        else:
            u = samples.held_commands(self._omega_ref).u
            self._omega_ref = u[-1, COMMANDS]
            found = np.full((len(u), width(OUTPUTS)), np.nan)
            rows_made = self._stepped.rows(samples.t, u)
            found[: len(rows_made)] = rows_made
            self._estimates = self._stepped.copies[1:]
        y, tau_l = values_by_port(OUTPUTS, found), values_by_port(ESTIMATOR_OUTPUTS, rows["estimator"])["tau_l"]
        J = np.ascontiguousarray(self._estimates[:, -9 * 8 :]).view(np.float64).reshape(-1, 3, 3)
        found[:, DEVIATION_COLUMNS] = self._healthy.widen(y["deviation"], y["NIS"], y["used"], J, tau_l)
        return {"shadow": found}


def own_controllers(experiment: Experiment) -> list[OwnController]:
    """List the twin's own controller, or nothing if the experiment's controller is third-party."""
    return [] if "controller" in experiment.stand_ins else [OwnController(experiment)]


class AlarmWatch:
    """Part of the twin that raises the alarm, with the requested rate of false alarms.

    Args:
        limits: tolerances by sampling rate (Hz), chosen by the rate of the first second.
        reidentifier: search for the changed parameter; None for no search.
        caution: begins the text of each alarm.
        commands: comparison of the robot's commands; None for no comparison.

    Attributes:
        why_not: reason why nothing has been watched yet; "" once a block was compared with the reference.
    """

    def __init__(
        self,
        limits: RateTolerances,
        per_hour: float,
        reidentifier: Reidentifier | None = None,
        caution: str = "",
        commands: CommandComparison | None = None,
    ):
        self._limits, self._per_hour, self._blocks = limits, per_hour, Blocks()
        self._caution, self._commands = f"{caution}; " if caution else "", commands
        self._watch: ShadowWatch | None = None
        self._first, self._count = list[NDArray[np.float64]](), 0
        self.why_not = f"fewer than {MIN_WATCH_TIME:g} s of samples"
        threshold(per_hour)
        self.reidentifier, self._t = reidentifier, 0.0
        self.topics: dict[str, tuple[Port, ...]] = {"alarm": (ALARM_LEVEL,)}
        self.happenings: list[Happening] = []
        self.alarms: list[WatchEvent] = []
        self._level, self._is_known = 0.0, True

    @property
    def changes(self) -> list[WatchEvent]:
        return self._watch.changes if self._watch else []

    def change_rate(self, t: float, rate: float) -> None:
        """Switch the alarm to the tolerances of another sampling rate (Hz) from `t` (s), and learn a new reference."""
        if self._count:
            self._blocks.change_rate()
            self._choose(t, rate)

    def _choose(self, t: float, rate: float) -> None:
        """Choose the alarm's tolerances for a sampling rate (Hz) at `t` (s)."""
        limits = tolerances_at(self._limits, rate)
        self._is_known = limits is not None
        if limits is None:
            known = ", ".join(f"{one:.4g}" for one in self._limits) or "no"
            why = f"the robot is sampled at {rate:.4g} Hz; there are tolerances for {known} Hz"
            why += "; for a controller of another rate set controller.period_ms"
            self.why_not = "" if self._watch and self._watch.judged else why
            self.happenings.append(Happening(t, f"no alarm: {why}"))
            self.lose(t, why)
        elif self._watch is None:
            self._watch = ShadowWatch(limits, self._per_hour, reidentifier=self.reidentifier)
        else:
            self._watch.change_tolerances(t, limits)

    def feed(self, samples: RobotSamples, rows: Rows) -> Rows:
        if self.reidentifier is not None:
            self.reidentifier.ring.keep(samples.t, samples.held_commands(np.full(3, np.nan)).u)
        levels, begin, self._t = np.full((len(samples.t), 1), np.nan), 0, float(samples.t[-1])
        if not self._count:
            self._first.append(samples.t)
        residuals = values_by_port(OUTPUTS, rows["shadow"])
        if self._commands is not None:
            residuals |= self._commands.feed(samples.t, rows)
        for end, means in self._blocks.add_samples(samples.t, residuals):
            at = int(np.searchsorted(samples.t, end))
            levels[begin:at], begin = self._level, at
            if not self._count:
                first = np.concatenate(self._first)
                self._choose(end, rate_of(first[first <= end]))
                self._first.clear()
            self._count += 1
            if self._watch is None or not self._is_known:
                continue
            for change in self._watch.add_block(end, means):
                self.happenings.append(Happening(end, f"{self._caution if change.alarm else ''}{change}"))
                self.alarms += [change] if change.alarm else []
            self._level = max(self._watch.levels.values())
            self.why_not = "" if self._watch.judged else self.why_not
        levels[begin:] = self._level
        return {"alarm": levels}

    def lose(self, t: float, why: str) -> None:
        """Suspend the alarm at `t` (s) until samples arrive again."""
        if self._watch:
            self._level = math.nan
            self._watch.lose(t, why)

    @property
    def proposals(self) -> list[str]:
        """Texts of all proposals of changed parameters so far, a sentence each."""
        if self.reidentifier is None:
            return []
        accepted = self.reidentifier.adaptations
        ways = ((one, "accepted" if one in accepted else "not accepted") for one in self.reidentifier.proposals)
        return [f"{one.t:.1f} s  {one}; {done}" for one, done in ways]

    def accept(self, proposal: Adaptation) -> PlantParameters:
        """Accept a proposal, return the new plant, and learn a new reference after cooling down."""
        assert self.reidentifier is not None and self._watch is not None
        self.reidentifier.accept(proposal)
        self._watch.restart(self._t)
        self.happenings.append(Happening(self._t, f"accepted: {proposal}"))
        return self.reidentifier.plant


@dataclass
class Twin:
    """Twin of a running robot: all parts that process its samples, in order.

    Attributes:
        state: part that estimates samples as they arrive; may be inside another part.
        watched: part that raises alarms; None for no alarm.
        plant_parts: parts that depend on the plant.
        records_calls: whether only rows at controller calls are recorded, `[recording] rate`.
    """

    parts: Sequence[Part]
    state: RobotState
    check: MapCheck
    watched: AlarmWatch | None
    plant_parts: Sequence[PlantPart]
    adapts: bool
    records_calls: bool

    @property
    def topics(self) -> dict[str, tuple[Port, ...]]:
        return {topic: ports for part in self.parts for topic, ports in part.topics.items()}

    def feed(self, samples: RobotSamples) -> Rows:
        rows: Rows = {}
        for part in self.parts:
            rows |= part.feed(samples, rows)
        if self.adapts and self.proposal is not None:
            self.accept(self.proposal)
        return rows

    def rows_to_record(self, rows: Rows) -> Rows:
        """Select the rows to record: all, or only rows at controller calls."""
        if not self.records_calls or "controller" not in rows:
            return rows
        called = np.isfinite(rows["controller"]).any(axis=1, keepdims=True)
        return {
            topic: own if topic.startswith(RARE_TOPICS) else np.where(called, own, math.nan)
            for topic, own in rows.items()
        }

    @property
    def _reidentifier(self) -> Reidentifier | None:
        return self.watched.reidentifier if self.watched else None

    @property
    def proposal(self) -> Adaptation | None:
        return self._reidentifier.proposal if self._reidentifier else None

    @property
    def adaptations(self) -> Sequence[Adaptation]:
        return self._reidentifier.adaptations if self._reidentifier else ()

    def accept(self, proposal: Adaptation) -> bool:
        """Accept `proposal` in all parts, between two `feed` of the same thread; return whether it was open."""
        if proposal is not self.proposal:
            return False
        assert self.watched is not None
        plant = self.watched.accept(proposal)
        for part in self.plant_parts:
            part.accept(plant)
        return True

    def happenings(self) -> list[Happening]:
        """Return and clear the events of all parts since the last call, in order of time."""
        found = sorted((one for part in self.parts for one in part.happenings), key=lambda one: one.t)
        for part in self.parts:
            part.happenings.clear()
        return found


def twin_of(
    experiment: Experiment,
    model: RobotModel,
    where: str,
    watched: AlarmWatch | None = None,
    adapts: bool = False,
    ahead: Callable[[OwnController, RobotState], PlantPart] | None = None,
    columns: Mapping[str, MappedColumn] = {},
) -> Twin:
    """Create the twin of the robot that `experiment` describes, with all its parts.

    Args:
        where: begins error messages on the robot's data.
        watched: part that raises the alarm; None for no alarm.
        ahead: function that wraps controller and state in a predicting part; None for no predictions.
        columns: column map of the robot; empty for a recording of twin.
    """
    check = MapCheck(where, model.belief_with_dead_zone, columns)
    laws, state, plant = own_controllers(experiment), RobotState(experiment), PlantModel(model)
    followed: list[PlantPart] = [ahead(law, state) for law in laws] if ahead else []
    rest: list[Part] = [*followed] if followed else [*laws, state]
    alarm: list[Part] = [watched] if watched else []
    on_plant = (plant, *(followed or [state]))
    records_calls = experiment.recording.rate == "controller"
    parts: list[Part] = [Estimates(model, check), plant, *rest, *alarm]
    return Twin(parts, state, check, watched, on_plant, adapts, records_calls)
