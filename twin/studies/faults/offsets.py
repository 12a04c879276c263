"""Sideways offsets of all tasks of an experiment."""

import math
from collections.abc import Sequence
from typing import Any

from twin.kernel.errors import InputRefused
from twin.robot.experiment.experiment import Experiment

NO_OFFSET = (0.0, 0.0)
"""Offset of the experiment's own tasks (m)."""


def on_disc(reach: float, outward: float, around: float) -> tuple[float, float]:
    """Map two shares to a point of a disc about the axis, uniform over its area, rounded to 0.1 mm; return x, y (m).

    Args:
        reach: radius of the disc (m).
        outward: share of the disc's area within the point, 0 .. 1.
        around: angle as a share of a turn, from x over y.
    """
    radius, angle = reach * math.sqrt(outward), 2.0 * math.pi * around
    return round(radius * math.cos(angle), 4), round(radius * math.sin(angle), 4)


def offsets(reach: float) -> tuple[tuple[float, float], ...]:
    """Return the sideways offsets of the tasks to try: zero, and `reach` (m) in four directions."""
    return (NO_OFFSET, (reach, 0.0), (0.0, reach), (-reach, 0.0), (0.0, -reach)) if reach else (NO_OFFSET,)


def moved_tasks(tasks: Sequence[Any], offset: tuple[float, float]) -> dict[str, dict[str, list[float]]]:
    """Compute the keys that move each [[task]] by `offset` (x, y in m), as task number -> keys and values."""

    def move_point(point: Sequence[float]) -> list[float]:
        return [float(f"{1e3 * (a + b):.9g}") for a, b in zip(point, offset, strict=True)]

    return {
        str(number): {f"{key}_mm": move_point(getattr(task, key)) for key in ("point", "to") if hasattr(task, key)}
        for number, task in enumerate(tasks, start=1)
    }


def moved_settings(experiment: Experiment, offset: tuple[float, float]) -> tuple[str, ...]:
    """Return `key=value` texts that move all tasks of an experiment by `offset` (m); empty without an offset."""
    if offset == NO_OFFSET:
        return ()
    if not experiment.tasks:
        raise InputRefused(
            f"{experiment.name}: has no [[task]] that could be moved by {1e3 * offset[0]:g}, {1e3 * offset[1]:g} mm"
        )
    moved = moved_tasks(experiment.tasks, offset)
    return tuple(f"task.{n}.{key}=[{x:g},{y:g}]" for n, new in moved.items() for key, (x, y) in new.items())
