"""Compiled sums of a held force: error, overshoot, settling, chatter, torque, work and energy of the drives.

With F the true pressing force, R its reference and e = F - R, row by row:

- s0 is the first row with the force loop on at or after the first touch (F > 0).
- Held rows. With tasks: phases hold, circle and push. Without: the loop is on, 2 s have passed since s0, and R has not
  moved for 2 s. R must be positive. The time is fixed, as the interval must not depend on the settling of the
  evaluated run.
- Overshoot: largest e in the 2 s from s0 on; for a task the largest F less its force, from its first row with the loop
  on to 1 s after its first held row.
- Settling: from s0 to the row after the last |e| > 5 % of R before the first hold ends.
- Chatter: e of held rows through two first-order high-passes in series, reset at each hold. Discretised by the
  trapezoidal rule: y_k (1 + w) = x_k - x_(k-1) + (1 - w) y_(k-1), w = pi f dt. Amplitude: sqrt(2) times the rms.

Rows after a trip of the safety monitor do not count.
"""

import numpy as np

from twin.kernel.compiled.function import carray, njit
from twin.kernel.compiled.native import entry
from twin.kernel.cosim.port import record
from twin.robot.plant.deviation import column_value

REFERENCE_ROUNDING = 1e-9
"""Maximum change of the reference (N) from row to row that counts as rounding."""
SWING_HYSTERESIS = 0.025
"""Half width (N) of the band that a counted swing must cross: half a step of the paper's scale."""

HOLD_SIGNALS = {
    "plant.F_ee_B": 3, "plant.p_B": 3, "controller.triggered": 1, "controller.F_z_ref": 1, "controller.p_ref_B": 3,
    "controller.p_cmd_B": 3, "controller.task": 1, "controller.phase": 1, "monitor.reason": 1, "plant.tau_load": 3,
    "drive.omega_m": 3, "drive.tau_motor": 3, "drive.current": 3, "drive.power": 3,
}  # fmt: skip
"""Signals that the sums need, and their sizes; a signal of the drives has one value per drive."""
_F, _P, _ON, _R, _REF, _CMD, _TASK, _PHASE, _TRIP, _LOAD, _OMEGA, _TORQUE, _CURRENT, _POWER = (
    int(start) for start in np.cumsum([0, *HOLD_SIGNALS.values()])[:-1]
)
SIGNALS_WIDTH = sum(HOLD_SIGNALS.values())

SUMS_RECORD = record(
    # constants; the last four are phases of tasks
    dt="f8", every="f8", grace="f8", task_grace="f8", force_loop="f8", band="f8", w="f8", hold="f8",
    circle="f8", push="f8", tap="f8",
    # of the run
    rows="f8", touched="f8", s0="f8", R_0="f8", unmoved="f8", R_last="f8", tripped="f8", torque="f8", load="f8",
    current="f8", power_last="f8", energy="f8", work="f8", work_last="f8",
    # of held rows
    count="f8", error="f8", squares="f8", first="f8", last="f8", above="f8", outside="f8", ended="f8", first_last="f8",
    lateral="f8", z="f8", p_B="3f8",
    # of one hold, and of the worst
    x_1="f8", y_1="f8", y_2="f8", swings="f8", span="f8", sign="f8", ups="f8", worst="f8", frequency="f8",
)  # fmt: skip
TASK_SUMS = 13
"""Number of sums of a task: first row with the force loop on, first held row, held rows, sum of e, of e squared,
largest F for the overshoot; of every tick: least and largest F or tap peak, first and last tick, taps, whether the last
row belongs to a tap, peak of the last tap."""


@njit(cache=True, inline="always")
def _largest(so_far, value):
    """Return the larger of `so_far` and |value|; NaN is ignored."""
    return abs(value) if abs(value) > so_far else so_far


@njit(cache=True, inline="always")
def _end_hold(s):
    """End a hold of the force: keep its chatter if it is the largest of all holds so far."""
    if s.span > 0.0:
        square = s.swings / s.span
        if square > s.worst:
            s.worst, s.frequency = square, s.ups / (s.span * s.dt)
        if s.ended == 0.0:
            s.first_last = s.last
        s.ended += 1.0
    s.span = 0.0


@njit(cache=True, inline="always")
def _swing(s, e):
    """Add one force error of a hold to the sums of its chatter, through two high-passes."""
    if s.span == 0.0:
        s.y_1 = s.y_2 = s.swings = s.sign = s.ups = 0.0
        s.x_1 = e
    y_1 = (e - s.x_1 + (1.0 - s.w) * s.y_1) / (1.0 + s.w)
    y_2 = (y_1 - s.y_1 + (1.0 - s.w) * s.y_2) / (1.0 + s.w)
    s.x_1, s.y_1, s.y_2 = e, y_1, y_2
    s.swings += y_2 * y_2
    s.span += 1.0
    if y_2 > SWING_HYSTERESIS:
        if s.sign <= 0.0:
            s.ups += 1.0
        s.sign = 1.0
    elif y_2 < -SWING_HYSTERESIS:
        s.sign = -1.0


@njit(cache=True, inline="always")
def _drives(s, row, column):
    """Add a row's torque, current, work and energy of the drives to their sums; power is held from row to row."""
    s.work += s.work_last * s.dt
    s.energy += s.power_last * s.dt
    s.work_last = s.power_last = 0.0
    for j in range(3):
        load = column_value(row, column[_LOAD + j])
        shaft_power = load * column_value(row, column[_OMEGA + j])
        if not shaft_power <= 0.0:
            s.work_last += shaft_power
        s.power_last += column_value(row, column[_POWER + j])
        s.load = _largest(s.load, load)
        s.torque = _largest(s.torque, column_value(row, column[_TORQUE + j]))
        s.current = _largest(s.current, column_value(row, column[_CURRENT + j]))


@njit(cache=True, inline="always")
def _task(t, k, F, e, on, held, grace):
    """Add a row to the sums of a task's force error and overshoot."""
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
def _extremes(s, t, tick, F, phase):
    """Update the least and largest force of a task, or of its tap peaks, by one tick."""
    tap = phase == s.tap
    if tap and t[11] == 0.0:
        # the least peak so far includes completed taps only
        if t[10] > 0.0:
            t[6] = min(t[6], t[12])
        t[10] += 1.0
        t[12] = 0.0
    t[11] = 1.0 if tap else 0.0
    if t[10] > 0.0:
        t[12] = max(t[12], F)
        t[7] = max(t[7], F)
    if phase in (s.hold, s.circle, s.push):
        t[6], t[7] = min(t[6], F), max(t[7], F)
    elif not tap:
        return
    if t[8] < 0.0:
        t[8] = tick
    t[9] = tick


@entry("nothing", "doubles", "int", "int", "integers", "int", SUMS_RECORD, "doubles", "int")
def add_up(rows, count, width, columns, start, s, task_sums, number_of_tasks):
    table, column = carray(rows, (count, width)), carray(columns, SIGNALS_WIDTH)
    tasks = carray(task_sums, (number_of_tasks, TASK_SUMS))
    every = int(s.every)
    for i in range(count):
        row = table[i]
        F = -column_value(row, column[_F + 2])
        task, phase = 0.0, 0.0
        if number_of_tasks > 0:
            task, phase = column_value(row, column[_TASK]), column_value(row, column[_PHASE])
            if 1.0 <= task <= number_of_tasks:
                _extremes(s, tasks[int(task) - 1], start + i, F, phase)
        if s.tripped > 0.0 or (start + i) % every != 0:
            continue
        if column_value(row, column[_TRIP]) > 0.0:
            s.tripped = 1.0
            _end_hold(s)
            continue
        k = s.rows
        s.rows += 1.0
        _drives(s, row, column)
        if F > 0.0:
            s.touched = 1.0
        on = s.touched if column[_ON] < 0 else column_value(row, column[_ON])
        R = column_value(row, column[_R])
        s.unmoved = s.unmoved + 1.0 if k > 0.0 and abs(R - s.R_last) <= REFERENCE_ROUNDING else 0.0
        s.R_last = R
        e = F - R
        if s.s0 < 0.0 and s.touched > 0.0 and on > 0.0 and s.force_loop > 0.0:
            s.s0, s.R_0 = k, R
        if number_of_tasks > 0:
            held = phase in (s.hold, s.circle, s.push) and 1.0 <= task <= number_of_tasks and R > 0.0
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
        p_x, p_y, p_z = (
            column_value(row, column[_P]),
            column_value(row, column[_P + 1]),
            column_value(row, column[_P + 2]),
        )
        off_x, off_y = p_x - column_value(row, column[_REF]), p_y - column_value(row, column[_REF + 1])
        off_z = p_z - column_value(row, column[_CMD + 2])
        s.lateral += off_x * off_x + off_y * off_y
        s.z += off_z * off_z
        s.p_B[0] += p_x
        s.p_B[1] += p_y
        s.p_B[2] += p_z
        _swing(s, e)
