"""Passivity of a robot in the hand: non-passive frequency bands, rendered stiffness, worst environment."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.optimize import differential_evolution

from twin.robot.assembly.roles import refuse_third_party_parts
from twin.robot.experiment.experiment import Experiment
from twin.studies.analyse.carried_mass import PassivityTrial, tried_mass
from twin.studies.analyse.linear.hand import (
    AXES,
    DRIFT_RATE,
    EMPTY_HAND,
    ROUNDING_TOLERANCE,
    Complex,
    FreePlant,
    Hand,
    hand_of,
    hertz,
    linear_plant,
    load_along,
    power_share,
    robot_with,
)
from twin.studies.analyse.linear.loops import Matrix, linear_law
from twin.studies.analyse.linearised import Linearisation, closed_loop_names
from twin.studies.analyse.operating_point import OperatingPoint, operating_points
from twin.studies.analyse.rendering import ZWidth, z_width
from twin.studies.command import Say

FREQUENCY_COUNT = 240
MASS_RANGE, STIFFNESS_RANGE = (0.01, 5.0), (1.0, 50_000.0)
"""Mass (kg) and stiffness (N/m) of environments: fingertip to forearm, almost nothing to a table."""


class Band(NamedTuple):
    """A band of frequencies (Hz) where the robot is not passive: it supplies energy to a swing.

    Attributes:
        least, at: smallest `power_share` in the band, and its frequency.
    """

    low: float
    high: float
    least: float
    at: float


class Environment(NamedTuple):
    """A passive environment of the robot: a mass (kg) on a spring (N/m), felt along one direction (3,) only.

    Attributes:
        growth: growth rate of the fastest growing pole with the robot (1/s); negative if everything dies out.
        frequency: frequency of that pole (Hz).
    """

    mass: float
    stiffness: float
    direction: tuple[float, float, float]
    growth: float
    frequency: float

    @property
    def swings(self) -> bool:
        """Whether the environment swings with the robot at a growing amplitude."""
        return self.growth > DRIFT_RATE


@dataclass(frozen=True)
class PointPassivity:
    """Passivity of the robot in a hand at one operating point.

    Attributes:
        frequency: Hz (n,).
        admittance: (n, 3, 3), m/s per N.
        springs: stiffness (3,) with the motors and the other axes held (N/m).
        bands: axis, or "all" for the three at once -> band; None if passive.
    """

    point: OperatingPoint
    stable: bool
    frequency: Matrix
    admittance: Complex
    springs: Matrix
    bands: dict[str, Band | None]
    worst: Environment

    JSON_KEYS = (
        "name=point.name p_B=point.p_B F_z=point.F_z force_loop=point.force_on stable "
        "spring_stiffness=springs not_passive=bands worst_environment=worst"
    )


@dataclass(frozen=True)
class Passivity:
    """Result of the passivity analysis of a robot, without a width if no force loop presses.

    Attributes:
        trial: check in the co-simulation; None without a mass to try.
    """

    experiment: Experiment
    points: list[PointPassivity]
    problems: list[str]
    width: ZWidth | None
    tried: bool
    trial: PassivityTrial | None

    JSON_KEYS = "experiment=experiment.name points without_linear_model=problems z_width=width trial"


def passivity(experiment: Experiment, tried: bool, say: Say) -> Passivity:
    refuse_third_party_parts(experiment, "twin analyse", ("controller", "estimator"))
    say("identifying the drives")
    points, problems = operating_points(experiment)
    shared = Linearisation(experiment, points)
    say("looking for the worst environment")
    judged = [judge_point(shared, point) for point in points]
    pressing = next((point for point in points if point.force_on), None)
    say("rendering stiffness")
    width = None if pressing is None else z_width(shared, pressing)
    say("trying it in the co-simulation")
    trial = tried_mass(shared, points, MASS_RANGE[1]) if tried else None
    return Passivity(experiment, judged, problems, width, tried, trial)


def judge_point(shared: Linearisation, point: OperatingPoint) -> PointPassivity:
    """Compute admittance, passivity and worst environment of the robot in a hand at an operating point."""
    free, settings = FreePlant(linear_plant(point.parameters, point.x, point.theta_m)), shared.settings(point.force_on)
    law, gains = linear_law(settings, shared.estimation(point)), dict.fromkeys(closed_loop_names(settings), 1.0)

    def holding(direction: Matrix, mass: float, stiffness: float) -> Hand:
        robot = robot_with(free, load_along(direction, mass, stiffness), shared.drives, shared.stepping)
        return hand_of(robot, law, gains)

    hand = hand_of(robot_with(free, EMPTY_HAND, shared.drives, shared.stepping), law, gains)
    frequency = hertz(hand.period, FREQUENCY_COUNT)
    Y = hand.admittance(2.0 * np.pi * frequency)
    bands = {axis: band(frequency, Y[:, i : i + 1, i : i + 1]) for i, axis in enumerate(AXES)}
    bands["all"] = band(frequency, Y)
    springs = np.diagonal(free.stiffness).copy()
    return PointPassivity(point, hand.stable, frequency, Y, springs, bands, worst_environment(holding))


def band(frequency: Matrix, Y: Complex) -> Band | None:
    """Return the frequency band where the admittance `Y` (n, k, k) is not passive; None if passive everywhere."""
    share = power_share(Y)
    feeding = frequency[share < -ROUNDING_TOLERANCE]
    if len(feeding) == 0:
        return None
    worst = int(share.argmin())
    return Band(float(feeding[0]), float(feeding[-1]), float(share[worst]), float(frequency[worst]))


def worst_environment(holding: Callable[[Matrix, float, float], Hand]) -> Environment:
    """Find the mass on a spring that swings most with the robot, by differential evolution.

    Lossless environments suffice: at its worst a passive environment dissipates nothing. `holding` returns the robot
    with a direction, mass (kg) and stiffness (N/m) in the hand.
    """

    def environment(x: Matrix) -> tuple[Matrix, float, float]:
        up, around = x[2], x[3]
        direction = np.array([np.sin(up) * np.cos(around), np.sin(up) * np.sin(around), np.cos(up)])
        return direction, float(np.exp(x[0])), float(np.exp(x[1]))

    bounds = [tuple(np.log(MASS_RANGE)), tuple(np.log(STIFFNESS_RANGE)), (0.0, 0.5 * np.pi), (0.0, np.pi)]
    found = differential_evolution(
        lambda x: -holding(*environment(x)).growth, bounds, maxiter=9, popsize=6, seed=0, polish=False, tol=1e-3
    )
    direction, mass, stiffness = environment(found.x)
    hand = holding(direction, mass, stiffness)
    fastest = hand.poles[np.abs(hand.poles).argmax()]
    turn = abs(float(np.angle(fastest))) / (2.0 * np.pi * hand.period)
    x, y, z = (float(part) for part in direction)
    return Environment(mass, stiffness, (x, y, z), hand.growth, turn)
