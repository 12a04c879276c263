"""The machine that walks through a table of phases (Sec. III.B) and turns it into references."""

import math

import numpy as np

from twin.compiled.function import njit
from twin.controller.motion import motion, motion_time, smooth
from twin.controller.program import PhaseKind, Until
from twin.cosim.port import record

MACHINE = record(
    index="i8",
    passes="i8",
    entered="f8",
    total="f8",
    length="f8",
    start="3f8",
    end="3f8",
    p="3f8",
    v="3f8",
    F_start="f8",
    F_ref="f8",
    contact_force="f8",
    lost="f8",
    patience="f8",
    tapped="f8",
    touching="i8",
    z_before="f8",
    F_before="f8",
    z_felt="f8",
    depth="f8",
    calibrated="i8",
    z_turn="f8",
    z_lowest="f8",
    t_turn="f8",
    learning="f8",
)
"""State of the machine, SI.

index, passes: phase, and how often a loop's end was passed. entered, total: when the phase began and how long it takes.
length, start, end: of its line. p, v: reference. F_start, F_ref: force reference at the beginning, and now.
contact_force: what counts as touching. lost, patience: how long nothing was touched, and how long that is tolerated.
tapped: when the last tap began.
touching, z_before, F_before, z_felt: whether contact has been felt since the way down began, height and force at the
last call, and the height at which it was felt.
depth, calibrated: from there to the lowest point, and whether the first tap has told it.
z_turn: height at which a tap is to be lowest. z_lowest: reached in it.
t_turn: how long before it a tap has to turn round. learning: share of the error that the next one corrects.
"""

LONGEST_TURN = 0.1
"""Bound of t_turn (s): five times what the slowest drive takes to reverse."""


@njit(cache=True)
def enter_line(m, phase):
    """Lay the phase's line from the present reference to its end."""
    squared = 0.0
    for i in range(3):
        m.start[i] = m.p[i]
        m.end[i] = m.p[i] if math.isnan(phase.target[i]) else phase.target[i]
        if i == 2 and phase.lift > 0.0:
            m.end[2] = m.z_turn + phase.lift
        squared += (m.end[i] - m.start[i]) ** 2
    m.length = math.sqrt(squared)


@njit(cache=True)
def enter(m, phases, index, t, F_z, dp_z):
    """Begin phase `index` at `t` (s) from the present reference, at the pressing force `F_z` (N).

    Where the force loop ends, its correction `dp_z` (m) stays in the reference, so that this does not jump.
    """
    before, phase = phases[m.index], phases[index]
    if before.force_on and not phase.force_on:
        m.p[2] += dp_z
    m.index, m.entered, m.lost = index, t, 0.0
    if phase.task != before.task:
        # a task that was cut short had passes to go
        m.passes = 0
    enter_line(m, phase)
    # the force reference starts where the force is, so the force loop starts without a jump
    m.F_start = m.F_ref if before.force_on else max(F_z, 0.0)
    m.total = max(motion_time(phase, m.length), phase.duration)
    if phase.period > 0.0:
        m.total = max(0.0, m.tapped + phase.period - t)
    if phase.kind == PhaseKind.TAP:
        m.tapped, m.z_lowest = t, np.inf
    if phase.kind == PhaseKind.TAP or phase.kind == PhaseKind.DESCEND:
        m.touching = 0


@njit(cache=True)
def _following(m, phase, t, h, z, v_z, F_z, F_rate):
    """Index of the phase that is due now; the present one if it goes on."""
    over = t - m.entered > m.total - 0.5 * h
    if phase.until == Until.FELT:
        if F_z >= phase.level:
            return phase.next
        return phase.otherwise if over else m.index
    if phase.until == Until.TURN:
        # between this call and the next, of which `walk` makes the right moment
        reached = z + v_z * (m.t_turn + h) <= m.z_turn
        if (reached and (m.touching or not m.calibrated)) or F_z + F_rate * m.t_turn >= phase.level:
            return phase.next
        return phase.otherwise if over else m.index
    if phase.force_on and phase.kind != PhaseKind.RELEASE:
        m.lost = m.lost + h if F_z < 0.5 * m.contact_force else 0.0
        if m.lost > m.patience:
            return phase.otherwise
    if not over:
        return m.index
    if phase.times > 1:
        m.passes += 1
        if m.passes < phase.times:
            return phase.again
        m.passes = 0
    return phase.next


@njit(cache=True)
def _time_to_turn(m, phase, z, h):
    """How long (s, at most `h`) a tap that is to turn round before the next call may still go on; 0: none does."""
    if phase.until != Until.TURN or m.v[2] >= 0.0:
        return 0.0
    return min(max((m.z_turn - z) / m.v[2] - m.t_turn, 0.0), h)


@njit(cache=True)
def _feel(m, phase, t, z, F):
    """Note where on its way down the platform meets the surface, which may have moved since the last tap.

    The unfiltered force `F` (N) is taken, because a low-pass would find contact deeper the faster the way down. It
    holds the inertia of the platform, so nothing is felt while that gets to speed. What is left of it, the robot's own
    compliance makes a tap feel the surface too late; the first tap after a probe tells by how much.
    """
    if not m.touching and F >= m.contact_force and t - m.entered >= phase.ramp_in:
        m.touching = 1
        # where contact was there before the platform was at its speed, nothing can be said of the place
        if m.F_before < m.contact_force:
            share = (m.contact_force - m.F_before) / (F - m.F_before)
            m.z_felt = m.z_before + share * (z - m.z_before)
            if phase.kind == PhaseKind.TAP:
                if m.calibrated:
                    m.z_turn = m.z_felt - m.depth
                else:
                    m.depth, m.calibrated = m.z_felt - m.z_turn, 1
    m.z_before, m.F_before = z, F


@njit(cache=True)
def _turn_within(m, phase, t, h, rest):
    """Turn round `rest` seconds after `t`, before the next call at `t + h`.

    The command is held until then, so its speed is the mean of down and up: a turn at the call before or after would
    miss the depth by up to h times the speed.
    """
    down = m.v[2]
    m.p[2] += down * rest
    enter_line(m, phase)
    m.entered = t + rest
    m.total = max(motion_time(phase, m.length), phase.duration)
    m.p[2] -= down * rest
    m.v[2] = (down * rest + phase.speed * (h - rest)) / h


@njit(cache=True)
def walk(m, phases, t, h, z, F, F_z, F_rate, F_delay, dp_z):
    """Advance to `t` (s): phase, references `m.p` (m), `m.v` (m/s) and `m.F_ref` (N).

    Args:
        h: time since the last call (s).
        z: estimated height of the platform (m).
        F: pressing force (N).
        F_z, F_rate: low-passed, its rate (N/s).
        F_delay: by how much F_z lags F (s).
        dp_z: correction of the force loop (m).
    """
    if m.index < 0:
        enter(m, phases, 0, t, F_z, dp_z)
    phase = phases[m.index]
    m.z_lowest = min(m.z_lowest, z)
    _feel(m, phase, t, z, F)
    following = _following(m, phase, t, h, z, m.v[2], F_z, F_rate)
    if following != m.index:
        if phase.kind == PhaseKind.PROBE:
            m.z_turn, m.calibrated = z - m.v[2] * F_delay, 0
        if phase.kind == PhaseKind.RISE:
            late = (m.z_turn - m.z_lowest) / phase.speed
            m.t_turn = min(max(m.t_turn + m.learning * late, 0.0), LONGEST_TURN)
        rest = _time_to_turn(m, phase, z, h)
        enter(m, phases, following, t, F_z, dp_z)
        if rest > 0.0:
            _turn_within(m, phases[m.index], t, h, rest)
            return
        phase = phases[m.index]
    elapsed = t - m.entered
    motion(phase, m.start, m.end, m.length, elapsed, m.p, m.v)
    share = smooth(elapsed / phase.duration) if phase.duration > 0.0 else 1.0
    m.F_ref = m.F_start + share * (phase.F_end - m.F_start) if phase.force_on else 0.0
