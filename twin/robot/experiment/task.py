"""What leads the robot: [reference], way points or a shape that becomes way points; or the tasks of [[task]]."""

from collections.abc import Mapping
from itertools import pairwise
from typing import Any, Literal, NamedTuple, TypeVar

from pydantic import field_validator, model_validator

from twin.kernel.settings import Settings, Triple, setting
from twin.robot.experiment.mistakes import checked_kind, numbered
from twin.robot.experiment.source import SHAPES

Task = TypeVar("Task", bound=Settings)


class Circle(Settings):
    """[reference.circle]: level circles, counter-clockwise seen from above, at constant speed from `start_s` on."""

    centre: Triple = setting("mm", examples=[[0.0, 0.0, -90.0]], help="of the circle in frame B")
    radius: float = setting("mm", gt=0, examples=[15.0], help="of the circle, which begins at +x")
    rate: float = setting("Hz", gt=0, examples=[0.2], help="turns per time")
    turns: float = setting(gt=0, examples=[1.0], help="number of turns")
    start: float = setting("s", default=0.0, ge=0, help="how long it rests before")


class Chirp(Settings):
    """[reference.chirp]: a sine along one axis whose frequency grows linearly with time."""

    point: Triple = setting("mm", examples=[[0.0, 0.0, -90.0]], help="about which it swings, in frame B")
    direction: Literal["x", "y", "z"] = setting(examples=["z"], help="axis of frame B along which it swings")
    amplitude: float = setting("mm", gt=0, examples=[2.0], help="of the sine")
    begin: float = setting("Hz", gt=0, examples=[0.1], help="frequency at the beginning")
    end: float = setting("Hz", gt=0, examples=[2.0], help="frequency at the end")
    duration: float = setting("s", gt=0, examples=[10.0], help="of the sweep")
    start: float = setting("s", default=0.0, ge=0, help="how long it rests before")


class JointStep(Settings):
    """[reference.joint_step]: a step of the platform after which one joint alone has another angle."""

    point: Triple = setting("mm", examples=[[0.0, 0.0, -90.0]], help="where the platform is before")
    joint: Literal[1, 2, 3] = setting(examples=[1], help="which moves")
    step: float = setting("deg", examples=[2.0], help="by how much; positive lowers the platform")
    start: float = setting("s", gt=0, examples=[0.5], help="when")

    @field_validator("step")
    @classmethod
    def _moves(cls, step: float) -> float:
        if step == 0.0:
            raise ValueError("expected an angle other than 0")
        return step


class Reference(Settings):
    """[reference]: way points, straight lines at constant speed between them; or one shape."""

    t: tuple[float, ...] | None = setting(
        "s", default=None, min_length=1, examples=[[0.0, 2.0]], help="times of the way points, ascending"
    )
    p: tuple[Triple, ...] | None = setting(
        "mm",
        default=None,
        min_length=1,
        examples=[[[0.0, 0.0, -90.0], [0.0, 0.0, -95.0]]],
        help="positions (x, y, z) of the way points in frame B",
    )
    circle: Circle | None = None
    chirp: Chirp | None = None
    joint_step: JointStep | None = None

    @field_validator("t")
    @classmethod
    def _ascending(cls, t: tuple[float, ...] | None) -> tuple[float, ...] | None:
        if t is not None and any(later <= earlier for earlier, later in pairwise(t)):
            raise ValueError("expected times that increase from one way point to the next")
        return t

    @model_validator(mode="after")
    def _one_of_them(self) -> "Reference":
        points = self.t is not None or self.p is not None
        named = [name for name in SHAPES if getattr(self, name) is not None]
        if points + len(named) != 1:
            got = ", ".join(["way points"] * points + named) or "nothing"
            raise ValueError(f"got {got}: expected either way points (t_s and p_mm) or one of {', '.join(SHAPES)}")
        if points and (self.t is None or self.p is None):
            raise ValueError(f"missing key '{'t_s' if self.t is None else 'p_mm'}': way points need t_s and p_mm")
        return self


class WayPoints(NamedTuple):
    """What the controller follows: times (s, ascending), positions (m, frame B), and the shape they are of, or ""."""

    t: tuple[float, ...]
    p: tuple[Triple, ...]
    shape: str = ""


def checked_tasks(kinds: Mapping[str, type[Task]], tables: Any, mistakes: list[str]) -> dict[int, Task]:
    """The tasks of the array of tables [[task]] that are right, by their number, counted from 1.

    Args:
        kinds: of tasks, by the key `kind` of their tables.
        tables: what the file says; None if nothing.
        mistakes: gets a sentence for each mistake, with the number of its task.
    """
    if tables is None:
        return {}
    if tables == ():
        mistakes.append("[[task]]: an empty array; expected at least one task, or [reference] with way points")
    found = {n: checked_kind(kinds, table, f"task {n}", mistakes) for n, table in numbered(tables, "task", mistakes)}
    return {number: task for number, task in found.items() if task is not None}
