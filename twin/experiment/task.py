"""[approach] and [[task]]: massage tasks in TOML (Sec. III.B)."""

from typing import Any, Literal

from pydantic import Field, ValidationError, model_validator

from twin.experiment.mistakes import sentences
from twin.experiment.quantity import Section, quantity

Pair = tuple[float, float]


class Approach(Section):
    """[approach]: how all tasks come and go."""

    height: float = quantity("height_mm", description="z at which the robot travels between tasks")
    floor: float = quantity("floor_mm", description="z below which it never searches for contact")
    speed: float = quantity("speed_mm_per_s", gt=0, description="speed of travelling")
    descent: float = quantity("descent_mm_per_s", gt=0, description="speed of going down until it touches")
    ramp: float = quantity("ramp_ms", gt=0, description="time in which a speed changes")
    release: float = quantity("release_s", gt=0, description="time in which the force is taken back")

    @model_validator(mode="after")
    def _floor_is_below(self) -> "Approach":
        if self.floor >= self.height:
            raise ValueError(f"floor_mm = {1e3 * self.floor:g} is not below height_mm = {1e3 * self.height:g}")
        return self


class TaskOnPoint(Section):
    """What every task has."""

    point: Pair = quantity("point_mm", description="where (x, y)")
    force: float = quantity("force_N", gt=0, description="pressing force")


class Press(TaskOnPoint):
    """[[task]] kind = "press": onto a point, the force grows, is held, and taken back."""

    kind: Literal["press"]
    build_up: float = quantity("build_up_s", gt=0, description="time in which the force grows")
    hold: float = quantity("hold_s", gt=0, description="time for which it is held")


class Tap(TaskOnPoint):
    """[[task]] kind = "tap": down fast until the force is there, and up again, many times."""

    kind: Literal["tap"]
    speed: float = quantity("speed_mm_per_s", gt=0, description="speed of going down and up")
    lift: float = quantity("lift_mm", gt=0, description="height above the surface between two taps")
    period: float = quantity("period_s", gt=0, description="from tap to tap")
    times: int = Field(ge=1, description="number of taps")


class Roll(TaskOnPoint):
    """[[task]] kind = "roll": a small circle under a constant force."""

    kind: Literal["roll"]
    build_up: float = quantity("build_up_s", gt=0, description="time in which the force grows")
    radius: float = quantity("radius_mm", gt=0, description="radius of the circle")
    rate: float = quantity("rate_Hz", gt=0, description="turns per time")
    turns: float = Field(ge=1, description="number of turns")


class Push(TaskOnPoint):
    """[[task]] kind = "push": along a line under a constant force."""

    kind: Literal["push"]
    build_up: float = quantity("build_up_s", gt=0, description="time in which the force grows")
    to: Pair = quantity("to_mm", description="where the line ends (x, y)")
    speed: float = quantity("speed_mm_per_s", gt=0, description="speed along the line")

    @model_validator(mode="after")
    def _goes_somewhere(self) -> "Push":
        if self.to == self.point:
            raise ValueError("to_mm is point_mm: expected another point, to which to push")
        return self


Task = Press | Tap | Roll | Push
KINDS: dict[str, type[Task]] = {"press": Press, "tap": Tap, "roll": Roll, "push": Push}


def checked_tasks(tables: Any, mistakes: list[str]) -> dict[int, Task]:
    """The tasks of the array of tables [[task]] that are right, by their number, counted from 1.

    Args:
        tables: what the file says; None if nothing.
        mistakes: gets a sentence for each mistake, with the number of its task.
    """
    if tables is None:
        return {}
    if not isinstance(tables, tuple):
        mistakes.append("[task]: a single table; tasks are an array of tables, write [[task]]")
        return {}
    if not tables:
        mistakes.append("[[task]]: an empty array; expected at least one task, or [reference] with way points")
    tasks = {}
    for number, table in enumerate(tables, start=1):
        kind = table.get("kind") if isinstance(table, dict) else None
        if not isinstance(kind, str) or kind not in KINDS:
            mistakes.append(f"[task {number}] kind = {kind!r}: expected {', '.join(map(repr, KINDS))}")
            continue
        try:
            tasks[number] = KINDS[kind].model_validate(table)
        except ValidationError as error:
            mistakes += sentences(error, KINDS[kind], f"task {number}")
    return tasks
