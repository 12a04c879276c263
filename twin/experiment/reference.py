"""[reference]: where the platform shall be, as way points or as a shape that becomes way points."""

from itertools import pairwise
from typing import Literal, NamedTuple

from pydantic import Field, field_validator, model_validator

from twin.experiment.quantity import Section, quantity
from twin.experiment.replaced import SHAPES
from twin.experiment.robot import Triple


class Circle(Section):
    """[reference.circle]: level circles, counter-clockwise seen from above, at constant speed from `start_s` on."""

    centre: Triple = quantity("centre_mm", "of the circle in frame B", examples=[[0.0, 0.0, -90.0]])
    radius: float = quantity("radius_mm", "of the circle, which begins at +x", gt=0, examples=[15.0])
    rate: float = quantity("rate_Hz", "turns per time", gt=0, examples=[0.2])
    turns: float = Field(gt=0, examples=[1.0], description="number of turns")
    start: float = quantity("start_s", "how long it rests before", 0.0, ge=0)


class Chirp(Section):
    """[reference.chirp]: a sine along one axis whose frequency grows linearly with time."""

    point: Triple = quantity("point_mm", "about which it swings, in frame B", examples=[[0.0, 0.0, -90.0]])
    direction: Literal["x", "y", "z"] = Field(examples=["z"], description="axis of frame B along which it swings")
    amplitude: float = quantity("amplitude_mm", "of the sine", gt=0, examples=[2.0])
    begin: float = quantity("begin_Hz", "frequency at the beginning", gt=0, examples=[0.1])
    end: float = quantity("end_Hz", "frequency at the end", gt=0, examples=[2.0])
    duration: float = quantity("duration_s", "of the sweep", gt=0, examples=[10.0])
    start: float = quantity("start_s", "how long it rests before", 0.0, ge=0)


class JointStep(Section):
    """[reference.joint_step]: a step of the platform after which one joint alone has another angle."""

    point: Triple = quantity("point_mm", "where the platform is before", examples=[[0.0, 0.0, -90.0]])
    joint: Literal[1, 2, 3] = Field(examples=[1], description="which moves")
    step: float = quantity("step_deg", "by how much; positive lowers the platform", examples=[2.0])
    start: float = quantity("start_s", "when", gt=0, examples=[0.5])

    @field_validator("step")
    @classmethod
    def _moves(cls, step: float) -> float:
        if step == 0.0:
            raise ValueError("expected an angle other than 0")
        return step


class Reference(Section):
    """[reference]: way points, straight lines at constant speed between them; or one shape."""

    t: tuple[float, ...] | None = quantity(
        "t_s", "times of the way points, ascending", None, min_length=1, examples=[[0.0, 2.0]]
    )
    p: tuple[Triple, ...] | None = quantity(
        "p_mm",
        "positions (x, y, z) of the way points in frame B",
        None,
        min_length=1,
        examples=[[[0.0, 0.0, -90.0], [0.0, 0.0, -95.0]]],
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
