"""Measures of the tasks of Fig. 5: functions of one task's run that return a number in SI, infinity if undefined.

The mask `on` (n,) selects the samples of `run.t` in the measured part of the task.

The definitions differ from the measures of a run: a claim of the paper concerns a part of a task (the descent, a full
circle, one tap) and its force instead of its ramp, and it is measured beyond a trip of the safety monitor.
"""

import math
from collections.abc import Callable
from itertools import pairwise

import numpy as np

from twin.robot.controller.program import PhaseKind, Press, Push, Roll, Tap
from twin.robot.run.hold import SETTLING_BAND
from twin.studies.metrics import response
from twin.studies.paper.task_run import Mask, TaskRun

RATE_SPAN = 0.2
"""Time span of a rate of the force (s), which a person feels as one rise."""
MAX_OFFSET = 0.5e-3
"""Maximum horizontal distance (m) from a point of a position above it."""
DEVIATION_ROUNDING = 1e-9
"""Deviation (m) below which the sideways motion is only rounding."""
Measure = Callable[[TaskRun], float]


def masked_measure(mask: Callable[[TaskRun], Mask], measure: Callable[[TaskRun, Mask], float]) -> Measure:
    """Restrict a measure of Fig. 5 to the samples of a mask; infinity without samples, which no bound allows."""

    def measured(run: TaskRun) -> float:
        on = mask(run)
        return measure(run, on) if np.any(on) else math.inf

    return measured


def phase_measure(kind: PhaseKind, measure: Callable[[TaskRun, Mask], float]) -> Measure:
    """Restrict a measure of Fig. 5 to the samples of a task's phase."""
    return masked_measure(lambda run: run.phase_mask(kind), measure)


def speed_of_touch(run: TaskRun, on: Mask) -> float:
    """Measure the platform's downward speed at its first sample in contact (m/s)."""
    touching = np.flatnonzero(on & (run.F_z > 0.0))
    return float(-run.v_z[touching[0]]) if len(touching) else math.inf


def steepness(run: TaskRun, on: Mask) -> float:
    """Measure the largest rate of the pressing force over the requested mean rate."""
    assert not isinstance(run.task, Tap)
    return response.steepest_rise(run.t[on], run.F_z[on], RATE_SPAN) * run.task.build_up / run.task.force


def force_error(run: TaskRun, on: Mask) -> float:
    """Measure the root mean square of the true force minus its final reference (N)."""
    return response.rms(run.F_z[on] - run.task.force)


def distance(run: TaskRun, on: Mask) -> float:
    """Measure the largest horizontal distance of the platform from the task's point (m)."""
    return float(np.max(np.linalg.norm(run.p_B[on, :2] - run.task.point, axis=1)))


def share_not_held(run: TaskRun, on: Mask) -> float:
    """Measure the share of the programmed time without the requested force."""
    assert isinstance(run.task, Press)
    reached = on & (np.abs(run.F_z - run.task.force) <= SETTLING_BAND * run.task.force)
    return 1.0 - float(np.count_nonzero(reached) * (run.t[1] - run.t[0])) / run.task.hold


def slowness(run: TaskRun) -> float:
    """Measure by how much the taps' speed at the touch is below the requested speed, as a share."""
    assert isinstance(run.task, Tap)
    return 1.0 + float(np.mean(run.v_z[run.touches])) / run.task.speed if len(run.touches) else math.inf


def height_before(run: TaskRun) -> float:
    """Measure a tap's smallest start height above the touch over the requested lift; 0 if not above the point."""
    assert isinstance(run.task, Tap)
    heights = []
    for tap in run.taps:
        hits = np.flatnonzero(run.F_z[tap] > 0.0)
        if len(hits):
            start, touch = run.p_B[tap.start], run.p_B[tap.start + hits[0]]
            above = math.dist(start[:2], run.task.point) <= MAX_OFFSET
            heights.append(float(start[2] - touch[2]) / run.task.lift if above else 0.0)
    return min(heights, default=-math.inf)


def mean_peak(run: TaskRun) -> float:
    """Measure the mean force peak of the taps over the requested force."""
    return float(np.mean(run.peaks)) / run.task.force if len(run.peaks) else math.inf


def peak_variation(run: TaskRun) -> float:
    """Measure the coefficient of variation of the taps' force peaks."""
    return response.variation(run.peaks) if len(run.peaks) > 1 else math.inf


def unrest(run: TaskRun) -> float:
    """Measure the largest deviation of the time between touches from the taps' period, as a share of it."""
    assert isinstance(run.task, Tap)
    gaps = [b - a for a, b in pairwise(run.t[run.touches])]
    return max((abs(gap / run.task.period - 1.0) for gap in gaps), default=math.inf)


def taps_missing(run: TaskRun) -> float:
    """Measure the number of requested taps that do not touch and leave."""
    assert isinstance(run.task, Tap)
    return float(run.task.times - run.whole_taps)


def _circle(run: TaskRun, on: Mask) -> tuple[float, float, float]:
    """Return (x, y, r) of the circle fitted to the platform's trace (m)."""
    return response.fitted_circle(run.p_B[on, 0], run.p_B[on, 1])


def radius(run: TaskRun, on: Mask) -> float:
    """Measure the fitted radius of a rolled circle over the requested radius."""
    assert isinstance(run.task, Roll)
    return _circle(run, on)[2] / run.task.radius


def eccentricity(run: TaskRun, on: Mask) -> float:
    """Measure the distance of a rolled circle's fitted centre from the task's point (m)."""
    x, y, _ = _circle(run, on)
    return math.dist((x, y), run.task.point)


def unroundness(run: TaskRun, on: Mask) -> float:
    """Measure the root mean square distance of the platform from the fitted circle, over its radius."""
    x, y, radius = _circle(run, on)
    return response.rms(np.hypot(run.p_B[on, 0] - x, run.p_B[on, 1] - y) - radius) / radius


def turns_missing(run: TaskRun, on: Mask) -> float:
    """Measure the absolute difference between requested and completed turns around the point."""
    assert isinstance(run.task, Roll)
    return abs(run.task.turns - response.turns_about(run.p_B[on, 0], run.p_B[on, 1], run.task.point))


def off_line(run: TaskRun, on: Mask) -> response.Curve:
    """Return the signed distance of the platform's samples from the line of a push (m)."""
    assert isinstance(run.task, Push)
    return response.along_and_off(run.p_B[on, :2], run.task.point, run.task.to)[1]


def symmetry_reason(deviation: Measure) -> Callable[[TaskRun], str]:
    """Return a function that explains a deviation of 0 by the robot's symmetry, which supports no claim of Fig. 5."""
    return lambda run: "0 by the robot's own symmetry" if deviation(run) < DEVIATION_ROUNDING else ""


def line_missing(run: TaskRun, on: Mask) -> float:
    """Measure the share of the line that remains when a push ends."""
    assert isinstance(run.task, Push)
    along, _ = response.along_and_off(run.p_B[on, :2], run.task.point, run.task.to)
    return 1.0 - float(along[-1]) / math.dist(run.task.point, run.task.to)
