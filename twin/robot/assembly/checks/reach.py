"""Reach of poses and references: workspace, hard stops of joints, ball joints, and collisions of links."""

from collections.abc import Callable, Iterable, Iterator
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
    for violated, reason in _violations(plant, np.asarray(p_B)):
        if violated.any():
            pose, column = divmod(int(np.argmax(violated)), violated.shape[1])
            return pose, reason(pose, column)
    return None


def free_poses(plant: Robot, p_B: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Whether each platform pose, (n, 3) in m, is within reach and not obstructed."""
    free = is_reachable(geometry_of(plant), p_B)
    clear = np.ones(np.count_nonzero(free), dtype=np.bool_)
    for violated, _ in _violations(plant, p_B[free]):
        clear &= ~violated.any(axis=1)
    free[free] = clear
    return free


def _violations(
    plant: Robot, places: NDArray[np.float64]
) -> Iterator[tuple[NDArray[np.bool_], Callable[[int, int], str]]]:
    """Yield for each declared limit its violations, (n, columns), and the reason for a pose and column."""
    geometry = geometry_of(plant)
    for stop, key, way in ((plant.joint_lower, "joint_lower_deg", -1.0), (plant.joint_upper, "joint_upper_deg", 1.0)):
        if stop is not None:
            theta_l = joint_angles(geometry, places)
            yield (
                way * (theta_l - stop) > 0.0,
                lambda pose, leg, theta_l=theta_l, key=key, stop=stop: (  # type: ignore[misc]
                    f"at {_format_position(places[pose])} joint {leg + 1} is at "
                    f"{np.degrees(theta_l[pose, leg]):.1f} deg, beyond its hard stop "
                    f"[plant] {key} = {np.degrees(stop):g}; move the point"
                ),
            )
    if (limit := plant.ball_joint_limit) is not None:
        angles = ball_joint_angles(geometry, places)
        yield (
            angles > limit,
            lambda pose, leg: (
                f"at {_format_position(places[pose])} the ball joints of leg {leg + 1} bend by "
                f"{np.degrees(angles[pose, leg]):.1f} deg, their sockets let them by [plant] "
                f"ball_joint_limit_deg = {np.degrees(limit):g}; move the point towards the axis"
            ),
        )
    sizes = plant.link_diameter, plant.rod_diameter, plant.rod_spacing
    if None not in sizes:
        gaps, pairs = clearances(geometry, Bars(*sizes), places)  # type: ignore[arg-type]
        yield gaps[:, None] < 0.0, lambda pose, _: _collision(places[pose], gaps[pose], pairs[pose])


def _collision(p_B: NDArray[np.float64], gap: float, bars: NDArray[np.int64]) -> str:
    one, other = (f"{'a rod' if bar % BARS_PER_LEG else 'the link'} of leg {bar // BARS_PER_LEG + 1}" for bar in bars)
    return (
        f"at {_format_position(p_B)} {one} and {other} are {-1e3 * gap:.1f} mm inside each other "
        "with [plant] link_diameter_mm, rod_diameter_mm and rod_spacing_mm; expected them apart, move the point"
    )


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
