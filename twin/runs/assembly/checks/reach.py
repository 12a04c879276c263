"""Whether the robot gets wherever the reference leads it."""

from collections.abc import Iterable

import numpy as np

from twin.errors import Unreachable
from twin.experiment.reference import WayPoints
from twin.experiment.robot import Plant, Triple
from twin.robot.geometry import Geometry
from twin.robot.inverse_kinematics import joint_angles
from twin.runs.assembly.checks.clearance import obstructed

WAY_POINT_SPACING = 1e-3
"""How densely (m) straight lines are checked for reach."""


def unreachable(geometry: Geometry, p_B: np.ndarray) -> Unreachable | None:
    """Why the robot cannot be at one of `p_B` (..., 3) in m, told of that pose alone; None if it can."""
    try:
        joint_angles(geometry, p_B)
    except Unreachable as problem:
        # of many poses the sentence would name the index; of the pose alone it does not
        return problem if p_B.ndim == 1 else unreachable(geometry, np.array(problem.pose))
    return None


def reference_mistakes(reference: WayPoints, geometries: Iterable[Geometry], plant: Plant | None = None) -> list[str]:
    """The first place at which the way points, or the lines between them, leave the reach of one of `geometries`, or at
    which `plant` bends too far or meets itself."""
    if len(reference.t) != len(reference.p):
        return [f"[reference] {len(reference.t)} times and {len(reference.p)} points: expected as many of each"]
    geometries = tuple(geometries)
    for geometry in geometries:
        if unreachable(geometry, np.array(reference.p)) is None:
            continue
        for number, point in enumerate(reference.p, start=1):
            if problem := unreachable(geometry, np.array(point)):
                if reference.shape:
                    return [f"[reference.{reference.shape}] at {reference.t[number - 1]:g} s: {problem}"]
                return [f"[reference] way point {number}: {problem}"]
    # only now: between points beyond reach a line has any number of points
    lines = _lines(reference.p)
    for geometry in geometries:
        if unreachable(geometry, np.concatenate(lines)) is None:
            continue
        for number, line in enumerate(lines, start=1):
            if problem := unreachable(geometry, line):
                return [f"[reference] between way points {number} and {number + 1}: {problem}"]
    if plant is not None and (found := obstructed(plant, np.concatenate(lines))):
        number = int(np.searchsorted(np.cumsum([len(line) for line in lines]), found[0], side="right")) + 1
        if reference.shape:
            return [f"[reference.{reference.shape}] from {reference.t[number - 1]:g} s on: {found[1]}"]
        return [f"[reference] from way point {number} on: {found[1]}"]
    return []


def _lines(points: tuple[Triple, ...]) -> list[np.ndarray]:
    """Each way point, with points on the line towards the next."""
    lines = []
    for start, end in zip(points, (*points[1:], points[-1]), strict=True):
        a, b = np.array(start), np.array(end)
        count = 1 + int(np.linalg.norm(b - a) / WAY_POINT_SPACING)
        lines.append(a + np.linspace(0.0, 1.0, count, endpoint=False)[:, None] * (b - a))
    return lines
