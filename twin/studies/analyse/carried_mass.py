"""Check of a passivity prediction in the co-simulation, with a mass just below and just above the predicted limit.

A robot that is not passive swings with some passive environment. The only such environment that the co-simulation can
have without a component of its own is a mass on the platform whose weight the controller knows; felt in all directions,
it is a mass carried by a hand. A nudge must die out below the predicted mass and grow above it.
"""

from dataclasses import dataclass

import numpy as np

from twin.kernel.errors import InputRefused
from twin.robot.experiment.experiment import Experiment, with_model, with_plant
from twin.studies.analyse.linear.loops import Matrix, closed_poles
from twin.studies.analyse.linearised import Linearisation
from twin.studies.analyse.nudge import NUDGE_TIME, nudged_paths
from twin.studies.analyse.operating_point import OperatingPoint, resting_point

STABLE_SHARE, UNSTABLE_SHARE = 0.85, 1.15
"""Shares of the predicted mass that are simulated: 15 % off, the same tolerance as for gain limits."""
NUDGE_SIZE = 3e-4
"""Nudge (m): several counts of real encoders (those here are exact), far below saturation of the drives."""
TRIAL_TIME = 25.0
"""Duration of a trial (s); long enough to detect a change of a tenth per second."""
SWING_WINDOW = 2.0
"""Duration over which the swing is measured (s)."""
MASS_HALVINGS = 20


@dataclass(frozen=True)
class PassivityTrial:
    """Check of a passivity prediction in the co-simulation, by the smallest mass (kg) that makes the model swing.

    Attributes:
        predicted, simulated: growth rates at `STABLE_SHARE` and `UNSTABLE_SHARE` of the mass (1/s); a simulated one
            is infinite if the platform flew off.
    """

    point: OperatingPoint
    mass: float
    predicted: tuple[float, float]
    simulated: tuple[float, float]

    @property
    def agrees(self) -> bool:
        """Whether a nudge dies out at the smaller mass only."""
        return self.simulated[0] < 0.0 < self.simulated[1]

    @property
    def tried_masses(self) -> tuple[float, float]:
        return STABLE_SHARE * self.mass, UNSTABLE_SHARE * self.mass

    JSON_KEYS = (
        "p_B=point.p_B mass tried=tried_masses growth_predicted=predicted growth_simulated=simulated confirmed=agrees"
    )


def tried_mass(shared: Linearisation, points: list[OperatingPoint], most: float) -> PassivityTrial | None:
    """Find and simulate the smallest mass that makes the robot swing in air; None if stable up to `most` (kg)."""
    air = next((point for point in points if not point.in_contact), None)
    if air is None or _growth(shared, air, most) <= 0.0 or _growth(shared, air, 0.0) >= 0.0:
        return None
    low, high = 0.0, most
    for _ in range(MASS_HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if _growth(shared, air, middle) > 0.0 else (middle, high)
    tried = STABLE_SHARE * low, UNSTABLE_SHARE * low
    predicted = _growth(shared, air, tried[0]), _growth(shared, air, tried[1])
    simulated = _simulated_growth(shared.experiment, air, tried[0]), _simulated_growth(shared.experiment, air, tried[1])
    return PassivityTrial(air, low, predicted, simulated)


def _point_with_mass(point: OperatingPoint, mass: float) -> OperatingPoint:
    parameters = point.parameters._replace(m_p=point.parameters.m_p + mass)
    return resting_point(point.name, parameters, point.p_B, point.force_on)


def _growth(shared: Linearisation, point: OperatingPoint, mass: float) -> float:
    """Return the growth rate (1/s) of the linear model with `mass` (kg) on the platform; infinite if it cannot rest."""
    try:
        linear = shared.with_experiment(_experiment_with_mass(shared.experiment, mass)).linear_point(
            _point_with_mass(point, mass)
        )
    except InputRefused:
        return np.inf
    poles = closed_poles(linear.loops, linear.gains)
    return float(np.log(np.abs(poles).max()) / linear.loops.dt)


def _experiment_with_mass(experiment: Experiment, mass: float) -> Experiment:
    """Return the experiment with an added mass (kg) on the platform, known to the controller."""
    heavy = with_plant(experiment, m_p=experiment.plant.m_p + mass)
    return with_model(heavy, m_p=experiment.controller.model.m_p + mass)


def _simulated_growth(experiment: Experiment, point: OperatingPoint, mass: float) -> float:
    """Return the growth rate (1/s) of a nudge in the co-simulation; infinite if the platform flew off."""
    law = "position"
    (path,) = nudged_paths(
        _experiment_with_mass(experiment, mass), _point_with_mass(point, mass), law, 1.0, [NUDGE_SIZE], TRIAL_TIME
    )
    tick = experiment.cosim.tick
    if len(path) <= round(TRIAL_TIME / tick):
        return np.inf
    width, begin = round(SWING_WINDOW / tick), round((NUDGE_TIME + 0.4 * (TRIAL_TIME - NUDGE_TIME)) / tick)
    early, late = _swing(path[begin : begin + width]), _swing(path[-width:])
    return float(np.log(late / early) / ((len(path) - width - begin) * tick))


def _swing(path: Matrix) -> float:
    """Return the rms distance (m) of a path from its straight line, all axes together."""
    t = np.arange(len(path), dtype=float)
    rest = [p - np.polyval(np.polyfit(t, p, 1), t) for p in path.T]
    return float(np.sqrt(np.mean(np.square(rest))))
