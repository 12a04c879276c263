"""[approach] and [[task]]: massage tasks in TOML (Sec. III.B)."""

from typing import Any, Literal

from pydantic import Field, model_validator

from twin.experiment.mistakes import checked_kind, numbered
from twin.experiment.quantity import Section, quantity

Pair = tuple[float, float]


class Approach(Section):
    """[approach]: how all tasks come and go."""

    height: float = quantity("height_mm", "z at which the robot travels between tasks")
    floor: float = quantity("floor_mm", "z below which it never searches for contact")
    speed: float = quantity("speed_mm_per_s", "speed of travelling", gt=0)
    descent: float = quantity("descent_mm_per_s", "speed of going down until it touches", gt=0)
    ramp: float = quantity("ramp_ms", "time in which a speed changes", gt=0)
    release: float = quantity("release_s", "time in which the force is taken back", gt=0)

    @model_validator(mode="after")
    def _floor_is_below(self) -> "Approach":
        if self.floor >= self.height:
            raise ValueError(f"floor_mm = {1e3 * self.floor:g} is not below height_mm = {1e3 * self.height:g}")
        return self


class TaskOnPoint(Section):
    """What every task has."""

    point: Pair = quantity("point_mm", "where (x, y)")
    force: float = quantity("force_N", "pressing force", gt=0)


class Press(TaskOnPoint):
    """[[task]] kind = "press": onto a point, the force grows, is held, and taken back."""

    kind: Literal["press"]
    build_up: float = quantity("build_up_s", "time in which the force grows", gt=0)
    hold: float = quantity("hold_s", "time for which it is held", gt=0)


class Tap(TaskOnPoint):
    """[[task]] kind = "tap": down fast until the force is there, and up again, many times."""

    kind: Literal["tap"]
    speed: float = quantity("speed_mm_per_s", "speed of going down and up", gt=0)
    lift: float = quantity("lift_mm", "height above the surface between two taps", gt=0)
    period: float = quantity("period_s", "from tap to tap", gt=0)
    times: int = Field(ge=1, description="number of taps")


class Roll(TaskOnPoint):
    """[[task]] kind = "roll": a small circle under a constant force."""

    kind: Literal["roll"]
    build_up: float = quantity("build_up_s", "time in which the force grows", gt=0)
    radius: float = quantity("radius_mm", "radius of the circle", gt=0)
    rate: float = quantity("rate_Hz", "turns per time", gt=0)
    turns: float = Field(ge=1, description="number of turns")


class Push(TaskOnPoint):
    """[[task]] kind = "push": along a line under a constant force."""

    kind: Literal["push"]
    build_up: float = quantity("build_up_s", "time in which the force grows", gt=0)
    to: Pair = quantity("to_mm", "where the line ends (x, y)")
    speed: float = quantity("speed_mm_per_s", "speed along the line", gt=0)

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
    if tables == ():
        mistakes.append("[[task]]: an empty array; expected at least one task, or [reference] with way points")
    found = {n: checked_kind(KINDS, table, f"task {n}", mistakes) for n, table in numbered(tables, "task", mistakes)}
    return {number: task for number, task in found.items() if task is not None}
