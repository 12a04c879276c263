"""Adaptation of a shipped experiment to a robot that works at another height."""

import math
from typing import Any

from twin.robot.experiment.source import Source, value_at

SHIPPED_SURFACE = -101.0
"""z (mm) of the surface for which the shipped experiments are written."""
POSITIONS = {"reference": ("p_mm",), "circle": ("centre_mm",), "chirp": ("point_mm",), "joint_step": ("point_mm",)}
"""Tables of [reference] and their positions."""
HEIGHT_KEYS = ("height_mm", "floor_mm")
"""Keys of [approach] that follow from a robot's lengths."""
MOVED = "; moved to the robot's surface"
"""End of the source of a moved value."""


def fit_to_robot(own: Source, filled: Source, robot: Source) -> None:
    """Move an experiment from the shipped robot to another robot, in place: way points move with the surface.

    Args:
        own: values of the experiment's files; keys that the robot's file decides are removed.
        filled: the same with the values of its body; receives the robot's values.
    """
    before, surface = value_at(filled.values, "contact.height_mm"), value_at(robot.values, "contact.height_mm")
    decided = {"contact": ("height_mm",), "approach": HEIGHT_KEYS, "monitor": tuple(robot.values.get("monitor", ()))}
    for table, keys in decided.items():
        for key in keys:
            if key in robot.values.get(table, {}):
                own.values.get(table, {}).pop(key, None)
                own.origins.pop(f"{table}.{key}", None)
    if "monitor" in robot.values and "monitor" not in own.values:
        own.merge({"monitor": {"enabled": False}}, "as in the experiment that this one started from")
    for name, table in robot.values.items():
        filled.values[name] = {**filled.values.get(name, {}), **table}
    if not isinstance(surface, int | float) or not math.isfinite(surface) or surface == SHIPPED_SURFACE:
        # an invalid height is reported when the experiment is checked
        return

    def shift_point(p: Any) -> Any:
        if isinstance(p[0], tuple):
            return tuple(map(shift_point, p))
        return (*p[:2], round(p[2] + surface - SHIPPED_SURFACE, 3))

    reference = own.values.get("reference", {})
    for table, keys in POSITIONS.items():
        for key in keys:
            values, path = (reference, "") if table == "reference" else (reference.get(table, {}), f"{table}.")
            if key in values:
                values[key] = shift_point(values[key])
                own.origins[f"reference.{path}{key}"] += MOVED
    if before != SHIPPED_SURFACE:
        # a body out of reach stays out of reach
        height = round(before + surface - SHIPPED_SURFACE, 3)
        own.merge({"contact": {"height_mm": height}}, f"of the experiment that this one started from{MOVED}")
