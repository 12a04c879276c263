"""[approach] and [[task]]: massage tasks in TOML (Sec. III.B)."""

from typing import Any, Literal

from pydantic import model_validator

from twin.experiment.mistakes import checked_kind, numbered
from twin.settings import Settings, setting

Pair = tuple[float, float]


class Approach(Settings):
    """[approach]: how all tasks come and go."""

    height: float = setting("mm", help="z at which the robot travels between tasks")
    floor: float = setting("mm", help="z below which it never searches for contact")
    speed: float = setting("mm/s", gt=0, help="speed of travelling")
    descent: float = setting("mm/s", gt=0, help="speed of going down until it touches")
    ramp: float = setting("ms", gt=0, help="time in which a speed changes")
    release: float = setting("s", gt=0, help="time in which the force is taken back")

    @model_validator(mode="after")
    def _floor_is_below(self) -> "Approach":
        if self.floor >= self.height:
            raise ValueError(f"floor_mm = {1e3 * self.floor:g} is not below height_mm = {1e3 * self.height:g}")
        return self


class TaskOnPoint(Settings):
    """What every task has."""

    point: Pair = setting("mm", help="where (x, y)")
    force: float = setting("N", gt=0, help="pressing force")


class Press(TaskOnPoint):
    """[[task]] kind = "press": onto a point, the force grows, is held, and taken back."""

    kind: Literal["press"]
    build_up: float = setting("s", gt=0, help="time in which the force grows")
    hold: float = setting("s", gt=0, help="time for which it is held")


class Tap(TaskOnPoint):
    """[[task]] kind = "tap": down fast until the force is there, and up again, many times."""

    kind: Literal["tap"]
    speed: float = setting("mm/s", gt=0, help="speed of going down and up")
    lift: float = setting("mm", gt=0, help="height above the surface between two taps")
    period: float = setting("s", gt=0, help="from tap to tap")
    times: int = setting(ge=1, help="number of taps")


class Roll(TaskOnPoint):
    """[[task]] kind = "roll": a small circle under a constant force."""

    kind: Literal["roll"]
    build_up: float = setting("s", gt=0, help="time in which the force grows")
    radius: float = setting("mm", gt=0, help="radius of the circle")
    rate: float = setting("Hz", gt=0, help="turns per time")
    turns: float = setting(ge=1, help="number of turns")


class Push(TaskOnPoint):
    """[[task]] kind = "push": along a line under a constant force."""

    kind: Literal["push"]
    build_up: float = setting("s", gt=0, help="time in which the force grows")
    to: Pair = setting("mm", help="where the line ends (x, y)")
    speed: float = setting("mm/s", gt=0, help="speed along the line")

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
