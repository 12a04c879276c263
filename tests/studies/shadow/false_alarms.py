"""False alarms of fresh healthy robots: `python -m tests.studies.shadow.false_alarms EXPERIMENT ROBOTS FILE`.

Robots are drawn from the shipped fleet with seeds that no tolerance was computed from. Each loses 5 % of its samples,
and its stamps are off by up to 0.8 ms; slower sampling rates are thinned from the same run. FILE gets a row for each
robot and rate; robots that it has are not run again, so that a count may be stopped and continued.
"""

import argparse
import json
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.stats import chi2

from tests.studies.shadow.robots import shipped_fleet
from twin.robot.paths import PROJECT_FOLDER
from twin.studies.replay.samples import RobotSamples
from twin.studies.shadow.alarm import FIRST_BLOCKS, RateTolerances, ShadowWatch, tolerances_at
from twin.studies.shadow.fleet import Fleet, block_means, read_fleet, transmit_samples, watch_blocks
from twin.studies.shadow.tolerances import FLEET_FILE, PERIOD_FACTORS, tolerances_of

FIRST_SEED, BATCH = 1000, 500
"""Seed of the first robots, and number of robots per seed."""
PER_HOUR = (1.0, 0.01)
"""False alarms per hour that are asked for."""


class FalseAlarmRate(NamedTuple):
    """Rate of false alarms on healthy robots, over the watched time without reference blocks (h)."""

    alarms: int
    hours: float

    @property
    def upper(self) -> float:
        """Upper 95 % bound of the false alarm rate (1/h), exact for Poisson (F. Garwood, Biometrika 28 (1936))."""
        return float(chi2.ppf(0.95, 2 * self.alarms + 2)) / (2.0 * self.hours)


class Count(NamedTuple):
    """Alarms of one robot at one sampling rate (Hz).

    Attributes:
        settings: of all robots, "table.key=value" texts.
        robot: its number.
        blocks: seconds in which it was watched.
        alarms, rare: channels that alarmed at each of `PER_HOUR`.
    """

    experiment: str
    settings: Sequence[str]
    robot: int
    rate: float
    blocks: int
    alarms: Sequence[str]
    rare: Sequence[str]


@cache
def _fleet(experiment: str, settings: tuple[str, ...], seed: int) -> Fleet:
    return read_fleet(FLEET_FILE, PROJECT_FOLDER / "experiments" / f"{experiment}.toml", BATCH, seed, settings)


@cache
def _limits(experiment: str, settings: tuple[str, ...]) -> RateTolerances:
    return tolerances_of(shipped_fleet(PROJECT_FOLDER / "experiments" / f"{experiment}.toml", settings))[0]


def counts(
    experiment: str, robot: int, thinned: Iterable[int] = PERIOD_FACTORS, settings: tuple[str, ...] = ()
) -> Iterator[Count]:
    """Alarms of one robot at each sampling rate that has tolerances."""
    fleet = _fleet(experiment, settings, FIRST_SEED + robot // BATCH)
    twin, run = fleet.twin(), fleet.run(robot % BATCH)
    for every in thinned:
        rate = 1.0 / (every * twin.controller_ticks * twin.cosim.tick)
        limits = tolerances_at(_limits(experiment, settings), rate)
        if limits is None:
            continue
        random = np.random.default_rng([fleet.seed, robot, every])
        ends, means = block_means(twin, transmit_samples(RobotSamples(run.t[::every], run.u[::every]), random))
        alarms = [[one.channel for one in watch_blocks(ends, means, ShadowWatch(limits, N))] for N in PER_HOUR]
        yield Count(experiment, settings, robot, rate, max(0, len(ends) - FIRST_BLOCKS), *alarms)


def rates(rows: Iterable[Count]) -> dict[tuple[str, ...], tuple[FalseAlarmRate, FalseAlarmRate]]:
    """Rates of false alarms at each of `PER_HOUR` by experiment, settings and sampling rate; and by sampling rate."""
    sums: dict[tuple[str, ...], list[float]] = defaultdict(lambda: [0.0, 0.0, 0.0])
    for one in rows:
        for key in ((one.experiment, *one.settings, f"{one.rate:g} Hz"), ("all", f"{one.rate:g} Hz")):
            for k, value in enumerate((one.blocks / 3600.0, len(one.alarms), len(one.rare))):
                sums[key][k] += value
    return {
        key: (FalseAlarmRate(int(often), hours), FalseAlarmRate(int(rare), hours))
        for key, (hours, often, rare) in sums.items()
    }


def main() -> None:
    command = argparse.ArgumentParser(description="Count false alarms of fresh healthy robots.")
    command.add_argument("experiment")
    command.add_argument("robots", type=int)
    command.add_argument("file", type=Path)
    command.add_argument("--thinned", type=int, nargs="*", default=PERIOD_FACTORS)
    command.add_argument("--set", nargs="*", default=(), dest="settings")
    asked = command.parse_args()
    settings, rows = tuple(asked.settings), list[Count]()
    if asked.file.exists():
        rows = [Count(*json.loads(line)) for line in asked.file.read_text().splitlines()]
    done = {one.robot for one in rows if (one.experiment, *one.settings) == (asked.experiment, *settings)}
    with asked.file.open("a") as file:
        for robot in sorted(set(range(asked.robots)) - done):
            found = list(counts(asked.experiment, robot, asked.thinned, settings))
            rows += found
            file.writelines(json.dumps(one) + "\n" for one in found)
            file.flush()
    for key, (often, rare) in sorted(rates(rows).items()):
        print(
            f"{' '.join(key)}: {often.hours:.2f} h; {often.alarms} alarms at {PER_HOUR[0]:g} an hour, at most "
            f"{often.upper:.3g}/h (95 %); {rare.alarms} at {PER_HOUR[1]:g}, at most {rare.upper:.3g}/h"
        )


if __name__ == "__main__":
    main()
