"""Fleet of healthy robots that differ from their twin's belief, and tolerances from their residuals.

A fleet is a sweep file that varies skin, height, friction and noise. Encoder and motor zeros, lost samples and stamp
errors are drawn in addition, from the file's seed and the robot's number.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

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
    COMMAND_CHANNEL,
    FIRST_BLOCKS,
    SETTLING_TIME,
    Blocks,
    ShadowWatch,
    Tolerances,
    WatchEvent,
)
from twin.studies.shadow.command_comparison import MIN_TOLERANCE, comparison_of
from twin.studies.shadow.deviations import is_identified
from twin.studies.shadow.filter_steps import Columns, filter_outputs, shadow_of
from twin.studies.shadow.following import own_controllers
from twin.studies.sweep.plan import Vary, plan_of, read_definition

ZERO_RANGE = 0.05
"""Range of the encoder zeros, to both sides (deg)."""
MAX_LOST_SHARE = 0.05
MAX_STAMP_ERROR, MAX_STAMP_ERROR_SHARE = 0.8e-3, 0.4
"""Maximum error of a stamp, either way (s), and as a share of the sampling period: stamps stay in order."""
TOLERANCE_MARGIN = 1.25
"""Factor between a tolerance and the largest shift in the fleet: of random robots, and of one at each corner of the
intervals, where shifts are largest. The largest of 96 bounds 97 % of all robots with 95 % confidence (S. S. Wilks, Ann.
Math. Statist. 12 (1941) 91)."""
MAX_CORNERS = 64
"""Maximum number of corners. With up to twice as many, every second corner is run, so that each omitted corner differs
from a run corner in one value only; with more, no corner is run."""
SCALE_SETTINGS = ("scale.resolution_g=5", "scale.period_ms=10")
"""Settings that measure the force in an experiment without a scale."""


@dataclass(frozen=True)
class Fleet:
    """Fleet of healthy robots around one experiment.

    Attributes:
        experiment: file of the twin's experiment.
        settings: settings of all robots and their twin, as of `twin run --set`.
        corners: settings of robots at the ends of all intervals.
        seed: seed of the additional random values.
    """

    experiment: Path
    settings: tuple[str, ...]
    robots: tuple[tuple[str, ...], ...]
    seed: int
    corners: tuple[tuple[str, ...], ...] = ()

    @property
    def all_robots(self) -> tuple[tuple[str, ...], ...]:
        """Settings of all robots of the fleet: random robots, then the robots at corners."""
        return self.robots + self.corners

    def twin(self) -> Experiment:
        return load_experiment(self.experiment, self.settings)

    def run(self, number: int, settings: Sequence[str] = ()) -> RobotSamples:
        """Simulate robot `number` until its monitor trips, with additional settings; return its samples."""
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
        """Keep one in `every` samples, lose some, disturb their stamps; at a corner loss and errors are largest."""
        random = np.random.default_rng([self.seed, number, every])
        share = random.uniform(0.0, 1.0, 2) if number < len(self.robots) else np.ones(2)
        return transmit_samples(
            RobotSamples(samples.t[::every], samples.u[::every]), random, *(share * (MAX_LOST_SHARE, MAX_STAMP_ERROR))
        )

    def samples(self, number: int, every: int = 1, settings: Sequence[str] = ()) -> RobotSamples:
        """Simulate robot `number` of the fleet, and return one in `every` samples as they arrive; see `run`."""
        return self.transmit(number, self.run(number, settings), every)


def read_fleet(
    path: Path, experiment: Path | None = None, runs: int = 0, seed: int | None = None, settings: Sequence[str] = ()
) -> Fleet:
    """Read a fleet of healthy robots from a sweep file.

    Args:
        experiment: experiment in place of the file's; intervals are scaled by the ratio of both values, and identified
            values do not vary.
        runs, seed: replacements of the file's values, if given, for other robots.
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
    # unbounded distributions have no corners
    ends = [one.model_copy(update={"count": 2}) for one in vary if one.low is not None]
    corners: tuple[tuple[str, ...], ...] = ()
    if 2 ** len(ends) <= 2 * MAX_CORNERS:
        at_ends = definition.model_copy(update={"design": "grid", "runs": None, "vary": ends})
        grid = plan_of(at_ends, experiment or named, path.stem, str(path), settings)
        corners = tuple(task.settings[len(settings) :] for task in grid.tasks)
        if len(corners) > MAX_CORNERS:
            # corners with an even number of upper ends
            corners = tuple(one for k, one in enumerate(corners) if k.bit_count() % 2 == 0)
    return Fleet(plan.experiment, settings, robots, definition.seed, corners)


def _scale_interval(one: Vary, there: Mapping[str, Any], here: Mapping[str, Any]) -> Vary:
    """Scale an interval of a parameter from one experiment's value to another's, by their ratio; unchanged around 0."""
    table, _, key = one.label.partition(".")
    about, value = (values.get(table, {}).get(key) or 0.0 for values in (there, here))
    ratio = value / about if about and value / about > 0.0 else 1.0
    numbers = {name: getattr(one, name) for name in ("low", "high", "mean", "std", "median")}
    return one.model_copy(update={name: x * ratio for name, x in numbers.items() if x is not None})


def transmit_samples(
    samples: RobotSamples, random: np.random.Generator, lost: float = MAX_LOST_SHARE, late: float = MAX_STAMP_ERROR
) -> RobotSamples:
    """Simulate a transmission: lose a share of the samples, and disturb their stamps by up to `late` (s)."""
    keep = random.random(len(samples.t)) >= lost
    # the filter starts with the first one
    keep[0] = True
    t = samples.t[keep]
    late = min(late, MAX_STAMP_ERROR_SHARE * float(np.median(np.diff(samples.t))))
    return RobotSamples(t + random.uniform(-late, late, len(t)), samples.u[keep])


def own_commands(twin: Experiment, samples: RobotSamples) -> Columns:
    """Run the twin's own controller on a robot's counts, and return the largest difference of its commands from the
    robot's; see `CommandComparison`.

    Empty without a comparison, see `comparison_of`.
    """
    comparison = comparison_of(twin)
    if comparison is None:
        return {}
    estimator = SampledSteps(Estimator(belief(twin), twin.controller.gravity_compensation))
    rows = {"estimator": estimator.rows(samples.t, samples.u[:, :6])}
    for part in own_controllers(twin):
        rows |= part.feed(samples, rows)
    return comparison.feed(samples.t, rows)


def block_means(twin: Experiment, samples: RobotSamples) -> tuple[list[float], NDArray[np.float64]]:
    y = filter_outputs(shadow_of(twin), samples) | own_commands(twin, samples)
    found = list(Blocks().add_samples(samples.t, y))
    return [t for t, _ in found], np.array([means for _, means in found]).reshape(-1, len(CHANNELS))


def limits_of(means: Sequence[NDArray[np.float64]]) -> Tolerances:
    """Compute the alarm's tolerances from the block means of healthy robots."""
    # at least two blocks after the reference: the spread is computed from neighbours
    if max(map(len, means)) < (blocks := FIRST_BLOCKS + 2):
        least = SETTLING_TIME + blocks * BLOCK_LENGTH
        raise InputRefused(f"runs of healthy robots are too short; expected at least {least:g} s")
    shifts = [one[FIRST_BLOCKS:] - np.mean(one[:FIRST_BLOCKS], axis=0) for one in means]
    # differences of neighbours cancel slow changes; their variance is twice the variance of a block
    steps, every = np.concatenate([np.diff(one, axis=0) for one in shifts]), np.concatenate(shifts)
    tolerance, sigma = np.full(len(CHANNELS), math.nan), np.full(len(CHANNELS), math.nan)
    # a channel without values stays NaN
    there = np.isfinite(steps).any(axis=0)
    sigma[there] = np.sqrt(np.nanmean(steps[:, there] ** 2, axis=0) / 2.0)
    tolerance[there] = TOLERANCE_MARGIN * np.nanmax(np.abs(every[:, there]), axis=0)
    names = list(CHANNELS)
    command = names.index(COMMAND_CHANNEL)
    tolerance[command] = np.maximum(tolerance[command], MIN_TOLERANCE)
    return Tolerances(dict(zip(names, tolerance.tolist(), strict=True)), dict(zip(names, sigma.tolist(), strict=True)))


def fleet_limits(fleet: Fleet, thinned: Sequence[int] = (1,), say: Say = ignore_progress) -> list[Tolerances]:
    """Compute the alarm's tolerances from a fleet per factor in `thinned` (one of so many samples arrives)."""
    twin, count = fleet.twin(), len(fleet.all_robots)
    means: list[list[NDArray[np.float64]]] = [[] for _ in thinned]
    for k in range(count):
        say(f"healthy robot {k + 1} of {count}", k / count)
        run = fleet.run(k)
        for found, every in zip(means, thinned, strict=True):
            found.append(block_means(twin, fleet.transmit(k, run, every))[1])
    return [limits_of(found) for found in means]


def watch_blocks(ends: Sequence[float], means: NDArray[np.float64], watch: ShadowWatch) -> list[WatchEvent]:
    for t, one in zip(ends, means, strict=True):
        watch.add_block(t, one)
    return watch.alarms
