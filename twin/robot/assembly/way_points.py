"""Way points of [reference]: a shape becomes a way point at every sample of the controller."""

import math

import numpy as np
from numpy.typing import NDArray

from twin.robot.experiment.experiment import Tables
from twin.robot.experiment.schema import Chirp, Circle, JointStep, Reference, WayPoints
from twin.robot.mechanism.geometry import Geometry, geometry_of
from twin.robot.mechanism.kinematics import joint_angles, position
from twin.robot.mechanism.unreachable import Unreachable

MAX_POINTS = 2_000_000
"""Of a shape; more than an hour at 2 ms."""
SAMPLES_PER_PERIOD = 10
"""A sine through fewer way points per period is a polygon rather than a sine."""


def load_waypoints(tables: Tables, mistakes: list[str]) -> WayPoints | None:
    """The way points along which [reference] leads; None without it, or if a mistake of another table hides them.

    Args:
        tables: of the experiment.
        mistakes: gets a sentence if the shape cannot be followed.
    """
    reference, computer = tables.by_name.get("reference"), tables.by_name.get("controller")
    if reference is None:
        return None
    if reference.t is not None:
        return WayPoints(reference.t, reference.p)
    # a shape has to know whose samples and joints it is made of
    if computer is None:
        return None
    try:
        return way_points(reference, geometry_of(computer.model), computer.period, tables.duration)
    except Unreachable as problem:
        mistakes.append(f"[reference.joint_step] {problem}")
    except ValueError as problem:
        mistakes.append(str(problem))
    return None


def way_points(reference: Reference, believed: Geometry, period: float, duration: float) -> WayPoints:
    """The way points of the shape in `reference`; they end with the experiment.

    Args:
        believed: geometry of the controller, whose joints a joint step moves.
        period: of the controller (s).
        duration: of the experiment (s).

    Raises:
        Unreachable: the robot cannot be where a joint step begins or ends.
        ValueError: a chirp too fast for the controller's samples, or a shape of too many, in one sentence.
    """
    if reference.circle is not None:
        turns = reference.circle
        return _sample_shape(_on_circle, turns, turns.turns / turns.rate, period, duration, "circle")
    if reference.chirp is not None:
        sweep = reference.chirp
        fastest = 1.0 / (SAMPLES_PER_PERIOD * period)
        if max(sweep.begin, sweep.end) > fastest:
            raise ValueError(
                f"[reference.chirp] {max(sweep.begin, sweep.end):g} Hz: expected at most {fastest:g} Hz, "
                f"{SAMPLES_PER_PERIOD} samples of the controller per period"
            )
        return _sample_shape(_on_chirp, sweep, sweep.duration, period, duration, "chirp")
    assert reference.joint_step is not None
    return _joint_step(reference.joint_step, believed, period)


def _sample_shape(path, shape, length: float, period: float, duration: float, name: str) -> WayPoints:  # type: ignore[no-untyped-def]
    """`path` (shape, times since its start) from `shape.start` on, for `length` (s)."""
    samples = min(length, max(period, duration - shape.start)) / period
    if samples > MAX_POINTS:
        raise ValueError(f"[reference.{name}] {samples:.3g} way points: expected at most {MAX_POINTS:,}; shorten it")
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
