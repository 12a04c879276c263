"""Numbers of a run while it holds a force: error, overshoot, settling, chatter, and what the drives deliver.

With F the true pressing force, R its reference and e = F - R, row by row, in compiled code:

- s0 is the first row with the force loop on at or after the first touch (F > 0).
- Held rows. With tasks: phases hold, circle and push. Without: the loop is on, 2 s have passed since s0, and R has not
  moved for 2 s. R must be positive. A fixed time, not "from settling on": the interval must not depend on the run that
  is judged.
- Overshoot: largest e in the 2 s from s0 on; of a task the largest F less its force, from its first row with the loop
  on to 1 s after its first held row.
- Settling: from s0 to the row after the last |e| > 5 % of R before the first hold ends.
- Chatter: e of held rows through two first-order high-passes in series, begun anew with each hold. Discretised by the
  trapezoidal rule: y_k (1 + w) = x_k - x_(k-1) + (1 - w) y_(k-1), w = pi f dt. Amplitude: sqrt(2) times the rms.

Nothing counts from the first row on in which the safety monitor has tripped.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import takewhile
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from twin.kernel.compiled.function import carray, njit
from twin.kernel.compiled.native import entry
from twin.kernel.cosim.port import memory_of, record
from twin.kernel.errors import InputRefused
from twin.robot.controller.program import PhaseKind
from twin.robot.experiment.experiment import Experiment
from twin.robot.mechanism.geometry import Geometry, geometry_of
from twin.robot.mechanism.kinematics import jacobian

UNDER_FORCE = (PhaseKind.HOLD, PhaseKind.CIRCLE, PhaseKind.PUSH)
"""Phases in which a task holds its force."""
GRACE = 2.0
"""Time (s) to reach the force in a run without tasks, from the first touch and from each step of the reference."""
TASK_GRACE = 1.0
"""Time (s) after the first held row of a task in which its overshoot is still looked for."""
BAND = 0.05
"""Share of the reference within which the force has settled."""
UNMOVED = 1e-9
"""Largest change of the reference (N) from row to row that is rounding."""
HIGH_PASS = 2.0
"""Corner frequency (Hz) of the filter that tells chatter from slow changes of the force."""
HYSTERESIS = 0.025
"""Half width (N) of the band that a swing has to cross to be counted: half a step of the paper's scale."""

SIGNALS = {
    "plant.F_ee_B": 3, "plant.p_B": 3, "controller.triggered": 1, "controller.F_z_ref": 1, "controller.p_ref_B": 3,
    "controller.p_cmd_B": 3, "controller.task": 1, "controller.phase": 1, "monitor.reason": 1, "plant.tau_load": 3,
    "drive.omega_m": 3, "drive.tau_motor": 3, "drive.current": 3, "drive.power": 3,
}  # fmt: skip
"""Signals that are looked at, and their sizes; those of drives are of all three."""
_F, _P, _ON, _R, _REF, _CMD, _TASK, _PHASE, _TRIP, _LOAD, _OMEGA, _TORQUE, _CURRENT, _POWER = (
    int(start) for start in np.cumsum([0, *SIGNALS.values()])[:-1]
)
WIDTH = sum(SIGNALS.values())
SUBSTITUTES = {"controller.p_ref_B": ("reference.p_ref_B",), "monitor.reason": ("monitor.tripped",)}
"""Signals that stand for one that a third-party part does not have."""

_SUMS = record(
    # constants
    dt="f8", every="f8", grace="f8", task_grace="f8", force_loop="f8", reference="f8", band="f8", w="f8",
    # of the run
    rows="f8", touched="f8", s0="f8", R_0="f8", unmoved="f8", R_last="f8", tripped="f8", torque="f8", load="f8",
    current="f8", power="f8", power_last="f8", energy="f8", work="f8", work_last="f8",
    # of held rows
    count="f8", error="f8", squares="f8", first="f8", last="f8", above="f8", outside="f8", ended="f8", first_last="f8",
    lateral="f8", z="f8", p_B="3f8",
    # of one hold, and of the worst
    x_1="f8", y_1="f8", y_2="f8", swings="f8", span="f8", sign="f8", ups="f8", worst="f8", frequency="f8",
)  # fmt: skip
_TASK_SUMS = 13
"""Of a task: first row with the force loop on, first held row, held rows, sum of e, of e squared, largest F for its
overshoot; at every tick: least and largest F or tap peak, first and last tick, taps, whether the last
row is of a tap, peak of the last tap."""
_HOLD, _CIRCLE, _PUSH, _TAP = (int(phase) for phase in (*UNDER_FORCE, PhaseKind.TAP))


@njit(cache=True, inline="always")
def _value(row, column):
    return row[column] if column >= 0 else np.nan


@njit(cache=True, inline="always")
def _largest(so_far, value):
    """The larger of `so_far` and |value|; NaN does not count."""
    return abs(value) if abs(value) > so_far else so_far


@njit(cache=True, inline="always")
def _end_hold(s):
    """Keep the chatter of the hold that ends if it is the worst so far."""
    if s.span > 0.0:
        square = s.swings / s.span
        if square > s.worst:
            s.worst, s.frequency = square, s.ups / (s.span * s.dt)
        if s.ended == 0.0:
            s.ended, s.first_last = 1.0, s.last
    s.span = 0.0


@njit(cache=True, inline="always")
def _swing(s, e):
    """Take one value of a hold into its chatter."""
    if s.span == 0.0:
        s.y_1 = s.y_2 = s.swings = s.sign = s.ups = 0.0
        s.x_1 = e
    y_1 = (e - s.x_1 + (1.0 - s.w) * s.y_1) / (1.0 + s.w)
    y_2 = (y_1 - s.y_1 + (1.0 - s.w) * s.y_2) / (1.0 + s.w)
    s.x_1, s.y_1, s.y_2 = e, y_1, y_2
    s.swings += y_2 * y_2
    s.span += 1.0
    if y_2 > HYSTERESIS:
        if s.sign <= 0.0:
            s.ups += 1.0
        s.sign = 1.0
    elif y_2 < -HYSTERESIS:
        s.sign = -1.0


@njit(cache=True, inline="always")
def _drives(s, row, column):
    """Take what the drives deliver in a row; work and energy of a row last until the next one."""
    s.work += s.work_last * s.dt
    s.energy += s.power_last * s.dt
    s.work_last = s.power_last = 0.0
    for j in range(3):
        load = _value(row, column[_LOAD + j])
        shaft_power = load * _value(row, column[_OMEGA + j])
        if not shaft_power <= 0.0:
            s.work_last += shaft_power
        s.power_last += _value(row, column[_POWER + j])
        s.load = _largest(s.load, load)
        s.torque = _largest(s.torque, _value(row, column[_TORQUE + j]))
        s.current = _largest(s.current, _value(row, column[_CURRENT + j]))


@njit(cache=True, inline="always")
def _task(t, k, F, e, on, held, grace):
    """Take a row of a task into its sums `t`."""
    if on and t[0] < 0.0:
        t[0] = k
    if held:
        if t[1] < 0.0:
            t[1] = k
        t[2] += 1.0
        t[3] += e
        t[4] += e * e
    if t[0] >= 0.0 and (t[1] < 0.0 or k <= t[1] + grace) and F > t[5]:
        t[5] = F


@njit(cache=True, inline="always")
def _extremes(t, tick, F, phase):
    """Take a tick of a task into the extremes of its force `t`; a tap lasts until the next one begins."""
    tap = phase == _TAP
    if tap and t[11] == 0.0:
        # the least peak so far is of taps that are over
        if t[10] > 0.0:
            t[6] = min(t[6], t[12])
        t[10] += 1.0
        t[12] = 0.0
    t[11] = 1.0 if tap else 0.0
    if t[10] > 0.0:
        t[12] = max(t[12], F)
        t[7] = max(t[7], F)
    if phase in (_HOLD, _CIRCLE, _PUSH):
        t[6], t[7] = min(t[6], F), max(t[7], F)
    elif not tap:
        return
    if t[8] < 0.0:
        t[8] = tick
    t[9] = tick


@entry("nothing", "doubles", "int", "int", "integers", "int", _SUMS, "doubles", "int")
def _add_up(rows, count, width, columns, start, s, task_sums, number_of_tasks):
    table, column = carray(rows, (count, width)), carray(columns, WIDTH)
    tasks = carray(task_sums, (number_of_tasks, _TASK_SUMS))
    every = int(s.every)
    for i in range(count):
        row = table[i]
        F = -_value(row, column[_F + 2])
        task, phase = 0.0, 0.0
        if number_of_tasks > 0:
            task, phase = _value(row, column[_TASK]), _value(row, column[_PHASE])
            if 1.0 <= task <= number_of_tasks:
                _extremes(tasks[int(task) - 1], start + i, F, phase)
        if s.tripped > 0.0 or (start + i) % every != 0:
            continue
        if _value(row, column[_TRIP]) > 0.0:
            s.tripped = 1.0
            _end_hold(s)
            continue
        k = s.rows
        s.rows += 1.0
        _drives(s, row, column)
        if F > 0.0:
            s.touched = 1.0
        on = s.touched if column[_ON] < 0 else _value(row, column[_ON])
        R = s.reference if column[_R] < 0 else _value(row, column[_R])
        s.unmoved = s.unmoved + 1.0 if k > 0.0 and abs(R - s.R_last) <= UNMOVED else 0.0
        s.R_last = R
        e = F - R
        if s.s0 < 0.0 and s.touched > 0.0 and on > 0.0 and s.force_loop > 0.0:
            s.s0, s.R_0 = k, R
        if number_of_tasks > 0:
            held = phase in (_HOLD, _CIRCLE, _PUSH) and 1.0 <= task <= number_of_tasks and R > 0.0
            if 1.0 <= task <= number_of_tasks:
                _task(tasks[int(task) - 1], k, F, e, on > 0.0, held, s.task_grace)
        else:
            held = 0.0 <= s.s0 <= k - s.grace and on > 0.0 and s.unmoved >= s.grace and R > 0.0
            if 0.0 <= s.s0 and k < s.s0 + s.grace and e > s.above:
                s.above = e
            if 0.0 <= s.s0 and s.ended == 0.0 and (held or s.count == 0.0) and abs(e) > s.band * R:
                s.outside = k
        if not held:
            _end_hold(s)
            continue
        if s.count == 0.0:
            s.first = k
        s.last = k
        s.count += 1.0
        s.error += e
        s.squares += e * e
        p_x, p_y, p_z = _value(row, column[_P]), _value(row, column[_P + 1]), _value(row, column[_P + 2])
        off_x, off_y = p_x - _value(row, column[_REF]), p_y - _value(row, column[_REF + 1])
        off_z = p_z - _value(row, column[_CMD + 2])
        s.lateral += off_x * off_x + off_y * off_y
        s.z += off_z * off_z
        s.p_B[0] += p_x
        s.p_B[1] += p_y
        s.p_B[2] += p_z
        _swing(s, e)


class HoldRequest(NamedTuple):
    """What an experiment asks of its force, as far as its measures need it.

    Attributes:
        force_loop: whether the force is controlled.
        forces, kinds: force (N) and kind of each task; empty if way points lead the robot.
        reference: force of the file (N), for a controller that does not report its own; NaN if there is none.
        thinned: whether rows are recorded at the controller's period only; the measures are of these rows.
        every: ticks from one looked-at row to the next.
        geometry: lengths of the true robot.
        stiffness: k_s N^2 eta of its springs, seen from the proximal links (N m/rad).
    """

    force_loop: bool
    forces: tuple[float, ...] = ()
    kinds: tuple[str, ...] = ()
    reference: float = math.nan
    thinned: bool = False
    every: int = 1
    geometry: Geometry | None = None
    stiffness: float = math.nan

    @staticmethod
    def of(experiment: Experiment) -> "HoldRequest":
        """The request of an experiment."""
        asked = experiment.controller.force.reference
        thinned = experiment.recording.rate == "controller"
        return HoldRequest(
            experiment.controller.mode == "force_position",
            tuple(task.force for task in experiment.tasks),
            tuple(task.kind for task in experiment.tasks),
            math.nan if asked is None else asked,
            thinned,
            experiment.controller_ticks if thinned else 1,
            geometry_of(experiment.plant),
            experiment.plant.k_s * experiment.plant.N**2 * experiment.plant.eta,
        )

    @staticmethod
    def recorded(values: Mapping[str, Any]) -> "HoldRequest":
        """The request of a recorded experiment.

        Args:
            values: its values, keys with units.
        """
        controller, plant = values.get("controller", {}), values.get("plant", {})
        lengths = [1e-3 * plant.get(f"{name}_mm", math.nan) for name in Geometry._fields]
        return HoldRequest(
            controller.get("mode") == "force_position",
            tuple(task["force_N"] for task in values.get("task", ())),
            tuple(task["kind"] for task in values.get("task", ())),
            controller.get("force", {}).get("reference_N", math.nan),
            values.get("recording", {}).get("rate") == "controller",
            geometry=Geometry(*lengths) if np.isfinite(lengths).all() else None,
            stiffness=math.prod(plant.get(key, math.nan) for key in ("k_s_Nm_per_rad", "N", "N", "eta")),
        )


@dataclass(frozen=True)
class HeldForces:
    """The true pressing force of one task; None if it was never held.

    Attributes:
        task: its number, counted from 1.
        kind: press, tap, roll or push.
        force: asked for (N).
        taps: number of taps.
        least, largest: extremes of the force while it is held, or of the peaks of taps (N).
        begin, end: first and last time of that (s).
        error, mean_error: rms and mean of the force minus its reference while it is held (N); None for taps.
        overshoot: largest force beyond the task's, as a share of it, until 1 s after it begins to be held.
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


class Layout(Protocol):
    """Rows of signals: a system, or a run that is read."""

    @property
    def tick(self) -> float:
        """Time from row to row (s)."""

    def has(self, end: str) -> bool:
        """Whether a row has the signal."""

    def columns(self, end: str) -> slice:
        """Columns of a signal that a row has."""


def signal_columns(layout: Layout, name: str, size: int) -> NDArray[np.int64]:
    """Columns of a signal, or of what third-party parts have in its place, (size,); -1 where rows have neither."""
    if name.startswith("drive."):
        each = [name.replace("drive", f"drive_{joint}", 1) for joint in (1, 2, 3)]
        if all(map(layout.has, each)):
            return np.array([layout.columns(one).start for one in each])
    found = next(filter(layout.has, (name, *SUBSTITUTES.get(name, ()))), None)
    if found is None:
        return np.full(size, -1)
    columns = layout.columns(found)
    return np.arange(columns.start, columns.stop) if columns.stop - columns.start == size else np.full(size, -1)


class HoldSums:
    """The sums behind the measures of a held force. How rows are sliced makes no difference, not even to the last bit.

    Args:
        layout: of the rows.
        request: of the experiment.
    """

    def __init__(self, layout: Layout, request: HoldRequest):
        self._tick, dt = layout.tick, layout.tick * request.every
        self._columns = np.concatenate([signal_columns(layout, *signal) for signal in SIGNALS.items()])
        self.request = request
        self._memory = memory_of(
            _SUMS, dt=dt, every=request.every, grace=round(GRACE / dt), task_grace=round(TASK_GRACE / dt),
            force_loop=request.force_loop, reference=request.reference, band=BAND, w=math.pi * HIGH_PASS * dt,
            s0=-1.0, torque=-1.0, load=-1.0, current=-1.0, outside=-1.0, worst=-1.0,
        )  # fmt: skip
        self._tasks = np.zeros((len(request.forces), _TASK_SUMS))
        self._tasks[:, [0, 1, 8]] = -1.0
        self._tasks[:, 6], self._tasks[:, 7] = math.inf, -math.inf

    def has(self, name: str) -> bool:
        """Whether rows have the signal `name`, one of `SIGNALS`."""
        before = takewhile(lambda key: key != name, SIGNALS)
        return bool(self._columns[sum(SIGNALS[key] for key in before)] >= 0)

    def __getitem__(self, name: str) -> float:
        """A sum by its name in `_SUMS`."""
        return float(self._memory[name][0])

    @property
    def state(self) -> NDArray[np.float64]:
        """All sums (n,), for a saved state."""
        return np.concatenate([self._memory.view(np.float64), self._tasks.ravel()])

    @state.setter
    def state(self, values: NDArray[np.float64]) -> None:
        size = self._memory.view(np.float64).size
        if values.shape != (size + self._tasks.size,):
            raise InputRefused("the state has other sums than the measures of a run are made of")
        self._memory.view(np.float64)[:] = values[:size]
        self._tasks.flat[:] = values[size:]

    def take(self, first: int, rows: NDArray[np.float64]) -> None:
        """Add rows.

        Args:
            first: tick of the first row.
            rows: (n, width).
        """
        rows = np.ascontiguousarray(rows)
        _add_up(rows, *rows.shape, self._columns, first, self._memory, self._tasks, len(self._tasks))

    @property
    def settling(self) -> float | None:
        """Settling time (s); None if the force is outside its band when the first hold ends, or nothing was held."""
        m = self._memory[0]
        if not m["count"]:
            return None
        last = m["first_last"] if m["ended"] else m["last"]
        return None if m["outside"] >= last else float(max(0.0, m["outside"] + 1.0 - m["s0"]) * m["dt"])

    @property
    def felt_stiffness(self) -> float | None:
        """Stiffness (N/m) along z that the springs give the platform at its mean position while held: z of
        J^T k_s N^2 eta J, as tau_l = k_s N eta (theta_m - N theta_l) (Eq. 18 to 20), dtheta_l = J dp_B, F = J^T tau_l.
        None if nothing was held or the robot is not known."""
        m = self._memory[0]
        if not m["count"] or self.request.geometry is None:
            return None
        J_z = jacobian(self.request.geometry, m["p_B"] / m["count"])[:, 2]
        return float(self.request.stiffness * (J_z @ J_z))

    @property
    def chatter(self) -> tuple[float, float]:
        """(amplitude (N), frequency (Hz)) of the hold that chatters most; both 0 if nothing was held."""
        m = self._memory[0]
        found = [(m["worst"], m["frequency"])] if m["worst"] >= 0.0 else []
        if m["span"]:
            found.append((m["swings"] / m["span"], m["ups"] / (m["span"] * m["dt"])))
        square, frequency = max(found, default=(0.0, 0.0))
        return math.sqrt(2.0 * square), float(frequency)

    @property
    def tasks(self) -> tuple[HeldForces, ...]:
        """Each task, in their order; empty if the controller does not report which task is on."""
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
