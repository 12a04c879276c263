"""[reference]: where the platform shall be, as way points or as a shape that is made of way points.

A shape becomes a way point at every sample of the controller, so the controller that follows it knows way points only.
"""

import math
from itertools import pairwise
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, field_validator, model_validator

from twin.experiment.quantity import Section, quantity
from twin.experiment.schema import Triple
from twin.experiment.source import SHAPES
from twin.robot.forward_kinematics import position
from twin.robot.geometry import Geometry
from twin.robot.inverse_kinematics import joint_angles

MOST_POINTS = 2_000_000
"""Of a shape; more than an hour at 2 ms."""
SAMPLES_PER_PERIOD = 10
"""A sine through fewer way points per period is a polygon rather than a sine."""


class Circle(Section):
    """[reference.circle]: level circles, counter-clockwise seen from above, at constant speed from `start_s` on."""

    centre: Triple = quantity("centre_mm", examples=[[0.0, 0.0, -90.0]], description="of the circle in frame B")
    radius: float = quantity("radius_mm", gt=0, examples=[15.0], description="of the circle, which begins at +x")
    rate: float = quantity("rate_Hz", gt=0, examples=[0.2], description="turns per time")
    turns: float = Field(gt=0, examples=[1.0], description="number of turns")
    start: float = quantity("start_s", 0.0, ge=0, description="how long it rests before")


class Chirp(Section):
    """[reference.chirp]: a sine along one axis whose frequency grows linearly with time."""

    point: Triple = quantity("point_mm", examples=[[0.0, 0.0, -90.0]], description="about which it swings, in frame B")
    direction: Literal["x", "y", "z"] = Field(examples=["z"], description="axis of frame B along which it swings")
    amplitude: float = quantity("amplitude_mm", gt=0, examples=[2.0], description="of the sine")
    begin: float = quantity("begin_Hz", gt=0, examples=[0.1], description="frequency at the beginning")
    end: float = quantity("end_Hz", gt=0, examples=[2.0], description="frequency at the end")
    duration: float = quantity("duration_s", gt=0, examples=[10.0], description="of the sweep")
    start: float = quantity("start_s", 0.0, ge=0, description="how long it rests before")


class JointStep(Section):
    """[reference.joint_step]: a step of the platform after which one joint alone has another angle."""

    point: Triple = quantity("point_mm", examples=[[0.0, 0.0, -90.0]], description="where the platform is before")
    joint: Literal[1, 2, 3] = Field(examples=[1], description="which moves")
    step: float = quantity("step_deg", examples=[2.0], description="by how much; positive lowers the platform")
    start: float = quantity("start_s", gt=0, examples=[0.5], description="when")

    @field_validator("step")
    @classmethod
    def _moves(cls, step: float) -> float:
        if step == 0.0:
            raise ValueError("expected an angle other than 0")
        return step


class Reference(Section):
    """[reference]: way points, straight lines at constant speed between them; or one shape."""

    t: tuple[float, ...] | None = quantity(
        "t_s", None, min_length=1, examples=[[0.0, 2.0]], description="times of the way points, ascending"
    )
    p: tuple[Triple, ...] | None = quantity(
        "p_mm",
        None,
        min_length=1,
        examples=[[[0.0, 0.0, -90.0], [0.0, 0.0, -95.0]]],
        description="positions (x, y, z) of the way points in frame B",
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


def way_points(reference: Reference, believed: Geometry, period: float, duration: float) -> WayPoints:
    """The way points of the shape in `reference`; they end with the experiment.

    Args:
        believed: geometry of the controller, whose joints a joint step moves. period: of the controller (s).
        duration: of the experiment (s).

    Raises:
        Unreachable: the robot cannot be where a joint step begins or ends.
        ValueError: a chirp too fast for the controller's samples, or a shape of too many, in one sentence.
    """
    if reference.circle is not None:
        turns = reference.circle
        return _sampled(_on_circle, turns, turns.turns / turns.rate, period, duration, "circle")
    if reference.chirp is not None:
        sweep = reference.chirp
        fastest = 1.0 / (SAMPLES_PER_PERIOD * period)
        if max(sweep.begin, sweep.end) > fastest:
            raise ValueError(
                f"[reference.chirp] {max(sweep.begin, sweep.end):g} Hz: expected at most {fastest:g} Hz, "
                f"{SAMPLES_PER_PERIOD} samples of the controller per period"
            )
        return _sampled(_on_chirp, sweep, sweep.duration, period, duration, "chirp")
    assert reference.joint_step is not None
    return _joint_step(reference.joint_step, believed, period)


def _sampled(path, shape, length: float, period: float, duration: float, name: str) -> WayPoints:  # type: ignore[no-untyped-def]
    """`path` (shape, times since its start) from `shape.start` on, for `length` (s)."""
    samples = min(length, max(period, duration - shape.start)) / period
    if samples > MOST_POINTS:
        raise ValueError(f"[reference.{name}] {samples:.3g} way points: expected at most {MOST_POINTS:,}; shorten it")
    last = math.ceil(samples - 1e-9)
    since = np.minimum(period * np.arange(last + 1), length)
    t, p = shape.start + since, path(shape, since)
    if shape.start > 0.0:
        t, p = np.append(0.0, t), np.vstack([p[:1], p])
    return WayPoints(tuple(t.tolist()), tuple(tuple(point) for point in p.tolist()), name)


def _on_circle(circle: Circle, since: NDArray[np.float64]) -> NDArray[np.float64]:
    phase = 2.0 * np.pi * circle.rate * since
    return np.array(circle.centre) + circle.radius * np.stack([np.cos(phase), np.sin(phase), 0.0 * phase], axis=1)


def _on_chirp(chirp: Chirp, since: NDArray[np.float64]) -> NDArray[np.float64]:
    """The phase is 2 pi times the integral of the frequency, begin + (end - begin) t / duration."""
    turns = chirp.begin * since + 0.5 * (chirp.end - chirp.begin) * since**2 / chirp.duration
    p = np.tile(np.array(chirp.point), (len(since), 1))
    p[:, "xyz".index(chirp.direction)] += chirp.amplitude * np.sin(2.0 * np.pi * turns)
    return p


def _joint_step(step: JointStep, believed: Geometry, period: float) -> WayPoints:
    """Inverse kinematics, one angle more, forward kinematics: Eq. 7-12, and the point where the three rods meet."""
    theta_l = joint_angles(believed, np.array(step.point))
    theta_l[step.joint - 1] += step.step
    after = tuple(position(believed, theta_l).tolist())
    return WayPoints((0.0, step.start, step.start + period), (step.point, step.point, after), "joint_step")
