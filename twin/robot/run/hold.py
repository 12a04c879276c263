"""Force reference of an experiment, and the sums behind the measures of a held force."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import takewhile
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from twin.kernel.cosim.port import memory_of
from twin.kernel.errors import InputRefused
from twin.robot.controller.program import PhaseKind
from twin.robot.experiment.experiment import Experiment
from twin.robot.mechanism.geometry import Geometry, geometry_of
from twin.robot.mechanism.kinematics import jacobian
from twin.robot.mechanism.statics import platform_stiffness
from twin.robot.plant.hold_sums import HOLD_SIGNALS, SUMS_RECORD, TASK_SUMS, add_up

UNDER_FORCE = (PhaseKind.HOLD, PhaseKind.CIRCLE, PhaseKind.PUSH)
"""Phases of tasks that hold a force."""
TOUCH_GRACE = 2.0
"""Time (s) to reach the force in a run without tasks, from the first touch and from each step of the reference."""
TASK_GRACE = 1.0
"""Search time (s) for the overshoot of a task, from its first held row."""
SETTLING_BAND = 0.05
"""Deviation, as a share of the reference, within which the force has settled."""
HIGH_PASS = 2.0
"""Corner frequency (Hz) of the high-passes that separate chatter from slow changes of the force."""
SIGNAL_SUBSTITUTES = {"controller.p_ref_B": ("reference.p_ref_B",), "monitor.reason": ("monitor.tripped",)}
"""Signals that replace one that a third-party part does not have."""


class HoldRequest(NamedTuple):
    """Force references and robot data of an experiment, as needed by the measures of a held force.

    Attributes:
        force_loop: whether the force is controlled.
        forces, kinds: force (N) and kind of each task; empty if waypoints lead the robot.
        thinned: whether rows are recorded at the controller's period only; the measures then use these rows.
        every: ticks from one evaluated row to the next.
        geometry: lengths of the true robot.
        stiffness: k_s N^2 eta of its springs, seen from the proximal links (N m/rad).
    """

    force_loop: bool
    forces: tuple[float, ...] = ()
    kinds: tuple[str, ...] = ()
    thinned: bool = False
    every: int = 1
    geometry: Geometry | None = None
    stiffness: float = math.nan

    @staticmethod
    def from_experiment(experiment: Experiment) -> "HoldRequest":
        """Collect the force references and robot data that the measures need from an experiment."""
        thinned = experiment.recording.rate == "controller"
        return HoldRequest(
            # a third-party controller has no mode
            experiment.controller.mode in (None, "force_position"),
            tuple(task.force for task in experiment.tasks),
            tuple(task.kind for task in experiment.tasks),
            thinned,
            experiment.controller_ticks if thinned else 1,
            geometry_of(experiment.plant),
            experiment.plant.k_s * experiment.plant.N**2 * experiment.plant.eta,
        )

    @staticmethod
    def from_values(values: Mapping[str, Any]) -> "HoldRequest":
        """Collect the force references and robot data that the measures need from a recorded experiment's values."""
        controller, plant = values.get("controller", {}), values.get("plant", {})
        lengths = [1e-3 * plant.get(f"{name}_mm", math.nan) for name in Geometry._fields]
        return HoldRequest(
            controller.get("mode") in (None, "force_position"),
            tuple(task["force_N"] for task in values.get("task", ())),
            tuple(task["kind"] for task in values.get("task", ())),
            values.get("recording", {}).get("rate") == "controller",
            geometry=Geometry(*lengths) if np.isfinite(lengths).all() else None,
            stiffness=math.prod(plant.get(key, math.nan) for key in ("k_s_Nm_per_rad", "N", "N", "eta")),
        )


@dataclass(frozen=True)
class HeldForces:
    """How a massage task's true pressing force was held: range, error, overshoot; None where it was never held.

    Attributes:
        task: task number, from 1.
        kind: press, tap, roll or push.
        force: requested force (N).
        least, largest: extremes of the force while held, or of the peaks of taps (N).
        begin, end: times of the first and last held row (s).
        error, mean_error: rms and mean of the force minus its reference while held (N); None for taps.
        overshoot: largest excess over the task's force, as a share of it, until 1 s after the hold begins.
    """

    task: int
    kind: str
    force: float
    taps: int = 0
    least: float | None = None
    largest: float | None = None
    begin: float | None = None
    end: float | None = None
    error: float | None = None
    mean_error: float | None = None
    overshoot: float | None = None


class RowLayout(Protocol):
    """Interface of a column layout of signal rows: of a system, or of a recorded run."""

    @property
    def tick(self) -> float:
        """Time from one signal row to the next (s)."""

    def has_output(self, end: str) -> bool:
        """Whether rows have a signal."""

    def columns(self, end: str) -> slice:
        """Return the columns of a signal in a row, which must have it."""


def signal_columns(layout: RowLayout, name: str, size: int) -> NDArray[np.int64]:
    """Return the columns (size,) of a signal in rows, or of a third-party part's substitute; -1 if both are missing."""
    if name.startswith("drive."):
        each = [name.replace("drive", f"drive_{joint}", 1) for joint in (1, 2, 3)]
        if all(map(layout.has_output, each)):
            return np.array([layout.columns(one).start for one in each])
    found = next(filter(layout.has_output, (name, *SIGNAL_SUBSTITUTES.get(name, ()))), None)
    if found is None:
        return np.full(size, -1)
    columns = layout.columns(found)
    return np.arange(columns.start, columns.stop) if columns.stop - columns.start == size else np.full(size, -1)


class HoldSums:
    """The sums behind the measures of a held force, bit-identical however the rows are sliced."""

    def __init__(self, layout: RowLayout, request: HoldRequest):
        self._tick, dt = layout.tick, layout.tick * request.every
        self._columns = np.concatenate([signal_columns(layout, *signal) for signal in HOLD_SIGNALS.items()])
        self.request = request
        self._memory = memory_of(
            SUMS_RECORD, dt=dt, every=request.every, grace=round(TOUCH_GRACE / dt), task_grace=round(TASK_GRACE / dt),
            force_loop=request.force_loop, band=SETTLING_BAND, w=math.pi * HIGH_PASS * dt, hold=PhaseKind.HOLD,
            circle=PhaseKind.CIRCLE, push=PhaseKind.PUSH, tap=PhaseKind.TAP,
            s0=-1.0, torque=-1.0, load=-1.0, current=-1.0, outside=-1.0, worst=-1.0,
        )  # fmt: skip
        self._tasks = np.zeros((len(request.forces), TASK_SUMS))
        self._tasks[:, [0, 1, 8]] = -1.0
        self._tasks[:, 6], self._tasks[:, 7] = math.inf, -math.inf

    def has(self, name: str) -> bool:
        """Whether rows have a signal that the measures of a held force need."""
        before = takewhile(lambda key: key != name, HOLD_SIGNALS)
        return bool(self._columns[sum(HOLD_SIGNALS[key] for key in before)] >= 0)

    def __getitem__(self, name: str) -> float:
        """Return one of the sums behind the measures of a held force, by its name in `SUMS_RECORD`."""
        return float(self._memory[name][0])

    @property
    def state(self) -> NDArray[np.float64]:
        """All sums behind the measures of a held force, (n,), as part of a saved state."""
        return np.concatenate([self._memory.view(np.float64), self._tasks.ravel()])

    @state.setter
    def state(self, values: NDArray[np.float64]) -> None:
        size = self._memory.view(np.float64).size
        if values.shape != (size + self._tasks.size,):
            raise InputRefused("the state has other sums than the measures of a run are made of")
        self._memory.view(np.float64)[:] = values[:size]
        self._tasks.flat[:] = values[size:]

    def add_rows(self, first: int, rows: NDArray[np.float64]) -> None:
        """Add signal rows (n, width), the first of tick `first`, to the sums behind the measures of a held force."""
        rows = np.ascontiguousarray(rows)
        add_up(rows, *rows.shape, self._columns, first, self._memory, self._tasks, len(self._tasks))

    @property
    def holds(self) -> float:
        """Number of times that the force was held, including the hold in progress."""
        return self["ended"] + (self["span"] > 0.0)

    @property
    def settling(self) -> float | None:
        """Settling time of the force (s); None if never held, or outside its band when the first hold ends."""
        m = self._memory[0]
        if not m["count"]:
            return None
        last = m["first_last"] if m["ended"] else m["last"]
        return None if m["outside"] >= last else float(max(0.0, m["outside"] + 1.0 - m["s0"]) * m["dt"])

    @property
    def felt_stiffness(self) -> float | None:
        """Stiffness (N/m) along z that the springs give the platform at its mean position during holds.

        See `platform_stiffness`. None if nothing was held or the robot is unknown.
        """
        m = self._memory[0]
        if not (m["count"] and self.request.geometry and np.isfinite(m["p_B"]).all()):
            return None
        J = jacobian(self.request.geometry, m["p_B"] / m["count"])
        return float(platform_stiffness(J, self.request.stiffness)[2])

    @property
    def chatter(self) -> tuple[float, float]:
        """(amplitude (N), frequency (Hz)) of the hold with the strongest force chatter; both 0 if nothing was held."""
        m = self._memory[0]
        found = [(m["worst"], m["frequency"])] if m["worst"] >= 0.0 else []
        if m["span"]:
            found.append((m["swings"] / m["span"], m["ups"] / (m["span"] * m["dt"])))
        square, frequency = max(found, default=(0.0, 0.0))
        return math.sqrt(2.0 * square), float(frequency)

    @property
    def tasks(self) -> tuple[HeldForces, ...]:
        """Held force of each massage task, in order; empty if the controller does not report the current task."""
        known = self.has("controller.task") and self.has("controller.phase")
        return tuple(self._task(index) for index in range(len(self._tasks) if known else 0))

    def _task(self, index: int) -> HeldForces:
        kind, force = self.request.kinds[index], self.request.forces[index]
        _, _, count, error, squares, above, least, largest, begin, end, taps, _, peak = self._tasks[index].tolist()
        if begin < 0.0:
            return HeldForces(index + 1, kind, force)
        least = min(least, peak) if taps else least
        extremes = HeldForces(
            index + 1, kind, force, int(taps), least, largest, int(begin) * self._tick, int(end) * self._tick
        )
        if not count:
            return extremes
        beyond = max(0.0, above / force - 1.0)
        return replace(extremes, error=math.sqrt(squares / count), mean_error=error / count, overshoot=beyond)
