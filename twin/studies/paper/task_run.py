"""Tasks of a run (Fig. 5) as curves of the true motion and force."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.kernel.errors import InputRefused
from twin.kernel.recording.reader import Recording
from twin.robot.assembly.declared import DECLARED_TABLES
from twin.robot.controller.program import TASK_KINDS, PhaseKind, Task
from twin.robot.experiment.recorded import recorded_values
from twin.robot.experiment.schema import checked_tasks
from twin.robot.monitor.reasons import REASON_TEXTS, Reason
from twin.robot.run.view import RunView, held_samples
from twin.studies.metrics import response
from twin.studies.metrics.required_series import FIG5_SERIES, missing_series

Mask = NDArray[np.bool_]
TAP_SHARE = 0.1
"""Minimum share of the pre-defined force that counts as a tap."""


def _cached_curve(of: "Callable[[TaskRun], response.Curve]") -> "cached_property[response.Curve]":
    return cached_property(of)


@dataclass(frozen=True)
class TaskRun:
    """One massage task of a run as curves, from its first phase to its last; empty if the run never reached it.

    Curves are (n,) or (n, 3), SI, at the plant's ticks `t`: true pressing force, position and vertical speed upwards.
    The controller's curves are held between its samples, as its commands are. Tasks have numbers from 1.
    """

    recording: RunView
    number: int
    task: Task

    @cached_property
    def _sample_indices(self) -> NDArray[np.int64]:
        """Index of the controller's sample that is valid at each of the plant's ticks of this task."""
        return held_samples(self.recording.time("controller"), self.recording.time("plant"))

    @cached_property
    def _window(self) -> slice:
        on = (self.recording["controller.task"] == self.number) & (self.recording["controller.phase"] != PhaseKind.DONE)
        ticks = np.flatnonzero(on[self._sample_indices])
        return slice(ticks[0], ticks[-1] + 1) if len(ticks) else slice(0, 0)

    def controller_series(self, name: str) -> response.Curve:
        """Return a series of the controller, held at the plant's ticks of this task."""
        return self.recording[f"controller.{name}"][self._sample_indices[self._window]]

    t = _cached_curve(lambda run: run.recording.time("plant")[run._window])
    F_z = _cached_curve(lambda run: -run.recording["plant.F_ee_B"][run._window, 2])
    p_B = _cached_curve(lambda run: run.recording["plant.p_B"][run._window])
    v_z = _cached_curve(lambda run: run.recording["plant.v_B"][run._window, 2])

    @cached_property
    def phase(self) -> NDArray[np.int64]:
        return self.controller_series("phase").astype(np.int64)

    def phase_mask(self, kind: PhaseKind) -> Mask:
        return self.phase == kind

    @cached_property
    def full_turns(self) -> Mask:
        """Mask of a task's full circles, without the turns that spiral out and back."""
        circling = self.phase_mask(PhaseKind.CIRCLE)
        assert self.task.kind == "roll"
        since = self.t - response.first_time(self.t, circling)
        turn = 1.0 / self.task.rate
        return circling & (since >= turn) & (since <= (1.0 + self.task.turns) * turn)

    @cached_property
    def taps(self) -> list[slice]:
        """Samples of each tap, from its start to the next start, or to the end of the task."""
        tapping = self.phase_mask(PhaseKind.TAP)
        starts = np.flatnonzero(np.diff(tapping.astype(np.int8), prepend=0) > 0)
        return [slice(a, b) for a, b in zip(starts, [*starts[1:], len(self.t)], strict=True)]

    @cached_property
    def peaks(self) -> response.Curve:
        """Largest force of each tap that touches (N)."""
        largest = np.array([self.F_z[tap].max() for tap in self.taps])
        return largest[largest >= TAP_SHARE * self.task.force]

    @cached_property
    def touches(self) -> NDArray[np.int64]:
        """Index of the first sample in contact of each tap that touches."""
        hits = [tap.start + np.flatnonzero(self.F_z[tap] > 0.0) for tap in self.taps]
        return np.array([hit[0] for hit in hits if len(hit)], dtype=np.int64)

    @cached_property
    def whole_taps(self) -> int:
        """Number of taps that touch and then leave the surface."""
        whole = 0
        for tap in self.taps:
            F_z = self.F_z[tap]
            peak = int(np.argmax(F_z))
            whole += bool(F_z[peak] >= TAP_SHARE * self.task.force and np.any(F_z[peak:] <= 0.0))
        return whole

    @property
    def has_monitor(self) -> bool:
        return "monitor.tripped" in self.recording.fields()

    @cached_property
    def has_trip(self) -> bool:
        """Whether the safety monitor tripped before the end of this task."""
        return len(self.t) == 0 or bool(trip_time(self.recording) <= self.t[-1])


def task_runs(recording: Recording) -> list[TaskRun]:
    """Split a recorded run into its massage tasks, in their order."""
    tables = _tuples(settings(recording).get("task", []))
    tasks = tuple(checked_tasks(TASK_KINDS, tables, []).values())
    if tasks and (missing := missing_series(FIG5_SERIES, recording.fields())):
        raise InputRefused(
            f"{recording.path}: no {', '.join(missing)}; Fig. 5 is judged phase by phase of each task, so the "
            "controller has to put these out"
        )
    if not tasks:
        raise InputRefused(
            f"{recording.path}: holds no task; Fig. 5 needs a run of [[task]] tables, such as experiments/pressing.toml"
        )
    return [TaskRun(recording, number, task) for number, task in enumerate(tasks, start=1)]


def settings(run: RunView) -> dict[str, Any]:
    """Return the checked values of the experiment in a recorded run, keys with units."""
    path = run.path if isinstance(run, Recording) else Path("run in memory")
    return recorded_values(DECLARED_TABLES, run.metadata, path)


def drive_of(recording: Recording) -> str:
    """Return the name of a recorded run's drive, e.g. `velocity_servo`; `stepper+velocity_servo` if joints differ."""
    drive = settings(recording).get("drive", {})
    tables = [drive, *(table for table in drive.values() if isinstance(table, dict))]
    return "+".join(sorted({Path(table["fmu"]).stem for table in tables if "fmu" in table})) or "parts"


def body_of(recording: Recording) -> str:
    """Return the name of a recorded run's body, e.g. `back`; `scale` or `skin` if no body file was named."""
    contact = settings(recording).get("contact", {})
    return Path(contact.get("body", contact.get("kind", "unknown"))).stem


def trip_time(recording: RunView) -> float:
    """Return the time of the safety monitor's trip in a run (s); infinity if it never tripped or is missing."""
    if "monitor.tripped" not in recording.fields():
        return np.inf
    return response.first_time(recording.time("monitor"), recording["monitor.tripped"].astype(bool))


def trip_sentence(recording: Recording) -> str:
    """Return a sentence on the safety monitor's trip in a run; "" without a trip."""
    time = trip_time(recording)
    if np.isinf(time):
        return ""
    code = recording["monitor.reason"][np.searchsorted(recording.time("monitor"), time)]
    why = REASON_TEXTS[Reason(int(code))].sentence.removeprefix("joint {joint}: ")
    return f"{recording.path}: the safety monitor tripped at {time:.3f} s, {why}; every task from then on fails"


def _tuples(value: Any) -> Any:
    """Convert JSON's lists to the tuples that the checks of an experiment expect."""
    if isinstance(value, list):
        return tuple(_tuples(item) for item in value)
    return {key: _tuples(item) for key, item in value.items()} if isinstance(value, dict) else value
