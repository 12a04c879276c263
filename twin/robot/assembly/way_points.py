"""Waypoints of [reference]: shapes are sampled at every period of the controller."""

import math

import numpy as np
from numpy.typing import NDArray

from twin.robot.experiment.experiment import Tables
from twin.robot.experiment.schema import Chirp, Circle, JointStep, Reference, WayPoints
from twin.robot.mechanism.geometry import Geometry, geometry_of
from twin.robot.mechanism.kinematics import joint_angles, position
from twin.robot.mechanism.unreachable import Unreachable

MAX_POINTS = 2_000_000
"""Maximum number of waypoints of a shape; more than an hour at 2 ms."""
SAMPLES_PER_PERIOD = 10
"""Minimum number of waypoints per period of a sine; fewer make it a polygon."""


def load_waypoints(tables: Tables, mistakes: list[str]) -> WayPoints | None:
    """Convert [reference] to waypoints; None without that table, or if errors in other tables prevent it."""
    reference, computer = tables.by_name.get("reference"), tables.by_name.get("controller")
    if reference is None:
        return None
    if reference.t is not None:
        return WayPoints(reference.t, reference.p)
    # shapes need the controller's period and geometry
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
    """Compute the waypoints of a circle, chirp or joint step, up to the end of the experiment.

    Args:
        believed: geometry of the controller, whose joints a joint step moves.
        period: period of the controller (s).
        duration: duration of the experiment (s).

    Raises:
        Unreachable: the start or end of a joint step is out of reach.
        ValueError: a chirp is too fast for the controller's period, or a shape has too many points.
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
    """Sample a reference shape once per controller period, from its start time on, for `length` (s)."""
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
    """Compute the points (n, 3) in m of a sine with linearly growing frequency.

    The phase is 2 pi times the integral of begin + (end - begin) t / duration.
    """
    turns = chirp.begin * since + 0.5 * (chirp.end - chirp.begin) * since**2 / chirp.duration
    p = np.tile(np.array(chirp.point), (len(since), 1))
    p[:, "xyz".index(chirp.direction)] += chirp.amplitude * np.sin(2.0 * np.pi * turns)
    return p


def _joint_step(step: JointStep, believed: Geometry, period: float) -> WayPoints:
    """Compute the waypoints of a joint step: inverse kinematics (Eq. 7-12), one angle changed, forward kinematics."""
    theta_l = joint_angles(believed, np.array(step.point))
    theta_l[step.joint - 1] += step.step
    after = tuple(position(believed, theta_l).tolist())
    return WayPoints((0.0, step.start, step.start + period), (step.point, step.point, after), "joint_step")
