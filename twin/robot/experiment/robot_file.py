"""Adaptation of a shipped experiment to a robot with other lengths: height, space, way points."""

from collections.abc import Mapping
from typing import Any

from twin.robot.experiment.source import Source, value_at

SHIPPED_SURFACE, SHIPPED_RADIUS = -101.0, 40.0
"""z of the surface (mm) and radius of the workspace (mm) for which the shipped experiments are written."""
POSITION_KEYS = tuple(
    f"reference.{key}" for key in ("p_mm", "circle.centre_mm", "chirp.point_mm", "joint_step.point_mm")
)
RADIUS_KEY = "reference.circle.radius_mm"
TASK_KEYS = ("point_mm", "to_mm", "radius_mm")
"""Horizontal positions and lengths of a task."""
HEIGHT_KEYS = ("height_mm", "floor_mm")
"""Keys of [approach] that follow from a robot's lengths."""
MOVED = "; moved to the robot's own surface"
"""End of the source of a moved value."""


def fit_to_robot(own: Source, filled: Source, robot: Source) -> None:
    """Move an experiment from the shipped robot to another robot, in place.

    Heights and limits of the robot's file replace those of the experiment. Way points move with the surface; where the
    robot has less space, their distances from the axis, and from the surface upwards, shrink.

    Args:
        own: values of the experiment's files.
        filled: the same with the values of its body; receives the robot's values.
        robot: values of the robot's file.
    """
    before = value_at(filled.values, "contact.height_mm")
    rise, share = _placement(robot.values)
    surface = SHIPPED_SURFACE + rise
    for table, keys in (("approach", HEIGHT_KEYS), ("monitor", tuple(robot.values.get("monitor", ())))):
        for key in keys:
            if key in robot.values.get(table, {}):
                own.values.get(table, {}).pop(key, None)
                own.origins.pop(f"{table}.{key}", None)
    if "contact" in robot.values:
        own.values["contact"].pop("height_mm", None)
        own.origins.pop("contact.height_mm", None)
        if before != SHIPPED_SURFACE:
            _set(own, "contact.height_mm", round(before + rise, 3))
    if "monitor" in robot.values and "monitor" not in own.values:
        own.values["monitor"] = {"enabled": False}
        own.origins["monitor.enabled"] = "as in the experiment that this one started from"
    for name, table in robot.values.items():
        if isinstance(filled.values.get(name, {}), dict):
            filled.values[name] = {**filled.values.get(name, {}), **table}
    if (rise, share) == (0.0, 1.0):
        return

    def moved(p: Any) -> Any:
        if isinstance(p[0], tuple):
            return tuple(map(moved, p))
        above = p[2] - SHIPPED_SURFACE
        up = share * above if above > 0.0 else above
        return tuple(round(value, 3) for value in (share * p[0], share * p[1], surface + up))

    for key in POSITION_KEYS:
        if (value := value_at(own.values, key)) is not None:
            _set(own, key, moved(value))
    if (value := value_at(own.values, RADIUS_KEY)) is not None:
        _set(own, RADIUS_KEY, round(share * value, 3))
    for number, task in enumerate(own.values.get("task", ()), start=1):
        for key in TASK_KEYS:
            if key in task and share < 1.0:
                value = task[key]
                task[key] = tuple(share * v for v in value) if isinstance(value, tuple) else share * value
                own.origins[f"task.{number}.{key}"] = own.origins.get(f"task.{number}.{key}", "") + MOVED


def _placement(robot: Mapping[str, Any]) -> tuple[float, float]:
    """Return (rise of the surface above the shipped one (mm), share of the shipped workspace) of a robot's file."""
    height = value_at(robot, "contact.height_mm")
    radius = value_at(robot, "monitor.workspace_radius_mm")
    rise = 0.0 if height is None else height - SHIPPED_SURFACE
    return rise, 1.0 if radius is None else min(1.0, radius / SHIPPED_RADIUS)


def _set(source: Source, key: str, value: Any) -> None:
    """Set a dotted key, and append to its source that it was moved."""
    *tables, last = key.split(".")
    table = source.values
    for name in tables:
        table = table[name]
    table[last] = value
    source.origins[key] = source.origins.get(key, "as shipped") + MOVED
