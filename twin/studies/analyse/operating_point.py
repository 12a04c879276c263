"""Operating points of an experiment's loops: the robot at rest, in free air and pressing."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq

from twin.kernel.errors import InputRefused
from twin.robot.assembly.build import plant_parameters
from twin.robot.controller.program import Push, Tap
from twin.robot.experiment.experiment import Experiment
from twin.robot.mechanism.geometry import Geometry
from twin.robot.mechanism.kinematics import joint_angles
from twin.robot.mechanism.unreachable import Unreachable
from twin.robot.plant.component import rest_state
from twin.robot.plant.contact import contact_force, surface_depth
from twin.robot.plant.dynamics import PlantParameters

AIR_CLEARANCE = 1e-3
"""Height (m) above the surface of the free-air point over each pressed place."""
MAX_DEPTH = 0.1
"""Maximum depth (m) that a surface is pressed in."""
MIN_DEFLECTION = 2e-5
"""Minimum deflection (rad) of a spring with backlash: ten times the differentiation step of the plant."""


@dataclass(frozen=True)
class OperatingPoint:
    """A state of the robot at rest, about which the loops are linearised, with the platform at `p_B` (m).

    Attributes:
        F_z: pressing force (N); 0 in free air.
        x, theta_m: state (8,) and motor angles (3,) at rest: friction sticks, with its bristle straight.
    """

    name: str
    p_B: tuple[float, float, float]
    F_z: float
    force_on: bool
    parameters: PlantParameters
    x: np.ndarray
    theta_m: np.ndarray

    @property
    def in_contact(self) -> bool:
        return self.F_z > 0.0


def operating_points(experiment: Experiment) -> tuple[list[OperatingPoint], list[str]]:
    """Return the operating points of an experiment for linear analysis, and messages about points without one.

    The points are the start and each pressed place, touching and 1 mm above. A moving surface is taken at its initial
    position.
    """
    parameters = plant_parameters(experiment.plant, experiment.contact)
    points: list[OperatingPoint] = []
    problems: list[str] = []

    def look_at(make: Callable[[], OperatingPoint]) -> None:
        try:
            points.append(make())
        except InputRefused as refusal:
            problems.append(str(refusal))

    look_at(lambda: resting_point("start", parameters, experiment.start))
    for place in _press_places(experiment, parameters):
        above = (place.x, place.y, surface_height(parameters, place.x, place.y) + AIR_CLEARANCE)
        if not any(np.allclose(point.p_B, above) for point in points):
            look_at(lambda above=above: resting_point("above", parameters, above))  # type: ignore[misc]
        look_at(lambda place=place: _pressing(parameters, place))  # type: ignore[misc]
    if not points:
        raise InputRefused(problems[0])
    return points, list(dict.fromkeys(problems))


def resting_point(
    name: str, parameters: PlantParameters, p_B: tuple[float, float, float], force_on: bool = False
) -> OperatingPoint:
    """Compute the operating point of the robot at rest at `p_B` (m)."""
    where = "({:g}, {:g}, {:g}) mm".format(*(round(1e3 * value, 3) for value in p_B))
    try:
        x, theta_m = rest_state(parameters, p_B)
    except Unreachable as refusal:
        raise InputRefused(f"no operating point at {where}: {refusal}") from None
    theta_l = joint_angles(Geometry(parameters.a, parameters.b, parameters.l_a, parameters.l_b), p_B)
    backlash = parameters.backlash + np.array(parameters.backlash_added)
    loaded = np.abs(theta_m - parameters.N * theta_l - np.array(parameters.slip)) - backlash
    slack = np.flatnonzero((loaded < MIN_DEFLECTION) & (backlash > 0.0))
    if len(slack):
        raise InputRefused(
            f"no linear model at {where}: the spring of leg {slack[0] + 1} carries nothing there and hangs free in its "
            "backlash. Choose a point or a force a little different, or --set plant.backlash_deg=0"
        )
    return OperatingPoint(name, p_B, -_force(parameters, p_B), force_on, parameters, x, theta_m)


def surface_height(parameters: PlantParameters, x: float, y: float) -> float:
    """Return the height (m) of the contact surface at (x, y)."""

    def depth(z: float) -> float:
        return float(surface_depth(parameters, x, y, z))

    return float(brentq(depth, parameters.z_s - MAX_DEPTH, parameters.z_s + MAX_DEPTH, xtol=1e-12))


def pressing_height(parameters: PlantParameters, x: float, y: float, F_z: float) -> float:
    """Return the platform's height (m) at which the surface answers with the vertical force `F_z` (N)."""
    top = surface_height(parameters, x, y)
    lack = F_z + _force(parameters, (x, y, top - MAX_DEPTH))
    if not lack < 0.0:
        raise InputRefused(
            f"no operating point at ({1e3 * x:g}, {1e3 * y:g}) mm: the surface does not reach {F_z:g} N within "
            f"{1e3 * MAX_DEPTH:g} mm of depth; press less, or raise [contact] stiffness_N_per_m"
        )
    return float(brentq(lambda z: F_z + _force(parameters, (x, y, z)), top - MAX_DEPTH, top, xtol=1e-12))


def point_on_stiffness(point: OperatingPoint, K: float) -> OperatingPoint:
    """Return the point on a surface of stiffness `K` (N/m), at equal pose and force; refuse depths > `MAX_DEPTH`."""
    parameters, (x, y, z) = point.parameters._replace(K=K), point.p_B

    def excess(up: float) -> float:
        return -_force(parameters._replace(z_s=parameters.z_s + up), (x, y, z)) - point.F_z

    gap = z - surface_height(parameters, x, y)
    if not excess(gap + MAX_DEPTH) > 0.0:
        raise InputRefused(f"a surface of {K:g} N/m does not reach {point.F_z:g} N within {1e3 * MAX_DEPTH:g} mm")
    moved = parameters._replace(z_s=parameters.z_s + brentq(excess, gap, gap + MAX_DEPTH, xtol=1e-12))
    return resting_point(point.name, moved, point.p_B, point.force_on)


def _force(parameters: PlantParameters, p: tuple[float, float, float]) -> float:
    """Return the vertical contact force F_ee_B_z (N) of the platform at rest at `p` (m)."""
    return float(contact_force(parameters, *p, 0.0, 0.0, 0.0, 0.0, 0.0)[2])


class PressPlace(NamedTuple):
    """A place where the experiment presses: with the force F_z (N) or, if that is None, at the height z (m)."""

    x: float
    y: float
    z: float
    F_z: float | None
    force_on: bool


def _pressing(parameters: PlantParameters, place: PressPlace) -> OperatingPoint:
    z = place.z if place.F_z is None else pressing_height(parameters, place.x, place.y, place.F_z)
    return resting_point("pressing", parameters, (place.x, place.y, z), place.force_on)


def _press_places(experiment: Experiment, parameters: PlantParameters) -> list[PressPlace]:
    """List the distinct places where the experiment presses; in a tap the force loop is off."""
    found: list[PressPlace] = []
    for task in experiment.tasks:
        corners = [task.point, task.to] if isinstance(task, Push) else [task.point]
        found += [PressPlace(x, y, 0.0, task.force, not isinstance(task, Tap)) for x, y in corners]
    if experiment.reference is not None:
        force_on = experiment.controller.mode == "force_position"
        F_ref = experiment.controller.force.reference if force_on else None
        for x, y, z in experiment.reference.p:
            if _force(parameters, (x, y, z)) < 0.0:
                found.append(PressPlace(x, y, 0.0 if force_on else z, F_ref, force_on))
    return list(dict.fromkeys(found))


def undisturbed_experiment(experiment: Experiment, **contact: float) -> Experiment:
    """Return the experiment on a still surface, without faults, scheduled changes, monitor and scale."""
    still = experiment.contact.model_copy(update={"breathing": None, "shift": None, **contact})
    return replace(experiment, contact=still, faults=(), changes=(), monitor=None, scale=None)
