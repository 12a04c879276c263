"""Whether the robot gets wherever the reference leads it."""

from collections.abc import Iterable
from functools import lru_cache

import numpy as np

from twin.errors import Unreachable
from twin.experiment.reference import WayPoints
from twin.plant.parameters import TrueRobot
from twin.robot.geometry import Geometry
from twin.robot.inverse_kinematics import joint_angles
from twin.runs.assembly.checks.clearance import obstructed
from twin.settings import Triple

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


def reference_mistakes(
    reference: WayPoints, geometries: Iterable[Geometry], plant: TrueRobot | None = None
) -> list[str]:
    """The first place at which the way points, or the lines between them, leave the reach of one of `geometries`, or at
    which `plant` bends too far or meets itself."""
    return list(_mistakes(reference, tuple(geometries), plant))


# the runs of a sweep have one way, mostly, and so have the studies of an experiment
@lru_cache(64)
def _mistakes(reference: WayPoints, geometries: tuple[Geometry, ...], plant: TrueRobot | None) -> list[str]:
    if len(reference.t) != len(reference.p):
        return [f"[reference] {len(reference.t)} times and {len(reference.p)} points: expected as many of each"]
    for geometry in geometries:
        if unreachable(geometry, np.array(reference.p)) is None:
            continue
        for number, point in enumerate(reference.p, start=1):
            if problem := unreachable(geometry, np.array(point)):
                if reference.shape:
                    return [f"[reference.{reference.shape}] at {reference.t[number - 1]:g} s: {problem}"]
                return [f"[reference] way point {number}: {problem}"]
    # only now: between points beyond reach a line has any number of points
    places, ends = _lines(reference.p)
    for geometry in geometries:
        if unreachable(geometry, places) is None:
            continue
        for number, line in enumerate(np.split(places, ends[:-1]), start=1):
            if problem := unreachable(geometry, line):
                return [f"[reference] between way points {number} and {number + 1}: {problem}"]
    if plant is not None and (found := obstructed(plant, places)):
        number = int(np.searchsorted(ends, found[0], side="right")) + 1
        if reference.shape:
            return [f"[reference.{reference.shape}] from {reference.t[number - 1]:g} s on: {found[1]}"]
        return [f"[reference] from way point {number} on: {found[1]}"]
    return []


def _lines(points: tuple[Triple, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Each way point, with points on the line towards the next: all of them (n, 3), and of each line where it ends."""
    starts = np.array(points)
    ways = np.diff(starts, axis=0, append=starts[-1:])
    counts = 1 + (np.linalg.norm(ways, axis=1) / WAY_POINT_SPACING).astype(int)
    ends = np.cumsum(counts)
    number = np.repeat(np.arange(len(counts)), counts)
    within = np.arange(len(number)) - (ends - counts)[number]
    return starts[number] + (within / counts[number])[:, None] * ways[number], ends
