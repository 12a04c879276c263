"""Parts of a twin that turn a robot's samples into rows: estimates of position and force, and the plant model.

A replay feeds them a whole log in one slice, a live session the samples as they arrive. Rows do not depend on the
slices, but the plant model's differ by rounding of the interpolation across a slice boundary.
"""

import math
from collections.abc import Mapping
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from twin.kernel.cosim.component import Component, Pieces
from twin.kernel.cosim.delay import NO_PIECES, play, values_by_port
from twin.kernel.cosim.port import Port, width
from twin.kernel.errors import ComponentFailed
from twin.kernel.recording.logs.log import LogError
from twin.robot.controller.controller import ESTIMATOR_OUTPUTS, Belief, Estimator
from twin.robot.plant.component import PLANT_OUTPUTS as MOTION
from twin.robot.plant.component import Plant
from twin.robot.plant.dynamics import LONGEST_GAP, STATE_SIZE, PlantParameters
from twin.robot.plant.encoder import SCALE_OUTPUTS
from twin.robot.plant.surface_motion import Body
from twin.studies.replay.model import RobotModel
from twin.studies.replay.plausible import MapCheck
from twin.studies.replay.sample_columns import COUNT_L, COUNT_M, F_Z
from twin.studies.replay.samples import RobotSamples

ENCODER_PORTS = (
    Port("count_m", 3, "1", "motor encoder counts as the estimator took them"),
    Port("count_l", 3, "1", "joint encoder counts as the estimator took them"),
)
FORCE_RESIDUAL = (Port("F_z", 1, "N", "pressing force less the measured one"),)
JOINT_RESIDUAL = (Port("theta_l", 3, "rad", "joint angles of the plant model less those of the log"),)
SETTLING_TIME = 1.0
"""Settling time before each start (s): 20 time constants of the springs with the joint friction, 5 with a quarter."""
RESTART_TEXT = "the plant model restarts at rest"

Rows = dict[str, NDArray[np.float64]]
"""Rows by topic, (n, width); an all-NaN row is missing."""


class Happening(NamedTuple):
    """Event during a replay or session. t: time since the first sample (s); text: one sentence."""

    t: float
    text: str


class Part(Protocol):
    """Interface of a part that turns samples into rows: ports by topic, events since they were last cleared."""

    topics: dict[str, tuple[Port, ...]]
    happenings: list[Happening]

    def feed(self, samples: RobotSamples, rows: Rows) -> Rows:
        """Process samples of the robot, and return this part's output rows.

        Args:
            samples: at least one sample, later than the samples of the last call.
            rows: rows of the previous parts for the same samples.
        """


class SampledSteps:
    """Sampled component stepped over successive slices of samples.

    Args:
        first: length of the first step (s).
        pieces: pieces of its memory to copy.

    Attributes:
        copies: copies of the pieces before the last slice and after each of its rows (n + 1, pieces.size).
    """

    def __init__(self, component: Component, first: float = 0.0, pieces: Pieces = NO_PIECES):
        self.component, self._first, self._pieces = component, first, pieces
        self._outputs, self.copies = component.initial_outputs, pieces.save()[None]
        self._last: float | None = None

    def rows(self, t: NDArray[np.float64], inputs: NDArray[np.float64]) -> NDArray[np.float64]:
        """Step the sampled component, and return its outputs (n, width) at times `t` (n,), s; fewer if a step fails."""
        h = np.diff(t, prepend=t[0] - self._first if self._last is None else self._last)
        copies = np.empty((len(t) + 1, self._pieces.size), dtype=np.uint8)
        copies[0] = self.copies[-1]
        rows, _ = play(self.component, t, h, inputs, before=self._outputs, pieces=self._pieces, copies=copies[1:])
        # after a failed step the memory is as the step left it
        copies[len(rows) + 1 :] = self._pieces.save()
        self.copies = copies
        if len(rows):
            self._outputs, self._last = rows[-1], float(t[len(rows) - 1])
        return rows


class Estimates:
    """Estimates from the counts with the controller's belief, and with the plant's dead zone if it lacks one."""

    def __init__(self, model: RobotModel, check: MapCheck):
        self._check = check
        beliefs: dict[str, Belief] = {"estimator": model.belief}
        if model.belief_with_dead_zone != model.belief:
            beliefs["twin"] = model.belief_with_dead_zone
        self._steps = {
            name: SampledSteps(Estimator(belief, model.gravity_compensation)) for name, belief in beliefs.items()
        }
        self.topics: dict[str, tuple[Port, ...]] = {
            "encoder": ENCODER_PORTS, **dict.fromkeys(beliefs, ESTIMATOR_OUTPUTS), "scale": SCALE_OUTPUTS,
            "residual/force": FORCE_RESIDUAL,
        }  # fmt: skip
        self.happenings: list[Happening] = []
        self._begun = False

    def feed(self, samples: RobotSamples, rows: Rows) -> Rows:
        counts, measured = samples.counts, samples.u[:, F_Z]
        found = {"encoder": counts, "scale": measured}
        for name, stepped in self._steps.items():
            found[name] = stepped.rows(samples.t, counts)
        if not self._begun:
            # the estimator needs a first pose
            failed = len(found["estimator"]) < len(counts)
            if mistake := self._check.check_first(counts[0, COUNT_M], counts[0, COUNT_L], failed):
                raise LogError(mistake)
            self._begun = True
        best = best_estimate(found)
        F_z = pressing(best)
        found["residual/force"] = F_z[:, None] - measured
        self._check.add(best["theta_m"], best["theta_l"])
        self._check.add_force(F_z, measured[:, 0])
        return found


def best_estimate(rows: Rows) -> dict[str, NDArray[np.float64]]:
    """Select the estimate that includes the dead zone, by output port."""
    return values_by_port(ESTIMATOR_OUTPUTS, rows.get("twin", rows["estimator"]))


def pressing(outputs: Mapping[str, NDArray[np.float64]]) -> NDArray[np.float64]:
    return -outputs["F_ee_B"][:, 2]


class PlantRun:
    """Simulation of the plant by motor angles, in slices, settled at `p_B` (3,), m, of the first sample."""

    def __init__(self, model: RobotModel, p_B: NDArray[np.float64]):
        self._model, self._p_B = model, p_B
        self._plant: Plant | None = None
        self._t, self._theta_m = 0.0, np.zeros(3)
        self._body = Body(model.motions) if model.motions else None

    def advance(self, t: NDArray[np.float64], theta_m: NDArray[np.float64]) -> tuple[NDArray[np.float64], str]:
        """Simulate the plant up to the samples at `t` (n,), s, with motor angles `theta_m` (n, 3), rad.

        Returns:
            The plant's outputs at the samples, fewer after a failure, and the failure or "".
        """
        model, begins = self._model, self._plant is None
        if begins:
            x = np.zeros(STATE_SIZE)
            x[:3] = self._p_B
            self._plant = Plant(model.plant, x, theta_m[0], model.substeps, bool(model.motions))
            self._start, self._elapsed = t[0] - SETTLING_TIME, 0.0
            self._outputs = self._plant.initial_outputs
            settling = [int(np.ceil(SETTLING_TIME / model.tick))]
            known, angles = t, theta_m
        else:
            settling = []
            known, angles = np.concatenate([[self._t], t]), np.vstack([self._theta_m, theta_m])
        assert self._plant is not None
        steps = np.array([*settling, *np.maximum(1, np.ceil(np.diff(known) / model.tick - 1e-6))], dtype=np.int64)
        lengths = np.array([*([SETTLING_TIME] if begins else []), *np.diff(known)])
        h = np.repeat(lengths / steps, steps)
        elapsed = np.cumsum([self._elapsed, *h])[1:]
        ends = self._start + elapsed
        u = np.stack([np.interp(ends, known, angles[:, i]) for i in range(3)], axis=1)
        if self._body is not None:
            ground, _ = play(self._body, ends - h, h, np.empty((len(h), 0)))
            if begins:
                ground[: steps[0]] = [*ground[steps[0] - 1][:3], 0.0, 0.0, 0.0]
            u = np.hstack([u, ground])
        rows, status = play(self._plant, ends - h, h, u, steps, self._outputs)
        if status:
            return rows, self._plant.explain(status)
        self._t, self._theta_m, self._elapsed, self._outputs = float(t[-1]), theta_m[-1], elapsed[-1], rows[-1]
        return rows, ""


class PlantModel:
    """Part of a twin: the plant simulated with the robot's motor angles, and its joint angles less the robot's.

    It starts at rest at the robot's position, and again after a gap of more than `LONGEST_GAP`, or outside the
    workspace. A start discards stiction.

    Args:
        restarts: whether it restarts outside the workspace; else `feed` raises `ComponentFailed`.
    """

    def __init__(self, model: RobotModel, restarts: bool = True):
        self.topics: dict[str, tuple[Port, ...]] = {"plant": MOTION, "residual/joints": JOINT_RESIDUAL}
        self._model, self._restarts = model, restarts
        self.starts: list[float] = []
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
                self.happenings.append(Happening(float(samples.t[a]), RESTART_TEXT))
                self._run = None
            begin = a
            while begin < b:
                if self._run is None:
                    self._run = PlantRun(self._model, best["p_B"][begin])
                    self.starts.append(float(samples.t[begin]))
                made, failure = self._run.advance(samples.t[begin:b], best["theta_m"][begin:b])
                found[begin : begin + len(made)] = made
                begin += len(made)
                if failure:
                    when = float(samples.t[min(begin, b - 1)])
                    if not self._restarts:
                        raise ComponentFailed(
                            f"the plant model, driven by the log's motor angles, {failure} before t = {when:.3f} s; "
                            "does the experiment describe this robot?"
                        )
                    self.happenings.append(Happening(when, f"the plant model {failure}; it restarts at rest"))
                    self._run = None
                    # skip a sample that it cannot start from
                    begin += not len(made)
        self._last = float(samples.t[-1])
        theta_l = values_by_port(MOTION, found)["theta_l"]
        return {"plant": found, "residual/joints": theta_l - best["theta_l"]}

    def accept(self, plant: PlantParameters) -> None:
        """Restart the plant model from rest, with the parameters of another plant."""
        self._model, self._run = replace(self._model, plant=plant), None
