"""Healthy robots that are not what their twin believes, and what the residuals of such robots come to.

A fleet is a sweep file: skin, height, friction and noise vary as it says. The zeros of the encoders and motors, samples
that are lost and stamps that are late are drawn besides, from the seed in the file and the robot's number.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from twin.kernel.errors import InputRefused
from twin.robot.assembly.build import belief
from twin.robot.assembly.load import load_experiment
from twin.robot.controller.controller import Estimator
from twin.robot.experiment.experiment import Experiment
from twin.robot.run.trace import run_in_memory
from twin.studies.command import Say, ignore_progress
from twin.studies.replay.parts import SampledSteps
from twin.studies.replay.samples import RobotSamples, samples_of
from twin.studies.shadow.alarm import (
    BLOCK_LENGTH,
    CHANNELS,
    FIRST_BLOCKS,
    SETTLING_TIME,
    Blocks,
    ShadowWatch,
    Tolerances,
    WatchEvent,
)
from twin.studies.shadow.deviations import is_identified
from twin.studies.shadow.filter_steps import Columns, filter_outputs, shadow_of
from twin.studies.shadow.following import farthest_command, own_controllers
from twin.studies.sweep.plan import Vary, plan_of, read_definition

ZERO_RANGE = 0.05
"""deg. The zeros of all six encoders are anywhere within it, either way."""
MAX_LOST_SHARE = 0.05
"""Maximum share of the samples that do not arrive."""
MAX_STAMP_ERROR, MAX_STAMP_ERROR_SHARE = 0.8e-3, 0.4
"""Maximum error of a stamp, either way (s), and as a share of the sampling period: stamps stay in order."""
TOLERANCE_MARGIN = 1.25
"""A tolerance by the largest shift that the fleet shows: of robots that are drawn, and of one at each corner of what
varies, where shifts are largest. The largest of 96 bounds 97 % of all robots with 95 % confidence (S. S. Wilks, Ann.
Math. Statist. 12 (1941) 91)."""
MAX_CORNERS = 64
"""Maximum number of corners. Of twice as many every second one is run, so that each corner left out differs from one
that is run in one value only; of more, none is."""
SCALE_SETTINGS = ("scale.resolution_g=5", "scale.period_ms=10")
"""A measured force, of an experiment that has none."""


@dataclass(frozen=True)
class Fleet:
    """Robots like one experiment's.

    Attributes:
        experiment: file of what the twin believes.
        settings: of all robots and their twin, as of `twin run --set`.
        robots: settings of each.
        corners: settings of robots at the ends of all intervals at once.
        seed: of what is drawn besides.
    """

    experiment: Path
    settings: tuple[str, ...]
    robots: tuple[tuple[str, ...], ...]
    seed: int
    corners: tuple[tuple[str, ...], ...] = ()

    @property
    def all_robots(self) -> tuple[tuple[str, ...], ...]:
        """Those that are drawn, then those at corners."""
        return self.robots + self.corners

    def twin(self) -> Experiment:
        """What is believed of every robot."""
        return load_experiment(self.experiment, self.settings)

    def run(self, number: int, settings: Sequence[str] = ()) -> RobotSamples:
        """Samples of robot `number` of `all_robots`, from 0, as its computer takes them.

        A healthy robot whose monitor trips counts until then: without power it does not follow its commands.

        Args:
            settings: of this robot besides, a fault for example.
        """
        random = np.random.default_rng([self.seed, number])
        zeros = [
            f"plant.{side}_zero_deg={random.uniform(-ZERO_RANGE, ZERO_RANGE, 3).tolist()}"
            for side in ("motor", "joint")
        ]
        own = (*self.settings, *self.all_robots[number % len(self.all_robots)], *zeros, *settings)
        experiment = load_experiment(self.experiment, [*own, f"seed={int(random.integers(1 << 31))}"])
        run = run_in_memory(experiment, experiment.controller_ticks)
        samples = samples_of(run)
        if settings or "monitor.tripped" not in run.fields():
            return samples
        healthy = run.held("monitor.tripped")[: len(samples.t)] == 0
        return RobotSamples(samples.t[healthy], samples.u[healthy])

    def transmit(self, number: int, samples: RobotSamples, every: int = 1) -> RobotSamples:
        """One in `every` samples of robot `number`, after a way on which some are lost and stamps are off.

        A robot at a corner loses the most, and its stamps are off by the most.
        """
        random = np.random.default_rng([self.seed, number, every])
        share = random.uniform(0.0, 1.0, 2) if number < len(self.robots) else np.ones(2)
        return transmit_samples(
            RobotSamples(samples.t[::every], samples.u[::every]), random, *(share * (MAX_LOST_SHARE, MAX_STAMP_ERROR))
        )

    def samples(self, number: int, every: int = 1, settings: Sequence[str] = ()) -> RobotSamples:
        """One in `every` samples of robot `number` as they arrive; see `run`."""
        return self.transmit(number, self.run(number, settings), every)


def read_fleet(
    path: Path, experiment: Path | None = None, runs: int = 0, seed: int | None = None, settings: Sequence[str] = ()
) -> Fleet:
    """The fleet of a sweep file.

    Args:
        path: of the file.
        experiment: in place of the one that the file names; intervals are scaled by its own value over that one's,
            and values that were identified do not vary.
        runs, seed: in place of those in the file, if given: fresh robots.
        settings: of all robots and their twin.

    Raises:
        InputRefused: with every mistake of the file.
    """
    definition, named = read_definition(path)
    settings = (*SCALE_SETTINGS, *settings)
    there, here = load_experiment(named), load_experiment(experiment or named, settings)
    vary = [
        _scale_interval(one, there.values, here.values) for one in definition.vary if not is_identified(here, one.label)
    ]
    changed = {"runs": runs or definition.runs, "seed": definition.seed if seed is None else seed, "vary": vary}
    definition = definition.model_copy(update=changed)
    plan = plan_of(definition, experiment or named, path.stem, str(path), settings)
    robots = tuple(task.settings[len(settings) :] for task in plan.tasks)
    # of what has no ends there is no corner
    ends = [one.model_copy(update={"count": 2}) for one in vary if one.low is not None]
    corners: tuple[tuple[str, ...], ...] = ()
    if 2 ** len(ends) <= 2 * MAX_CORNERS:
        at_ends = definition.model_copy(update={"design": "grid", "runs": None, "vary": ends})
        grid = plan_of(at_ends, experiment or named, path.stem, str(path), settings)
        corners = tuple(task.settings[len(settings) :] for task in grid.tasks)
        if len(corners) > MAX_CORNERS:
            # those with an even number of upper ends
            corners = tuple(one for k, one in enumerate(corners) if k.bit_count() % 2 == 0)
    return Fleet(plan.experiment, settings, robots, definition.seed, corners)


def _scale_interval(one: Vary, there: Mapping[str, Any], here: Mapping[str, Any]) -> Vary:
    """An interval about a value of one experiment, about the same value of another one; as it is about 0."""
    table, _, key = one.label.partition(".")
    about, value = (values.get(table, {}).get(key) or 0.0 for values in (there, here))
    ratio = value / about if about and value / about > 0.0 else 1.0
    numbers = {name: getattr(one, name) for name in ("low", "high", "mean", "std", "median")}
    return one.model_copy(update={name: x * ratio for name, x in numbers.items() if x is not None})


def transmit_samples(
    samples: RobotSamples, random: np.random.Generator, lost: float = MAX_LOST_SHARE, late: float = MAX_STAMP_ERROR
) -> RobotSamples:
    """`samples` of which a share is lost and stamps are off by `late` (s) at most."""
    keep = random.random(len(samples.t)) >= lost
    # the filter starts with the first one
    keep[0] = True
    t = samples.t[keep]
    late = min(late, MAX_STAMP_ERROR_SHARE * float(np.median(np.diff(samples.t))))
    return RobotSamples(t + random.uniform(-late, late, len(t)), samples.u[keep])


def own_commands(twin: Experiment, samples: RobotSamples) -> Columns:
    """How far the commands of the twin's own controller, on the same counts, are from the robot's: `farthest_command`.

    Empty if the twin has no controller of its own, or one that tasks lead: where it is in its program depends on single
    samples, and some are lost.
    """
    law = [] if twin.reference is None else own_controllers(twin)
    estimator = SampledSteps(Estimator(belief(twin), twin.controller.gravity_compensation))
    rows = {"estimator": estimator.rows(samples.t, samples.u[:, :6])} if law else {}
    for part in law:
        rows |= part.feed(samples, rows)
    return farthest_command(rows)


def block_means(
    twin: Experiment, samples: RobotSamples, block: float = BLOCK_LENGTH
) -> tuple[list[float], NDArray[np.float64]]:
    """Ends (s) and means (n, channels) of all blocks of a robot beside its twin."""
    y = filter_outputs(shadow_of(twin), samples) | own_commands(twin, samples)
    found = list(Blocks(block).add_samples(samples.t, y))
    return [t for t, _ in found], np.array([means for _, means in found]).reshape(-1, len(CHANNELS))


def limits_of(means: Sequence[NDArray[np.float64]]) -> Tolerances:
    """What is no news for robots of which none has anything wrong.

    Args:
        means: block means (n, channels) of each, from its first block on.

    Raises:
        InputRefused: all runs are too short for a shift.
    """
    # two blocks after those that say what is normal: the spread is that of neighbours
    if max(map(len, means)) < (blocks := FIRST_BLOCKS + 2):
        least = SETTLING_TIME + blocks * BLOCK_LENGTH
        raise InputRefused(f"runs of healthy robots are too short; expected at least {least:g} s")
    shifts = [one[FIRST_BLOCKS:] - np.mean(one[:FIRST_BLOCKS], axis=0) for one in means]
    # of neighbours, which share all that changes slowly; half the variance of a difference is that of one of them
    steps, every = np.concatenate([np.diff(one, axis=0) for one in shifts]), np.concatenate(shifts)
    tolerance, sigma = np.full(len(CHANNELS), math.nan), np.full(len(CHANNELS), math.nan)
    # a channel that no robot has stays unknown
    there = np.isfinite(steps).any(axis=0)
    sigma[there] = np.sqrt(np.nanmean(steps[:, there] ** 2, axis=0) / 2.0)
    tolerance[there] = TOLERANCE_MARGIN * np.nanmax(np.abs(every[:, there]), axis=0)
    names = list(CHANNELS)
    return Tolerances(dict(zip(names, tolerance.tolist(), strict=True)), dict(zip(names, sigma.tolist(), strict=True)))


def fleet_limits(fleet: Fleet, thinned: Sequence[int] = (1,), say: Say = ignore_progress) -> list[Tolerances]:
    """The `limits_of` the robots of a fleet, of which one in so many samples arrives, for each of `thinned`.

    `say` takes the progress.
    """
    twin, count = fleet.twin(), len(fleet.all_robots)
    means: list[list[NDArray[np.float64]]] = [[] for _ in thinned]
    for k in range(count):
        say(f"healthy robot {k + 1} of {count}", k / count)
        run = fleet.run(k)
        for found, every in zip(means, thinned, strict=True):
            found.append(block_means(twin, fleet.transmit(k, run, every))[1])
    return [limits_of(found) for found in means]


def watch_blocks(ends: Sequence[float], means: NDArray[np.float64], watch: ShadowWatch) -> list[WatchEvent]:
    """The alarms of one robot."""
    for t, one in zip(ends, means, strict=True):
        watch.add_block(t, one)
    return watch.alarms


@dataclass(frozen=True)
class FalseAlarmRate:
    """False alarms of healthy robots.

    Attributes:
        alarms: how many.
        hours: that were watched, the blocks that say what is normal left out.
    """

    alarms: int
    hours: float

    @property
    def upper(self) -> float:
        """Rate (1/h) below which the true one is with 95 %: exact, of Poisson (F. Garwood, Biometrika 28 (1936))."""
        return float(chi2.ppf(0.95, 2 * self.alarms + 2)) / (2.0 * self.hours)
