"""How passive a robot is in the hand: where it gives energy away, what it renders passively, what makes it swing.

A prediction of passivity tried: a mass that the robot should just carry, and one that should just make it swing. A
robot that is not passive swings with some passive environment. The one that can be put into the co-simulation without a
part of its own is a mass on the platform, of which the controller knows the weight; felt in all directions, it is a
mass that a hand carries. With less than the predicted mass a nudge has to die out, with more it has to grow.

The stiffness that the force loop renders along z, over virtual stiffness and damping; how much of it passively.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.optimize import differential_evolution

from twin.kernel.errors import InputRefused
from twin.robot.assembly.roles import refuse_other_parts
from twin.robot.controller.pid import Gains
from twin.robot.experiment.experiment import Experiment, with_model, with_plant
from twin.studies.analyse.linear.hand import (
    AXES,
    DRIFT,
    NEUTRAL,
    NOTHING,
    Complex,
    FreePlant,
    Hand,
    along,
    hand_of,
    hertz,
    linear_plant,
    power_share,
    robot_with,
)
from twin.studies.analyse.linear.loops import LOOPS, Matrix, closed_poles, linear_law
from twin.studies.analyse.nudge import NUDGED, nudged_paths
from twin.studies.analyse.operating_point import Linearised, OperatingPoint, closed_in, operating_points, resting_point
from twin.studies.command import Say

INSIDE, OUTSIDE = 0.85, 1.15
"""Of the predicted mass: off by 15 % at most, as gain limits are allowed to be."""
NUDGE = 3e-4
"""m: several counts of the encoders it would be, were they not exact; far below what drives saturate at."""
LONG = 25.0
"""s. What changes by a tenth of its size a second is seen."""
WINDOW = 2.0
"""s, of which the swing is taken."""
HALVINGS = 20


@dataclass(frozen=True)
class PassivityTrial:
    """A mass in the hand, in the air.

    Attributes:
        mass: at which the linear model begins to swing (kg).
        predicted: growth at `INSIDE` and `OUTSIDE` of it (1/s).
        simulated: the same of the co-simulation; infinite: it flew off.
    """

    point: OperatingPoint
    mass: float
    predicted: tuple[float, float]
    simulated: tuple[float, float]

    @property
    def confirmed(self) -> bool:
        """Whether a nudge dies out just inside and grows just outside."""
        return self.simulated[0] < 0.0 < self.simulated[1]

    @property
    def tried(self) -> tuple[float, float]:
        """Masses (kg) that were tried."""
        return INSIDE * self.mass, OUTSIDE * self.mass

    JSON_KEYS = "p_B=point.p_B mass tried growth_predicted=predicted growth_simulated=simulated confirmed"


def tried_mass(shared: Linearised, points: list[OperatingPoint], most: float) -> PassivityTrial | None:
    """The mass on the platform with which the robot begins to swing in the air, tried; None: none up to `most` (kg)."""
    air = next((point for point in points if not point.in_contact), None)
    if air is None or _growth(shared, air, most) <= 0.0 or _growth(shared, air, 0.0) >= 0.0:
        return None
    low, high = 0.0, most
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if _growth(shared, air, middle) > 0.0 else (middle, high)
    tried = INSIDE * low, OUTSIDE * low
    predicted = _growth(shared, air, tried[0]), _growth(shared, air, tried[1])
    simulated = _simulated(shared.experiment, air, tried[0]), _simulated(shared.experiment, air, tried[1])
    return PassivityTrial(air, low, predicted, simulated)


def _carrying(point: OperatingPoint, mass: float) -> OperatingPoint:
    parameters = point.parameters._replace(m_p=point.parameters.m_p + mass)
    return resting_point(point.name, parameters, point.p_B, point.force_on)


def _growth(shared: Linearised, point: OperatingPoint, mass: float) -> float:
    """1/s, of the linear model with `mass` (kg) more on the platform; infinite where it cannot rest."""
    try:
        linear = shared.of(_loaded(shared.experiment, mass)).at(_carrying(point, mass))
    except InputRefused:
        return np.inf
    poles = closed_poles(linear.loops, linear.gains)
    return float(np.log(np.abs(poles).max()) / linear.loops.dt)


def _loaded(experiment: Experiment, mass: float) -> Experiment:
    """With `mass` (kg) on the platform, of which the controller knows."""
    heavy = with_plant(experiment, m_p=experiment.plant.m_p + mass)
    return with_model(heavy, m_p=experiment.controller.model.m_p + mass)


def _simulated(experiment: Experiment, point: OperatingPoint, mass: float) -> float:
    """Growth (1/s) of a nudge in the co-simulation; infinite: the platform flew off."""
    law = "position"
    (path,) = nudged_paths(_loaded(experiment, mass), _carrying(point, mass), law, 1.0, [NUDGE], LONG)
    tick = experiment.cosim.tick
    if len(path) <= round(LONG / tick):
        return np.inf
    width, begin = round(WINDOW / tick), round((NUDGED + 0.4 * (LONG - NUDGED)) / tick)
    early, late = _swing(path[begin : begin + width]), _swing(path[-width:])
    return float(np.log(late / early) / ((len(path) - width - begin) * tick))


def _swing(path: Matrix) -> float:
    """rms about a straight line, all axes together (m)."""
    t = np.arange(len(path), dtype=float)
    rest = [p - np.polyval(np.polyfit(t, p, 1), t) for p in path.T]
    return float(np.sqrt(np.mean(np.square(rest))))


WIDTH_FREQUENCIES = 70
"""So many are looked at of a cell of the map."""
RENDERED = np.geomspace(50.0, 8000.0, 28)
"""Virtual stiffness (N/m)."""
DAMPED = np.geomspace(10.0, 3000.0, 22)
"""Virtual damping (N s/m)."""
WIDTH_HALVINGS = 18
"""Of the interval in which the largest stiffness is looked for."""


@dataclass(frozen=True)
class Width:
    """What the force loop can render along z without an integral (Z-width, Colgate and Brown 1994).

    The law asks for kp (p_ref - kp_F (F_ref - F_z) - p) of speed, which is a spring of 1/kp_F with a damper of
    1/(kp kp_F) beside it.

    Attributes:
        stiffness, damping: virtual, N/m (n,) and N s/m (m,).
        least: smallest `power_share` (m, n); NaN: unstable in the air.
        largest: stiffness at rest that the robot renders passively (N/m), and the virtual stiffness and damping with
            which it does; 0: none.
        spring: the physical springs' there, with the other axes held (N/m).
    """

    point: OperatingPoint
    stiffness: Matrix
    damping: Matrix
    least: Matrix
    largest: tuple[float, float, float]
    spring: float

    JSON_KEYS = (
        "p_B=point.p_B largest_passive_stiffness=largest.0 its_virtual_stiffness=largest.1 "
        "its_virtual_damping=largest.2 spring_stiffness=spring virtual_stiffness=stiffness "
        "virtual_damping=damping least_power_share=least"
    )


def z_width(shared: Linearised, point: OperatingPoint) -> Width:
    """What can be rendered along z at `point`, where the force loop presses."""
    free = FreePlant(linear_plant(point.parameters, point.x, point.theta_m))
    robot = robot_with(free, NOTHING, shared.drives, shared.stepping)
    settings, estimation = shared.settings(True), shared.estimation(point)
    omega = 2.0 * np.pi * hertz(shared.stepping.period * shared.stepping.tick, WIDTH_FREQUENCIES)

    def rendering(stiffness: float, damping: float) -> Hand:
        position = Gains(stiffness / damping, 0.0, 0.0, settings.position.derivative_corner)
        force = Gains(1.0 / stiffness, 0.0, 0.0, settings.force.derivative_corner)
        law = linear_law(settings._replace(position=position, force=force), estimation)
        return hand_of(robot, law, dict.fromkeys(LOOPS, 1.0))

    def least(stiffness: float, damping: float) -> float:
        hand = rendering(stiffness, damping)
        return float(power_share(hand.admittance(omega)[:, 2:, 2:]).min()) if hand.stable else np.nan

    chart = np.array([[least(stiffness, damping) for stiffness in RENDERED] for damping in DAMPED])
    largest = (0.0, 0.0, 0.0)
    for row, damping in zip(chart, DAMPED, strict=True):
        edge = largest_passive(lambda stiffness, damping=damping: least(stiffness, damping), row)  # type: ignore[misc]
        if edge:
            largest = max(largest, (rendering(edge, damping).stiffness[2], edge, float(damping)))
    return Width(point, RENDERED, DAMPED, chart, largest, float(free.stiffness[2, 2]))


def largest_passive(least: Callable[[float], float], row: Matrix) -> float:
    """The virtual stiffness (N/m) up to which `least` is not negative; 0: not even the softest.

    Args:
        row: `least` at `RENDERED`.
    """
    feeding = np.flatnonzero(~(row >= -NEUTRAL))
    if len(feeding) == 0:
        return float(RENDERED[-1])
    if feeding[0] == 0:
        return 0.0
    low, high = RENDERED[feeding[0] - 1], RENDERED[feeding[0]]
    for _ in range(WIDTH_HALVINGS):
        middle = np.sqrt(low * high)
        low, high = (middle, high) if least(middle) >= -NEUTRAL else (low, middle)
    return float(low)


FREQUENCIES = 240
"""So many are looked at of a point."""
MASSES, STIFFNESSES = (0.01, 5.0), (1.0, 50_000.0)
"""kg and N/m: from a fingertip to a forearm, from nothing to a table."""


class Band(NamedTuple):
    """Where something feeds a swing.

    Attributes:
        low, high: of the lowest and the highest frequency that does (Hz).
        least: see `power_share`, at the worst of them.
        at: that one (Hz).
    """

    low: float
    high: float
    least: float
    at: float


class Environment(NamedTuple):
    """A mass on a spring to the ground, both felt along one direction only.

    Attributes:
        mass: kg.
        stiffness: N/m.
        direction: (3,), of length 1.
        growth: of what then grows fastest, 1/s; negative: everything dies out.
        frequency: of that (Hz).
    """

    mass: float
    stiffness: float
    direction: tuple[float, float, float]
    growth: float
    frequency: float

    @property
    def swings(self) -> bool:
        """Whether it swings for ever with the robot, growing."""
        return self.growth > DRIFT


@dataclass(frozen=True)
class PointPassivity:
    """What a hand feels at one operating point.

    Attributes:
        frequency: Hz (n,).
        admittance: (n, 3, 3), m/s per N.
        springs: stiffness (3,) with the motors held and the other axes held (N/m).
        bands: by axis, and "all" for the three at once; None: passive.
        worst: of all masses on springs the one that makes it swing most.
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
    """A robot in the hand, judged.

    Attributes:
        problems: sentences about points that have no linear model.
        width: None where no force loop presses.
        trial: what came of it; None: there was nothing to try.
    """

    experiment: Experiment
    points: list[PointPassivity]
    problems: list[str]
    width: Width | None
    tried: bool
    trial: PassivityTrial | None

    JSON_KEYS = "experiment=experiment.name points without_linear_model=problems z_width=width trial"


def passivity(experiment: Experiment, tried: bool, say: Say) -> Passivity:
    """Judge `experiment`, of which the body is taken away; its drives are run in this process."""
    refuse_other_parts(experiment, "twin analyse", ("controller", "estimator"))
    say("identifying the drives")
    points, problems = operating_points(experiment)
    shared = Linearised(experiment, points)
    say("looking for the worst environment")
    judged = [judged_point(shared, point) for point in points]
    pressing = next((point for point in points if point.force_on), None)
    say("rendering stiffness")
    width = None if pressing is None else z_width(shared, pressing)
    say("trying it in the co-simulation")
    trial = tried_mass(shared, points, MASSES[1]) if tried else None
    return Passivity(experiment, judged, problems, width, tried, trial)


def judged_point(shared: Linearised, point: OperatingPoint) -> PointPassivity:
    """What a hand feels at `point`."""
    free, settings = FreePlant(linear_plant(point.parameters, point.x, point.theta_m)), shared.settings(point.force_on)
    law, gains = linear_law(settings, shared.estimation(point)), dict.fromkeys(closed_in(settings), 1.0)

    def holding(direction: Matrix, mass: float, stiffness: float) -> Hand:
        robot = robot_with(free, along(direction, mass, stiffness), shared.drives, shared.stepping)
        return hand_of(robot, law, gains)

    hand = hand_of(robot_with(free, NOTHING, shared.drives, shared.stepping), law, gains)
    frequency = hertz(hand.period, FREQUENCIES)
    Y = hand.admittance(2.0 * np.pi * frequency)
    bands = {axis: band(frequency, Y[:, i : i + 1, i : i + 1]) for i, axis in enumerate(AXES)}
    bands["all"] = band(frequency, Y)
    springs = np.diagonal(free.stiffness).copy()
    return PointPassivity(point, hand.stable, frequency, Y, springs, bands, worst_environment(holding))


def band(frequency: Matrix, Y: Complex) -> Band | None:
    """Where `Y` (n, k, k) at `frequency` (Hz) is not passive; None: nowhere."""
    share = power_share(Y)
    feeding = frequency[share < -NEUTRAL]
    if len(feeding) == 0:
        return None
    worst = int(share.argmin())
    return Band(float(feeding[0]), float(feeding[-1]), float(share[worst]), float(frequency[worst]))


def worst_environment(holding: Callable[[Matrix, float, float], Hand]) -> Environment:
    """Of all masses and springs along one direction what grows fastest with a robot, by differential evolution.

    Lossless ones are enough: a passive environment takes nothing away at its worst.

    Args:
        holding: the robot with a direction, a mass (kg) and a stiffness (N/m) in the hand.
    """

    def made(x: Matrix) -> tuple[Matrix, float, float]:
        up, around = x[2], x[3]
        direction = np.array([np.sin(up) * np.cos(around), np.sin(up) * np.sin(around), np.cos(up)])
        return direction, float(np.exp(x[0])), float(np.exp(x[1]))

    bounds = [tuple(np.log(MASSES)), tuple(np.log(STIFFNESSES)), (0.0, 0.5 * np.pi), (0.0, np.pi)]
    found = differential_evolution(
        lambda x: -holding(*made(x)).growth, bounds, maxiter=9, popsize=6, seed=0, polish=False, tol=1e-3
    )
    direction, mass, stiffness = made(found.x)
    hand = holding(direction, mass, stiffness)
    fastest = hand.poles[np.abs(hand.poles).argmax()]
    turn = abs(float(np.angle(fastest))) / (2.0 * np.pi * hand.period)
    x, y, z = (float(part) for part in direction)
    return Environment(mass, stiffness, (x, y, z), hand.growth, turn)
