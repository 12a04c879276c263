"""Feasibility of tasks: space, speed and force."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from twin.robot.assembly.checks.reach import find_obstruction, reach_error
from twin.robot.controller.program import Approach, Push, Roll, Tap, Task
from twin.robot.controller.task_controller import Computer
from twin.robot.mechanism.geometry import Geometry
from twin.robot.mechanism.kinematics import jacobian
from twin.robot.monitor.limits import Monitor
from twin.robot.plant.contact import Shape, surface_depth, surface_frame
from twin.robot.plant.contact_law import elastic_force
from twin.robot.plant.dynamics import PlantParameters, TrueRobot

PATH_SPACING = 1e-3
"""Spacing (m) of the points checked on paths."""
MAX_DENSE_LENGTH = 1.0
"""Length (m) of a path above which it is checked less densely: it exceeds every robot's reach anyway."""
MAX_BODY_DEPTH = 0.1
"""Maximum indentation (m) of any body."""


@dataclass(frozen=True)
class TaskContext:
    """Robot, surface and settings that determine whether a massage task is feasible.

    Attributes:
        plant: true robot and surface.
        robot: table [plant].
        geometries: true geometry, and the controller's.
        monitor: its table; None if it is disabled.
    """

    plant: PlantParameters
    robot: TrueRobot
    geometries: tuple[Geometry, ...]
    approach: Approach
    controller: Computer
    monitor: Monitor | None


def task_errors(situation: TaskContext, tasks: Mapping[int, Task], duration: float) -> list[str]:
    """Return error messages for massage tasks that are infeasible, unsafe or too long.

    The tasks are given by number, the `duration` of the experiment in s.
    """
    mistakes = [f"[task {n}] {text}" for n, task in tasks.items() for text in _single_task_errors(situation, task)]
    seconds = sum(_task_time(situation.approach, task, situation.plant.z_s) for task in tasks.values())
    ways = ((getattr(before, "to", before.point), task.point) for before, task in pairwise(tasks.values()))
    seconds += sum(math.dist(*way) / situation.approach.speed for way in ways)
    if not mistakes and seconds > duration:
        mistakes.append(f"duration_s = {duration:g}: the tasks take about {seconds:.1f} s")
    return mistakes


def _task_time(approach: Approach, task: Task, surface: float) -> float:
    """Estimate the duration of a massage task (s): down, work, up."""
    way = approach.height - surface
    work = task.times * task.period + task.lift / approach.speed if isinstance(task, Tap) else _contact_time(task)
    return way / approach.descent + work + approach.release + way / approach.speed + 3.0 * approach.ramp


def _single_task_errors(s: TaskContext, task: Task) -> Iterator[str]:
    path = _task_path(task)
    surface = np.array([_surface_height(s.plant, *point) for point in path])
    if not np.isfinite(surface).all():
        x, y = path[~np.isfinite(surface)][0]
        yield f"there is nothing to press on under ({1e3 * x:.1f}, {1e3 * y:.1f}) mm: this body ends before"
        return
    yield from _approach_errors(s, task, path, surface)
    if s.controller.touch is not None and task.force <= s.controller.touch.contact:
        yield (
            f"force_N = {task.force:g} is not above [controller.touch] contact_N = {s.controller.touch.contact:g}, "
            "the threshold of contact"
        )
    if problem := _reach_error(s, path):
        yield problem
        return
    depth = _pressing_depth(s.plant, task.force)
    # a third-party controller has its own limits
    limit = s.controller.force.limit if s.controller.force is not None else MAX_BODY_DEPTH
    if depth is None or depth > limit:
        yield (
            f"force_N = {task.force:g} cannot be built up: this body needs "
            + (f"{1e3 * depth:.1f} mm" if depth else f"more than {1e3 * MAX_BODY_DEPTH:g} mm")
            + f" of depth for it, [controller.force] limit_mm = {1e3 * limit:g}"
        )
        return
    if surface.min() - depth < s.approach.floor:
        yield (
            f"presses down to z = {1e3 * (surface.min() - depth):.1f} mm on this body; "
            f"[approach] floor_mm = {1e3 * s.approach.floor:g} does not let it"
        )
    yield from _motor_speed_errors(s, task, path, surface)
    if s.monitor is not None:
        yield from _monitor_errors(s.monitor, s.approach, task, path, surface.min() - depth, depth)


def _task_path(task: Task) -> NDArray[np.float64]:
    """Return the horizontal path of a massage task, (n, 2) in m."""
    point = np.array(task.point)
    if isinstance(task, Roll):
        angle = np.linspace(0.0, 2.0 * np.pi, 49)
        return point + task.radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    if isinstance(task, Push):
        way = np.array(task.to) - point
        # a line longer than any robot is refused with fewer points, too
        count = 2 + int(min(float(np.linalg.norm(way)), MAX_DENSE_LENGTH) / PATH_SPACING)
        return point + np.linspace(0.0, 1.0, count)[:, None] * way
    return point[None, :]


def _surface_height(plant: PlantParameters, x: float, y: float) -> float:
    """Return the height z of the surface (m) at (x, y); -inf beyond the edge of a curved surface."""

    def depth(z: float) -> float:
        return float(surface_depth(plant, x, y, z))

    # searched from the axis upwards, as a thin limb also has an underside
    low = plant.z_s - (MAX_BODY_DEPTH if plant.shape == Shape.PLANE else plant.radius)
    high = plant.z_s + MAX_BODY_DEPTH
    below, above = depth(low), depth(high)
    if below * above >= 0.0:
        return -math.inf
    if plant.shape == Shape.PLANE:
        # the depth is linear in z
        return low + (high - low) * below / (below - above)
    # imported here: loading it takes a third of a process's start-up time, and few bodies are curved
    from scipy.optimize import brentq

    return float(brentq(depth, low, high))


def _pressing_depth(plant: PlantParameters, force: float) -> float | None:
    """Return the indentation (m) at which the body reacts with `force` (N); None if it cannot."""
    if plant.K == 0.0 or elastic_force(plant, MAX_BODY_DEPTH) < force:
        return None
    from scipy.optimize import brentq

    return float(brentq(lambda d: elastic_force(plant, d) - force, 0.0, MAX_BODY_DEPTH))


def _approach_errors(
    s: TaskContext, task: Task, path: NDArray[np.float64], surface: NDArray[np.float64]
) -> Iterator[str]:
    if surface.max() >= s.approach.height:
        yield (
            f"the surface is at z = {1e3 * surface.max():.1f} mm, [approach] height_mm = {1e3 * s.approach.height:g} "
            "is not above it"
        )
    if isinstance(task, Tap) and task.lift > s.approach.height - surface.min():
        yield (
            f"lift_mm = {1e3 * task.lift:g} goes above [approach] height_mm = {1e3 * s.approach.height:g}, "
            f"{1e3 * (s.approach.height - surface.min()):.1f} mm over the surface"
        )
    if isinstance(task, Tap) and (seconds := 2.0 * task.lift / task.speed + s.approach.ramp) > task.period:
        yield f"period_s = {task.period:g}: lift_mm = {1e3 * task.lift:g} down and up again takes {seconds:.2f} s"
    for (x, y), z in zip(path, surface, strict=True):
        # tangent of the angle between surface normal and vertical
        n = surface_frame(s.plant, x, y, z)[3]
        slope = math.hypot(n[0], n[1]) / n[2] if n[2] > 0.0 else math.inf
        if slope > s.plant.mu:
            yield (
                f"friction cannot hold at ({1e3 * x:.1f}, {1e3 * y:.1f}, {1e3 * z:.1f}) mm: the surface slopes "
                f"{math.degrees(math.atan(slope)):.1f} deg, friction {s.plant.mu:g} holds up to "
                f"{math.degrees(math.atan(s.plant.mu)):.1f} deg"
            )
            return


def _reach_error(s: TaskContext, path: NDArray[np.float64]) -> str | None:
    """Return an error message for the first unreachable or obstructed point of a task's path; None if it is free.

    Each point is checked from the travelling height down to the lowest height.
    """
    height, floor = s.approach.height, s.approach.floor
    heights = (
        np.arange(floor, height + PATH_SPACING, PATH_SPACING)
        if height - floor < MAX_DENSE_LENGTH
        else np.array([floor, height])
    )
    columns = np.array([[x, y, z] for x, y in path for z in heights])
    problems = (reach_error(geometry, columns) for geometry in s.geometries)
    if mistake := next((str(problem) for problem in problems if problem), None):
        return mistake
    found = find_obstruction(s.robot, columns)
    return found[1] if found else None


def _motor_speed_errors(
    s: TaskContext, task: Task, path: NDArray[np.float64], surface: NDArray[np.float64]
) -> Iterator[str]:
    points, velocities, heights = map(np.array, zip(*_velocities(s, task, path, surface), strict=True))
    J = jacobian(s.geometries[0], np.column_stack([points, heights]))
    omega = np.abs(s.plant.N * np.einsum("nij,nj->ni", J, velocities))
    for n in np.flatnonzero(omega.max(axis=1) > s.controller.speed_limit)[:1]:
        x, y = points[n]
        yield (
            f"joint {omega[n].argmax() + 1} would have to turn at {omega[n].max():.1f} rad/s (motor) at "
            f"({1e3 * x:.1f}, {1e3 * y:.1f}, {1e3 * heights[n]:.1f}) mm; [controller] speed_limit_rad_per_s = "
            f"{s.controller.speed_limit:g}"
        )


def _velocities(
    s: TaskContext, task: Task, path: NDArray[np.float64], surface: NDArray[np.float64]
) -> Iterator[tuple[NDArray[np.float64], NDArray[np.float64], float]]:
    """Yield the motions of a massage task as (x and y, velocity, z), SI."""
    for point, z in zip(path, surface, strict=True):
        if isinstance(task, Roll):
            omega = 2.0 * np.pi * task.rate
            radius = point - np.array(task.point)
            yield point, np.array([-omega * radius[1], omega * radius[0], 0.0]), z
        if isinstance(task, Push):
            way = np.array(task.to) - np.array(task.point)
            yield point, np.array([*(task.speed * way / np.linalg.norm(way)), 0.0]), z
        fastest = max(s.approach.speed, _working_speed(task) if isinstance(task, Tap) else 0.0)
        for height in (s.approach.height, z):
            yield point, np.array([0.0, 0.0, fastest]), height


def _monitor_errors(
    monitor: Monitor, approach: Approach, task: Task, path: NDArray[np.float64], lowest: float, depth: float
) -> Iterator[str]:
    radii, fastest, seconds = np.hypot(*path.T), _working_speed(task), _contact_time(task)
    x, y = path[radii.argmax()]
    limits = (
        (task.force >= monitor.force_limit, f"force_N = {task.force:g}:", f"force_limit_N = {monitor.force_limit:g}"),
        (radii.max() >= monitor.workspace_radius,
         f"({1e3 * x:.1f}, {1e3 * y:.1f}) mm is {1e3 * radii.max():.1f} mm from the axis;",
         f"workspace_radius_mm = {1e3 * monitor.workspace_radius:g}"),
        (lowest <= monitor.z_min,
         f"presses down to z = {1e3 * lowest:.1f} mm;", f"z_min_mm = {1e3 * monitor.z_min:g}"),
        (approach.height >= monitor.z_max,
         f"[approach] height_mm = {1e3 * approach.height:g}:", f"z_max_mm = {1e3 * monitor.z_max:g}"),
        (depth >= monitor.penetration_limit,
         f"force_N = {task.force:g} needs {1e3 * depth:.1f} mm of depth on this body;",
         f"penetration_limit_mm = {1e3 * monitor.penetration_limit:g}"),
        (fastest >= monitor.speed_limit,
         f"moves at {1e3 * fastest:.0f} mm/s;", f"speed_limit_mm_per_s = {1e3 * monitor.speed_limit:g}"),
        (seconds >= monitor.contact_time_limit, f"presses for {seconds:.1f} s without a pause;",
         f"contact_time_limit_s = {monitor.contact_time_limit:g}"),
    )  # fmt: skip
    yield from (f"{motion} [monitor] {limit} would trip" for trips, motion, limit in limits if trips)


def _working_speed(task: Task) -> float:
    """Return the programmed speed of a massage task in contact or towards it (m/s); 0 for a press."""
    if isinstance(task, Roll):
        return 2.0 * math.pi * task.rate * task.radius
    return task.speed if isinstance(task, Tap | Push) else 0.0


def _contact_time(task: Task) -> float:
    """Return the duration of uninterrupted contact in a task (s), without release and gentle descent."""
    if isinstance(task, Tap):
        return 0.0
    if isinstance(task, Roll):
        return task.build_up + (task.turns + 2.0) / task.rate
    if isinstance(task, Push):
        return task.build_up + math.dist(task.to, task.point) / task.speed
    return task.build_up + task.hold
