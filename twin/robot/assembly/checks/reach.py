"""Reach of poses and references: workspace, hard stops of joints, ball joints, and collisions of links."""

from collections.abc import Iterable
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from twin.kernel.settings import Triple
from twin.robot.experiment.schema import WayPoints
from twin.robot.mechanism.geometry import Geometry, geometry_of
from twin.robot.mechanism.kinematics import joint_angles
from twin.robot.mechanism.unreachable import Unreachable
from twin.robot.mechanism.workspace import BARS_PER_LEG, Bars, ball_joint_angles, clearances, is_reachable
from twin.robot.plant.dynamics import Robot

WAY_POINT_SPACING = 1e-3
"""Spacing (m) of the points checked on straight lines."""


def find_obstruction(plant: Robot, p_B: NDArray[np.float64]) -> tuple[int, str] | None:
    """Return (index, reason) of the first platform pose that is obstructed; None if all poses are free.

    The poses `p_B`, (n, 3) in m, must be within kinematic reach. Limits that the robot's file does not declare are not
    checked.
    """
    geometry, places = geometry_of(plant), np.asarray(p_B)
    if (met := _find_stop_obstruction(plant, geometry, places)) is not None:
        return met
    if plant.ball_joint_limit is not None:
        angles = ball_joint_angles(geometry, places)
        if angles.max() > plant.ball_joint_limit:
            pose, leg = divmod(int(np.argmax(angles > plant.ball_joint_limit)), 3)
            return pose, (
                f"at {_format_position(places[pose])} the ball joints of leg {leg + 1} bend by "
                f"{np.degrees(angles[pose, leg]):.1f} deg, their sockets let them by [plant] "
                f"ball_joint_limit_deg = {np.degrees(plant.ball_joint_limit):g}; move the point towards the axis"
            )
    sizes = plant.link_diameter, plant.rod_diameter, plant.rod_spacing
    if None not in sizes:
        gaps, pairs = clearances(geometry, Bars(*sizes), places)  # type: ignore[arg-type]
        if gaps.min() < 0.0:
            pose = int(np.argmax(gaps < 0.0))
            one, other = (
                f"{'a rod' if bar % BARS_PER_LEG else 'the link'} of leg {bar // BARS_PER_LEG + 1}"
                for bar in pairs[pose]
            )
            inside = -1e3 * gaps[pose]
            return pose, (
                f"at {_format_position(places[pose])} {one} and {other} are {inside:.1f} mm inside each other "
                "with [plant] link_diameter_mm, rod_diameter_mm and rod_spacing_mm; expected them apart, move the point"
            )
    return None


def free_poses(plant: Robot, p_B: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Whether each platform pose, (n, 3) in m, is within reach and unobstructed, see `find_obstruction`."""
    geometry = geometry_of(plant)
    free = is_reachable(geometry, p_B)
    places = p_B[free]
    theta_l = joint_angles(geometry, places)
    lower, upper = plant.joint_lower, plant.joint_upper
    clear = np.ones(len(places), dtype=np.bool_)
    clear &= (theta_l >= (-np.inf if lower is None else lower)).all(axis=1)
    clear &= (theta_l <= (np.inf if upper is None else upper)).all(axis=1)
    if plant.ball_joint_limit is not None:
        clear &= (ball_joint_angles(geometry, places) <= plant.ball_joint_limit).all(axis=1)
    sizes = plant.link_diameter, plant.rod_diameter, plant.rod_spacing
    if None not in sizes:
        clear &= clearances(geometry, Bars(*sizes), places)[0] >= 0.0  # type: ignore[arg-type]
    free[free] = clear
    return free


def _find_stop_obstruction(plant: Robot, geometry: Geometry, places: NDArray[np.float64]) -> tuple[int, str] | None:
    """Return (index, reason) of the first pose beyond a joint's hard stop; None if all are within."""
    if plant.joint_lower is None and plant.joint_upper is None:
        return None
    theta_l = joint_angles(geometry, places)
    for stop, key, way in ((plant.joint_lower, "joint_lower_deg", -1.0), (plant.joint_upper, "joint_upper_deg", 1.0)):
        if stop is not None and (beyond := way * (theta_l - stop)).max() > 0.0:
            pose, leg = divmod(int(np.argmax(beyond > 0.0)), 3)
            angle = np.degrees(theta_l[pose, leg])
            return pose, (
                f"at {_format_position(places[pose])} joint {leg + 1} is at {angle:.1f} deg, beyond "
                f"its hard stop [plant] {key} = {np.degrees(stop):g}; move the point"
            )
    return None


def _format_position(p_B: NDArray[np.float64]) -> str:
    return "({}) mm".format(", ".join(f"{1e3 * value:.1f}" for value in p_B))


def reach_error(geometry: Geometry, p_B: np.ndarray) -> Unreachable | None:
    """Return the error for one unreachable platform pose among several; None if all are reachable."""
    try:
        joint_angles(geometry, p_B)
    except Unreachable as problem:
        # the message for a single pose does not contain an index
        return problem if p_B.ndim == 1 else reach_error(geometry, np.array(problem.pose))
    return None


def reference_errors(reference: WayPoints, geometries: Iterable[Geometry], plant: Robot | None = None) -> list[str]:
    """Return an error message for the first pose of a reference that is out of reach or obstructed.

    Checked are the waypoints and the lines between them.
    """
    return list(_pose_errors(reference, tuple(geometries), plant))


# the runs of a sweep, and the studies of an experiment, mostly share one reference
@lru_cache(64)
def _pose_errors(reference: WayPoints, geometries: tuple[Geometry, ...], plant: Robot | None) -> list[str]:
    if len(reference.t) != len(reference.p):
        return [f"[reference] {len(reference.t)} times and {len(reference.p)} points: expected as many of each"]
    for geometry in geometries:
        if reach_error(geometry, np.array(reference.p)) is None:
            continue
        for number, point in enumerate(reference.p, start=1):
            if problem := reach_error(geometry, np.array(point)):
                if reference.shape:
                    return [f"[reference.{reference.shape}] at {reference.t[number - 1]:g} s: {problem}"]
                return [f"[reference] way point {number}: {problem}"]
    # only for reachable waypoints: a line between absurd ones would need any number of points
    places, ends = _line_points(reference.p)
    for geometry in geometries:
        if reach_error(geometry, places) is None:
            continue
        for number, line in enumerate(np.split(places, ends[:-1]), start=1):
            if problem := reach_error(geometry, line):
                return [f"[reference] between way points {number} and {number + 1}: {problem}"]
    if plant is not None and (found := find_obstruction(plant, places)):
        number = int(np.searchsorted(ends, found[0], side="right")) + 1
        if reference.shape:
            return [f"[reference.{reference.shape}] from {reference.t[number - 1]:g} s on: {found[1]}"]
        return [f"[reference] from way point {number} on: {found[1]}"]
    return []


def _line_points(points: tuple[Triple, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Sample the straight lines between waypoints; return the points (n, 3) and the end index of each line."""
    starts = np.array(points)
    ways = np.diff(starts, axis=0, append=starts[-1:])
    counts = 1 + (np.linalg.norm(ways, axis=1) / WAY_POINT_SPACING).astype(int)
    ends = np.cumsum(counts)
    number = np.repeat(np.arange(len(counts)), counts)
    within = np.arange(len(number)) - (ends - counts)[number]
    return starts[number] + (within / counts[number])[:, None] * ways[number], ends
