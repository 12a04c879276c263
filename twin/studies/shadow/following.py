"""The twin as it follows the robot: parts that make rows of its samples, one after the other.

Each part sees the robot's samples and the rows of the parts before it, in slices of any length; what comes out does not
depend on how they are cut. A state estimator is one more part.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from twin.kernel.cosim.component import Component
from twin.kernel.cosim.delay import named, play
from twin.kernel.cosim.port import Port, width
from twin.kernel.errors import InputRefused
from twin.robot.assembly.build import controller
from twin.robot.controller.controller import ESTIMATOR_OUTPUTS, OMEGA_REF, SHARE, Belief, Estimator
from twin.robot.experiment.experiment import Experiment
from twin.robot.plant.component import OUTPUTS as MOTION
from twin.robot.plant.encoder import SCALE_OUTPUTS
from twin.studies.replay.model import LONGEST_GAP, PlantRun, RobotModel
from twin.studies.replay.plausible import refusal
from twin.studies.replay.text import ENCODER, FORCE_RESIDUAL, JOINT_RESIDUAL
from twin.studies.shadow.alarm import Blocks, ShadowWatch, Tolerances, WatchEvent
from twin.studies.shadow.layout import OUTPUTS
from twin.studies.shadow.mapping import RobotSamples
from twin.studies.shadow.samples import shadow_of

ALARM_LEVEL = Port("level", 1, "1", "largest sum of residuals by its threshold; an alarm beyond 1")
COMMAND_RESIDUAL = (Port("omega_ref", 3, "rad/s", "motor speeds that the twin's controller commands less the robot's"),)

Rows = dict[str, NDArray[np.float64]]
"""By topic, (n, width); a row of NaN alone is none."""


class Happening(NamedTuple):
    """Something that happened. t: s since the first sample; text: one sentence."""

    t: float
    text: str


class Part(Protocol):
    """A part of the twin.

    Attributes:
        topics: what it gives: ports by topic.
        happenings: what has happened in it since they were last taken.
    """

    topics: dict[str, tuple[Port, ...]]
    happenings: list[Happening]

    def feed(self, samples: RobotSamples, rows: Rows) -> Rows:
        """Go on over `samples`.

        Args:
            samples: n of them, at least one, all later than those before.
            rows: of the parts before this one, for the same samples.

        Returns:
            Its own rows.
        """


class SampledSteps:
    """A sampled component that is stepped from where it stands.

    Args:
        component: stepped once per row.
        first: length (s) of the first step.
    """

    def __init__(self, component: Component, first: float = 0.0):
        self.component, self._first = component, first
        self._outputs = component.initial_outputs
        self._last: float | None = None

    def rows(self, t: NDArray[np.float64], inputs: NDArray[np.float64]) -> NDArray[np.float64]:
        """Outputs (n, width) at the times `t` (n,), s, fewer if a step failed."""
        h = np.diff(t, prepend=t[0] - self._first if self._last is None else self._last)
        rows, _ = play(self.component, t, h, inputs, before=self._outputs)
        if len(rows):
            self._outputs, self._last = rows[-1], float(t[len(rows) - 1])
        return rows


class Estimates:
    """Position and force from the counts, as the robot's computer believes; and with the dead zone that is known.

    Args:
        model: the twin.
        where: begins the sentence if the first counts fit no pose.

    Raises:
        InputRefused: (by `feed`) they do not.
    """

    def __init__(self, model: RobotModel, where: str):
        self._belief, self._where = model.aware, where
        beliefs: dict[str, Belief] = {"estimator": model.belief}
        if model.aware != model.belief:
            beliefs["twin"] = model.aware
        self._steps = {
            name: SampledSteps(Estimator(belief, model.gravity_compensation)) for name, belief in beliefs.items()
        }
        self.topics: dict[str, tuple[Port, ...]] = {
            "encoder": ENCODER, **dict.fromkeys(beliefs, ESTIMATOR_OUTPUTS), "scale": SCALE_OUTPUTS,
            "residual/force": FORCE_RESIDUAL,
        }  # fmt: skip
        self.happenings: list[Happening] = []
        self._begun = False

    def feed(self, samples: RobotSamples, rows: Rows) -> Rows:
        counts = np.hstack([samples.count_m, samples.count_l])
        if not self._begun:
            if sentence := refusal(self._where, samples.count_m[0], samples.count_l[0], self._belief):
                raise InputRefused(sentence)
            self._begun = True
        found = {"encoder": counts, "scale": samples.F_z[:, None]}
        for name, stepped in self._steps.items():
            found[name] = stepped.rows(samples.t, counts)
        best = best_estimate(found)
        found["residual/force"] = (-best["F_ee_B"][:, 2] - samples.F_z)[:, None]
        return found


def best_estimate(rows: Rows) -> dict[str, NDArray[np.float64]]:
    """The estimate that knows the dead zone, by port."""
    return named(ESTIMATOR_OUTPUTS, rows.get("twin", rows["estimator"]))


class OwnLaw:
    """The twin's own controller on the robot's counts; beside the robot's commands, if those are known.

    It begins with the first sample. One that joins a program under way is not where the robot's is.

    Args:
        experiment: whose controller it is.

    Attributes:
        controller: the component.
    """

    def __init__(self, experiment: Experiment):
        self._period = experiment.controller_ticks * experiment.cosim.tick
        self.controller = controller(experiment)
        self._stepped = SampledSteps(self.controller, self._period)
        self._next = -math.inf
        self._inputs = self.controller.inputs
        self.topics: dict[str, tuple[Port, ...]] = {
            "controller": self.controller.outputs,
            "residual/command": COMMAND_RESIDUAL,
        }
        self.happenings: list[Happening] = []

    def feed(self, samples: RobotSamples, rows: Rows) -> Rows:
        estimate = named(ESTIMATOR_OUTPUTS, rows["estimator"])
        n = len(samples.t)
        inputs = np.hstack(
            [np.ones((n, 1)) if port == SHARE else estimate[port.name].reshape(n, -1) for port in self._inputs]
        )
        called = []
        for k, t in enumerate(samples.t):
            # a sample that is a little early is still that of its call
            if t >= self._next - 0.25 * self._period:
                called.append(k)
                self._next = max(self._next + self._period, t + 0.5 * self._period)
        found = np.full((n, width(self.controller.outputs)), np.nan)
        if called:
            found[called] = self._stepped.rows(samples.t[called], inputs[called])
        omega_ref = named(self.controller.outputs, found)[OMEGA_REF.name]
        return {"controller": found, "residual/command": omega_ref - samples.omega_ref}


class PlantModel:
    """The plant model in parallel, driven by the robot's motor angles, and its joints beside the robot's.

    It starts at rest where the robot is, and again after a gap of more than `LONGEST_GAP`, or if it has left the
    workspace.

    Args:
        model: the twin.
    """

    def __init__(self, model: RobotModel):
        self.topics: dict[str, tuple[Port, ...]] = {"plant": MOTION, "residual/joints": JOINT_RESIDUAL}
        self._model = model
        self._run: PlantRun | None = None
        self._last = -math.inf
        self.happenings: list[Happening] = []

    def feed(self, samples: RobotSamples, rows: Rows) -> Rows:
        best = best_estimate(rows)
        found = np.full((len(samples.t), width(MOTION)), np.nan)
        breaks = np.flatnonzero(np.diff(samples.t, prepend=self._last) > LONGEST_GAP)
        bounds = [0, *breaks, len(samples.t)]
        for a, b in pairwise(bounds):
            if a == b:
                continue
            if a in breaks and self._run is not None:
                self.happenings.append(Happening(float(samples.t[a]), "the plant model starts anew, at rest"))
                self._run = None
            begin = a
            while begin < b:
                if self._run is None:
                    self._run = PlantRun(self._model, best["p_B"][begin])
                made, failure = self._run.advance(samples.t[begin:b], best["theta_m"][begin:b])
                found[begin : begin + len(made)] = made
                begin += len(made)
                if failure:
                    when = float(samples.t[min(begin, b - 1)])
                    self.happenings.append(Happening(when, f"the plant model {failure}; it starts anew, at rest"))
                    self._run = None
                    # what it cannot start from is passed over
                    begin += not len(made)
        self._last = float(samples.t[-1])
        theta_l = named(MOTION, found)["theta_l"]
        return {"plant": found, "residual/joints": theta_l - best["theta_l"]}


class RobotState:
    """The state of the robot with its deviations, by the filter; its residuals are those of what it expected before.

    Args:
        experiment: of the robot.

    Attributes:
        shadow: the filter.
    """

    def __init__(self, experiment: Experiment):
        self.shadow = shadow_of(experiment)
        self._stepped = SampledSteps(self.shadow, math.inf)
        self._omega_ref = np.full(3, np.nan)
        self.topics: dict[str, tuple[Port, ...]] = {"shadow": OUTPUTS}
        self.happenings: list[Happening] = []

    def feed(self, samples: RobotSamples, rows: Rows) -> Rows:
        commanded = np.vstack([self._omega_ref, samples.omega_ref])
        # a command holds until the next one
        newest = np.maximum.accumulate(np.where(np.isnan(commanded), 0, np.arange(len(commanded))[:, None]), axis=0)
        omega_ref = np.take_along_axis(commanded, newest, axis=0)[1:]
        self._omega_ref = omega_ref[-1]
        u = np.hstack([samples.count_m, samples.count_l, omega_ref, samples.F_z[:, None], samples.tau_motor])
        found = np.full((len(u), width(OUTPUTS)), np.nan)
        made = self._stepped.rows(samples.t, u)
        found[: len(made)] = made
        return {"shadow": found}


class AlarmWatch:
    """Says when robot and twin have parted, with the rate of false alarms that was asked for.

    Args:
        limits: what is no news.
        per_hour: false alarms that the user bears.
    """

    def __init__(self, limits: Tolerances, per_hour: float):
        self._blocks, self._watch = Blocks(), ShadowWatch(limits, per_hour)
        self.topics: dict[str, tuple[Port, ...]] = {"alarm": (ALARM_LEVEL,)}
        self.happenings: list[Happening] = []
        self.alarms: list[WatchEvent] = []
        self._level = 0.0

    def feed(self, samples: RobotSamples, rows: Rows) -> Rows:
        levels, begin = np.full((len(samples.t), 1), np.nan), 0
        for end, means in self._blocks.take(samples.t, named(OUTPUTS, rows["shadow"])):
            at = int(np.searchsorted(samples.t, end))
            levels[begin:at], begin = self._level, at
            for change in self._watch.take(end, means):
                self.happenings.append(Happening(end, str(change)))
                self.alarms += [change] if change.alarm else []
            self._level = max(self._watch.levels.values())
        levels[begin:] = self._level
        return {"alarm": levels}


@dataclass
class Twin:
    """All parts in their order.

    Attributes:
        parts: see `Part`.
    """

    parts: Sequence[Part]

    @property
    def topics(self) -> dict[str, tuple[Port, ...]]:
        """What they give."""
        return {topic: ports for part in self.parts for topic, ports in part.topics.items()}

    def feed(self, samples: RobotSamples) -> Rows:
        """Rows of all parts for `samples`."""
        rows: Rows = {}
        for part in self.parts:
            rows |= part.feed(samples, rows)
        return rows

    def happenings(self) -> list[Happening]:
        """What has happened since the last call, in order of time."""
        found = sorted(one for part in self.parts for one in part.happenings)
        for part in self.parts:
            part.happenings.clear()
        return found


def twin_of(
    experiment: Experiment,
    model: RobotModel,
    where: str,
    watched: AlarmWatch | None = None,
    ahead: Callable[[OwnLaw, RobotState], Part] | None = None,
) -> Twin:
    """The twin of the robot that `experiment` describes.

    Args:
        where: begins sentences about what comes from the robot.
        watched: raises the alarm; None: there is no alarm.
        ahead: makes of controller and state one part that has them and predicts; None: nothing is predicted.
    """
    law = None if "controller" in experiment.stand_ins else OwnLaw(experiment)
    state = RobotState(experiment)
    followed: list[Part] = [ahead(law, state)] if ahead and law else [law, state] if law else [state]
    alarm: list[Part] = [watched] if watched else []
    return Twin([Estimates(model, where), PlantModel(model), *followed, *alarm])
