"""Measures of the tasks of Fig. 5: one task's run in, a number in SI out, infinity where it never happened.

Those that look at a part of the task take it as a mask `on` (n,) of the samples of `run.t`.

They keep definitions of their own beside those of a run's measures: a claim of the paper is on a part of a task (the
descent, a full circle, one tap), on its force and not on its ramp, and it goes on after a trip of the safety monitor.

The tasks in a recording (Fig. 5), as curves of what truly happened.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.kernel.errors import InputRefused
from twin.kernel.recording.reader import Recording
from twin.robot.assembly.declared import DECLARED
from twin.robot.controller.program import TASKS, PhaseKind, Press, Push, Roll, Tap, Task
from twin.robot.experiment.recorded import recorded_values
from twin.robot.experiment.schema import checked_tasks
from twin.robot.monitor.checks import MEANINGS, Reason
from twin.robot.run.hold import BAND
from twin.robot.run.view import held_samples
from twin.studies.metrics import response
from twin.studies.metrics.requirement import FIG5, lacking

Mask = NDArray[np.bool_]

TOUCH = 0.1
"""Share of the pre-defined force that counts as a tap."""


def _read(of: "Callable[[TaskRun], response.Curve]") -> "cached_property[response.Curve]":
    return cached_property(of)


@dataclass(frozen=True)
class TaskRun:
    """One task of a run, from its first phase to its last; without samples if the run never came to it.

    Curves are (n,) or (n, 3), SI, at the plant's ticks `t`. Those of the controller are held between its samples, as
    its commands are.

    Attributes:
        recording: of the run.
        number: which task of the run, counted from 1.
        task: what was asked for, SI.
        F_z: true pressing force (N).
        p_B: true position of the platform (m).
        v_z: its vertical speed upwards (m/s).
    """

    recording: Recording
    number: int
    task: Task

    @cached_property
    def _held(self) -> NDArray[np.int64]:
        """Index of the controller's sample that holds at each of the plant's ticks."""
        return held_samples(self.recording.time("controller"), self.recording.time("plant"))

    @cached_property
    def _window(self) -> slice:
        """The plant's samples in which this task was on."""
        on = (self.recording["controller.task"] == self.number) & (self.recording["controller.phase"] != PhaseKind.DONE)
        ticks = np.flatnonzero(on[self._held])
        return slice(ticks[0], ticks[-1] + 1) if len(ticks) else slice(0, 0)

    def commanded(self, name: str) -> response.Curve:
        """A series of the controller, held."""
        return self.recording[f"controller.{name}"][self._held[self._window]]

    t = _read(lambda run: run.recording.time("plant")[run._window])
    F_z = _read(lambda run: -run.recording["plant.F_ee_B"][run._window, 2])
    p_B = _read(lambda run: run.recording["plant.p_B"][run._window])
    v_z = _read(lambda run: run.recording["plant.v_B"][run._window, 2])

    @cached_property
    def phase(self) -> NDArray[np.int64]:
        return self.commanded("phase").astype(np.int64)

    def during(self, kind: PhaseKind) -> Mask:
        """Samples of a phase."""
        return self.phase == kind

    @cached_property
    def full_turns(self) -> Mask:
        """Samples of the full circles: without the turn that spirals out and the one that spirals back."""
        circling = self.during(PhaseKind.CIRCLE)
        assert self.task.kind == "roll"
        since = self.t - response.first_time(self.t, circling)
        turn = 1.0 / self.task.rate
        return circling & (since >= turn) & (since <= (1.0 + self.task.turns) * turn)

    @cached_property
    def taps(self) -> list[slice]:
        """Samples of each tap, from its start to that of the next, or to the end of the task."""
        tapping = self.during(PhaseKind.TAP)
        starts = np.flatnonzero(np.diff(tapping.astype(np.int8), prepend=0) > 0)
        return [slice(a, b) for a, b in zip(starts, [*starts[1:], len(self.t)], strict=True)]

    @cached_property
    def peaks(self) -> response.Curve:
        """Largest force of each tap that touches (N)."""
        largest = np.array([self.F_z[tap].max() for tap in self.taps])
        return largest[largest >= TOUCH * self.task.force]

    @cached_property
    def touches(self) -> NDArray[np.int64]:
        """Index of the first sample in contact of each tap that touches."""
        hits = [tap.start + np.flatnonzero(self.F_z[tap] > 0.0) for tap in self.taps]
        return np.array([hit[0] for hit in hits if len(hit)], dtype=np.int64)

    @cached_property
    def whole_taps(self) -> int:
        """How many taps touch and then leave the surface."""
        whole = 0
        for tap in self.taps:
            F_z = self.F_z[tap]
            peak = int(np.argmax(F_z))
            whole += bool(F_z[peak] >= TOUCH * self.task.force and np.any(F_z[peak:] <= 0.0))
        return whole

    @property
    def watched(self) -> bool:
        """Whether the run had a safety monitor."""
        return "monitor.tripped" in self.recording.fields()

    @cached_property
    def tripped(self) -> bool:
        """Whether the safety monitor tripped before this task was over."""
        return len(self.t) == 0 or bool(trip_time(self.recording) <= self.t[-1])


def task_runs(recording: Recording) -> list[TaskRun]:
    """The tasks of a run in their order.

    Raises:
        InputRefused: it holds none, or lacks what they are judged on.
    """
    tables = _tuples(settings(recording).get("task", []))
    tasks = tuple(checked_tasks(TASKS, tables, []).values())
    if tasks and (missing := lacking(FIG5, recording.fields())):
        raise InputRefused(
            f"{recording.path}: no {', '.join(missing)}; Fig. 5 is judged phase by phase of each task, so the "
            "controller has to put these out"
        )
    if not tasks:
        raise InputRefused(
            f"{recording.path}: holds no task; Fig. 5 needs a run of [[task]] tables, such as experiments/pressing.toml"
        )
    return [TaskRun(recording, number, task) for number, task in enumerate(tasks, start=1)]


def settings(recording: Recording) -> dict[str, Any]:
    """The experiment's checked values, keys with units.

    Raises:
        InputRefused: as `recorded_values`.
    """
    return recorded_values(DECLARED, recording.metadata, recording.path)


def drive_of(recording: Recording) -> str:
    """`velocity_servo`; `stepper+velocity_servo` where the joints differ."""
    drive = settings(recording).get("drive", {})
    tables = [drive, *(table for table in drive.values() if isinstance(table, dict))]
    return "+".join(sorted({Path(table["fmu"]).stem for table in tables if "fmu" in table})) or "parts"


def body_of(recording: Recording) -> str:
    """`back`; `scale` or `skin` where no file of bodies was named."""
    contact = settings(recording).get("contact", {})
    return Path(contact.get("body", contact.get("kind", "unknown"))).stem


def trip_time(recording: Recording) -> float:
    """When the safety monitor tripped (s); infinity: never, or there is none."""
    if "monitor.tripped" not in recording.fields():
        return np.inf
    return response.first_time(recording.time("monitor"), recording["monitor.tripped"].astype(bool))


def trip_sentence(recording: Recording) -> str:
    """One sentence on a trip, or ""."""
    time = trip_time(recording)
    if np.isinf(time):
        return ""
    code = recording["monitor.reason"][np.searchsorted(recording.time("monitor"), time)]
    why = MEANINGS[Reason(int(code))].sentence.removeprefix("joint {joint}: ")
    return f"{recording.path}: the safety monitor tripped at {time:.3f} s, {why}; every task from then on fails"


def _tuples(value: Any) -> Any:
    """JSON's lists as the tuples that the checks expect."""
    if isinstance(value, list):
        return tuple(_tuples(item) for item in value)
    return {key: _tuples(item) for key, item in value.items()} if isinstance(value, dict) else value


SPAN = 0.2
"""Time over which a rate of the force is taken (s): what a person feels as one rise."""
ASIDE = 0.5e-3
"""Distance (m) from a point within which something is above it."""
ROUNDING = 1e-9
"""Deviation (m) below which nothing but rounding moved the robot sideways."""

Measure = Callable[[TaskRun], float]


def where(mask: Callable[[TaskRun], Mask], measure: Callable[[TaskRun, Mask], float]) -> Measure:
    """`measure` on the samples of `mask`; infinity if there are none, which no bound allows."""

    def measured(run: TaskRun) -> float:
        on = mask(run)
        return measure(run, on) if np.any(on) else math.inf

    return measured


def during(kind: PhaseKind, measure: Callable[[TaskRun, Mask], float]) -> Measure:
    """`measure` on the samples of a phase."""
    return where(lambda run: run.during(kind), measure)


def speed_of_touch(run: TaskRun, on: Mask) -> float:
    """Speed downwards at the first sample in contact (m/s)."""
    touching = np.flatnonzero(on & (run.F_z > 0.0))
    return float(-run.v_z[touching[0]]) if len(touching) else math.inf


def steepness(run: TaskRun, on: Mask) -> float:
    """Largest rate of the force, over the mean rate that was asked for."""
    assert not isinstance(run.task, Tap)
    return response.steepest_rise(run.t[on], run.F_z[on], SPAN) * run.task.build_up / run.task.force


def force_error(run: TaskRun, on: Mask) -> float:
    """Root mean square of the true force minus its final reference (N)."""
    return response.rms(run.F_z[on] - run.task.force)


def distance(run: TaskRun, on: Mask) -> float:
    """Largest distance from the point (m)."""
    return float(np.max(np.linalg.norm(run.p_B[on, :2] - run.task.point, axis=1)))


def share_not_held(run: TaskRun, on: Mask) -> float:
    """Share of the programmed time in which the force is not there."""
    assert isinstance(run.task, Press)
    reached = on & (np.abs(run.F_z - run.task.force) <= BAND * run.task.force)
    return 1.0 - float(np.count_nonzero(reached) * (run.t[1] - run.t[0])) / run.task.hold


def slowness(run: TaskRun) -> float:
    """By how much the taps are slower than asked for when they touch, as a share."""
    assert isinstance(run.task, Tap)
    return 1.0 + float(np.mean(run.v_z[run.touches])) / run.task.speed if len(run.touches) else math.inf


def height_before(run: TaskRun) -> float:
    """Least height from which a tap goes down to where it touches, over the lift asked for; 0 beside the point."""
    assert isinstance(run.task, Tap)
    heights = []
    for tap in run.taps:
        hits = np.flatnonzero(run.F_z[tap] > 0.0)
        if len(hits):
            start, touch = run.p_B[tap.start], run.p_B[tap.start + hits[0]]
            above = math.dist(start[:2], run.task.point) <= ASIDE
            heights.append(float(start[2] - touch[2]) / run.task.lift if above else 0.0)
    return min(heights, default=-math.inf)


def mean_peak(run: TaskRun) -> float:
    """Mean of the taps' peaks over the force asked for."""
    return float(np.mean(run.peaks)) / run.task.force if len(run.peaks) else math.inf


def peak_variation(run: TaskRun) -> float:
    """Coefficient of variation of the taps' peaks."""
    return response.variation(run.peaks) if len(run.peaks) > 1 else math.inf


def unrest(run: TaskRun) -> float:
    """Largest deviation of the time from touch to touch, as a share of the period."""
    assert isinstance(run.task, Tap)
    gaps = [b - a for a, b in pairwise(run.t[run.touches])]
    return max((abs(gap / run.task.period - 1.0) for gap in gaps), default=math.inf)


def taps_missing(run: TaskRun) -> float:
    """How many of the taps asked for do not touch and leave."""
    assert isinstance(run.task, Tap)
    return float(run.task.times - run.whole_taps)


def _circle(run: TaskRun, on: Mask) -> tuple[float, float, float]:
    """(x, y, r) of the circle fitted to the trace (m)."""
    return response.fitted_circle(run.p_B[on, 0], run.p_B[on, 1])


def radius(run: TaskRun, on: Mask) -> float:
    """Fitted radius over that asked for."""
    assert isinstance(run.task, Roll)
    return _circle(run, on)[2] / run.task.radius


def eccentricity(run: TaskRun, on: Mask) -> float:
    """Distance of the fitted centre from the point (m)."""
    x, y, _ = _circle(run, on)
    return math.dist((x, y), run.task.point)


def unroundness(run: TaskRun, on: Mask) -> float:
    """Root mean square distance from the fitted circle, over its radius."""
    x, y, radius = _circle(run, on)
    return response.rms(np.hypot(run.p_B[on, 0] - x, run.p_B[on, 1] - y) - radius) / radius


def turns_missing(run: TaskRun, on: Mask) -> float:
    """By how many turns the trace has gone round the point too few or too many."""
    assert isinstance(run.task, Roll)
    return abs(run.task.turns - response.turns_about(run.p_B[on, 0], run.p_B[on, 1], run.task.point))


def off_line(run: TaskRun, on: Mask) -> response.Curve:
    """Signed distance from the line (m)."""
    assert isinstance(run.task, Push)
    return response.along_and_off(run.p_B[on, :2], run.task.point, run.task.to)[1]


def mirrored(deviation: Measure) -> Callable[[TaskRun], str]:
    """Why a deviation says nothing: on a point or line of the robot's own symmetry there is none, whatever it does."""
    return lambda run: "0 by the robot's own symmetry" if deviation(run) < ROUNDING else ""


def line_missing(run: TaskRun, on: Mask) -> float:
    """Share of the line that is left when the push ends."""
    assert isinstance(run.task, Push)
    along, _ = response.along_and_off(run.p_B[on, :2], run.task.point, run.task.to)
    return 1.0 - float(along[-1]) / math.dist(run.task.point, run.task.to)
