"""State machine that steps through a table of phases (Sec. III.B) and computes references.

The reference of a phase moves on straight lines with smooth ends, or on circles with spirals at both ends.
"""

import math

import numpy as np

from twin.kernel.compiled.function import njit
from twin.kernel.cosim.port import record, state, states
from twin.kernel.settings import fields_of_form
from twin.robot.controller.program import PhaseEnd, PhaseKind

MACHINE_RECORD = record(
    index=state("i8", below="/count"),
    **states(
        passes="i8",
        **fields_of_form("f8", "entered total length"),
        **fields_of_form("3f8", "start end p v"),
        **fields_of_form("f8", "F_start F_ref"),
    ),
    contact_force="f8",
    lost=state("f8"),
    patience="f8",
    **states(tapped="f8", touching="i8", **fields_of_form("f8", "z_before F_before z_felt depth"), calibrated="i8"),
    **states(**fields_of_form("f8", "z_turn z_lowest t_turn")),
    learning="f8",
)
"""State of the machine, SI.

index, passes: phase, and number of passes of a loop's end. entered, total: start time and duration of the phase.
length, start, end: line of the phase. p, v: reference. F_start, F_ref: force reference at the beginning, and now.
contact_force: threshold of contact. lost, patience: time without contact, and the tolerated time.
tapped: start time of the last tap.
touching, z_before, F_before, z_felt: whether contact was detected since the descent began, height and force at the
previous call, and height of the contact.
depth, calibrated: distance from contact to the lowest point, and whether the first tap has measured it.
z_turn: planned lowest height of a tap. z_lowest: lowest height reached in it.
t_turn: lead time for reversing a tap. learning: share of the error that the next one corrects.
"""
MAX_TURN_TIME = 0.1
"""Maximum of t_turn (s): five times the reversal time of the slowest drive."""


@njit(cache=True)
def smooth(x):
    """Evaluate the smooth step 3 x^2 - 2 x^3, with zero slope at 0 and 1; 0 before, 1 after."""
    x = min(max(x, 0.0), 1.0)
    return x * x * (3.0 - 2.0 * x)


@njit(cache=True)
def _smooth_area(x):
    """Return the integral of the smooth step 3 x^2 - 2 x^3 from 0 to x <= 1."""
    return x * x * x * (1.0 - 0.5 * x)


@njit(cache=True)
def line_speed(phase, length):
    """Return the speed (m/s) of a phase on a line of `length` (m), reduced if it is too short for both ramps."""
    ramps = phase.ramp_in + phase.ramp_out
    return phase.speed if 2.0 * length >= phase.speed * ramps else 2.0 * length / ramps


@njit(cache=True)
def line_time(phase, length):
    """Return the duration (s) of a phase's motion on a straight line of `length` (m)."""
    if length == 0.0:
        return 0.0
    return length / line_speed(phase, length) + 0.5 * (phase.ramp_in + phase.ramp_out)


@njit(cache=True)
def line_share(phase, length, t):
    """Return path (m) and speed (m/s) along a line of `length` at `t` (s) from the start of the motion.

    The speed rises along `smooth` within ramp_in and falls likewise within ramp_out, so position, speed and
    acceleration are continuous, except that a ramp of 0 is a step in speed.
    """
    total = line_time(phase, length)
    if t >= total or length == 0.0:
        return length, 0.0
    v = line_speed(phase, length)
    # rounding may set t slightly below 0 for a line that begins between two calls; without a ramp that would be t/0
    t = max(t, 0.0)
    if t < phase.ramp_in:
        x = t / phase.ramp_in
        return v * phase.ramp_in * _smooth_area(x), v * smooth(x)
    if t > total - phase.ramp_out:
        x = (total - t) / phase.ramp_out
        return length - v * phase.ramp_out * _smooth_area(x), v * smooth(x)
    return v * (t - 0.5 * phase.ramp_in), v


@njit(cache=True)
def circle_time(phase):
    """Return the duration (s) of a circular motion including the spirals at its start and end."""
    return (phase.turns + 2.0) / phase.rate


@njit(cache=True)
def circle_offset(phase, t):
    """Return the offset (x, y) in m from the centre and velocity (v_x, v_y) in m/s of a circular motion at `t` (s).

    The motion starts and ends at rest in the centre.
    """
    total = circle_time(phase)
    if t <= 0.0 or t >= total:
        return 0.0, 0.0, 0.0, 0.0
    x = min(t, total - t) * phase.rate
    r = phase.radius * smooth(x)
    growth = 6.0 * phase.radius * phase.rate * x * (1.0 - x) if x < 1.0 else 0.0
    if 2.0 * t > total:
        growth = -growth
    omega = 2.0 * np.pi * phase.rate
    c, s = math.cos(omega * t), math.sin(omega * t)
    return r * c, r * s, growth * c - r * omega * s, growth * s + r * omega * c


@njit(cache=True)
def motion_time(phase, length):
    """Return the duration (s) of a phase's motion, on a line of `length` (m) or on its circle."""
    return circle_time(phase) if phase.radius > 0.0 else line_time(phase, length)


@njit(cache=True)
def motion(phase, start, end, length, t, p, v):
    """Compute the reference position `p` (3,) m and velocity `v` (3,) m/s at time `t` (s) since the phase began."""
    for i in range(3):
        p[i], v[i] = start[i], 0.0
    if phase.radius > 0.0:
        x, y, v[0], v[1] = circle_offset(phase, t)
        p[0], p[1] = start[0] + x, start[1] + y
    elif length > 0.0:
        path, speed = line_share(phase, length, t)
        for i in range(3):
            direction = (end[i] - start[i]) / length
            p[i] = end[i] if path == length else start[i] + path * direction
            v[i] = speed * direction


@njit(cache=True)
def enter_line(m, phase):
    """Set the straight line of a new phase, from the present reference to the phase's target."""
    squared = 0.0
    for i in range(3):
        m.start[i] = m.p[i]
        m.end[i] = m.p[i] if math.isnan(phase.target[i]) else phase.target[i]
        if i == 2 and phase.lift > 0.0:
            m.end[2] = m.z_turn + phase.lift
        squared += (m.end[i] - m.start[i]) ** 2
    m.length = math.sqrt(squared)


@njit(cache=True)
def enter_phase(m, phases, index, t, F_z, dp_z):
    """Begin a phase of the task program from the present reference.

    It begins at `t` (s), at the pressing force `F_z` (N). If the force loop ends, its correction `dp_z` (m) is added to
    the reference, which then does not jump.
    """
    before, phase = phases[m.index], phases[index]
    if before.force_on and not phase.force_on:
        m.p[2] += dp_z
    m.index, m.entered, m.lost = index, t, 0.0
    if phase.task != before.task:
        # an aborted task may have passes left
        m.passes = 0
    enter_line(m, phase)
    # the force reference starts at the present force, so the force loop starts without a jump
    m.F_start = m.F_ref if before.force_on else max(F_z, 0.0)
    m.total = max(motion_time(phase, m.length), phase.duration)
    if phase.period > 0.0:
        m.total = max(0.0, m.tapped + phase.period - t)
    if phase.kind == PhaseKind.TAP:
        m.tapped, m.z_lowest = t, np.inf
    if phase.kind == PhaseKind.TAP or phase.kind == PhaseKind.DESCEND:
        m.touching = 0


@njit(cache=True)
def _due_phase(m, phase, t, h, z, v_z, F_z, F_rate):
    """Return the index of the task phase that is due now: the present one or a successor."""
    over = t - m.entered > m.total - 0.5 * h
    if phase.until == PhaseEnd.FELT:
        if F_z >= phase.level:
            return phase.next
        return phase.otherwise if over else m.index
    if phase.until == PhaseEnd.TURN:
        # the turn is due before the next call; `advance_machine` computes its exact time
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
    """Return the time (s) until the reversal of a tap must be commanded, limited to 0 .. `h`, the period of the calls.

    The command leads the planned depth by `m.t_turn`. 0 if the reversal is due now, or if the phase is not the descent
    of a tap; `h` if it is not due before the next call.
    """
    if phase.until != PhaseEnd.TURN or m.v[2] >= 0.0:
        return 0.0
    return min(max((m.z_turn - z) / m.v[2] - m.t_turn, 0.0), h)


@njit(cache=True)
def _detect_surface(m, phase, t, z, F):
    """Detect the height at which the descending platform meets the surface, and derive the tap's turning height.

    The unfiltered force `F` (N) is used, as a low-pass would detect contact deeper the faster the descent. It contains
    the platform's inertia, so detection waits until the platform is at speed. The robot's own compliance still delays
    detection in taps; the first tap after a probe measures by how much.
    """
    if not m.touching and F >= m.contact_force and t - m.entered >= phase.ramp_in:
        m.touching = 1
        # if contact existed before the platform was at speed, its height is unknown
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
    """Reverse a tap between two calls of the controller, `rest` seconds after `t`.

    The command is held until then, so its speed is the mean of down and up: a reversal at the previous or next call
    would miss the depth by up to h times the speed.
    """
    down = m.v[2]
    m.p[2] += down * rest
    enter_line(m, phase)
    m.entered = t + rest
    m.total = max(motion_time(phase, m.length), phase.duration)
    m.p[2] -= down * rest
    m.v[2] = (down * rest + phase.speed * (h - rest)) / h


@njit(cache=True)
def advance_machine(m, phases, t, h, z, F, F_z, F_rate, F_delay, dp_z):
    """Advance the state machine of task phases to `t` (s), and compute its position, velocity and force references.

    Args:
        h: time since the previous call (s).
        z, F: estimated height of the platform (m) and pressing force (N).
        F_z, F_rate: low-passed pressing force (N) and its rate (N/s).
        F_delay: lag of F_z behind F (s).
        dp_z: correction of the force loop (m).
    """
    if m.index < 0:
        enter_phase(m, phases, 0, t, F_z, dp_z)
    phase = phases[m.index]
    m.z_lowest = min(m.z_lowest, z)
    _detect_surface(m, phase, t, z, F)
    following = _due_phase(m, phase, t, h, z, m.v[2], F_z, F_rate)
    if following != m.index:
        if phase.kind == PhaseKind.PROBE:
            m.z_turn, m.calibrated = z - m.v[2] * F_delay, 0
        if phase.kind == PhaseKind.RISE:
            late = (m.z_turn - m.z_lowest) / phase.speed
            m.t_turn = min(max(m.t_turn + m.learning * late, 0.0), MAX_TURN_TIME)
        rest = _time_to_turn(m, phase, z, h)
        enter_phase(m, phases, following, t, F_z, dp_z)
        if rest > 0.0:
            _turn_within(m, phases[m.index], t, h, rest)
            return
        phase = phases[m.index]
    elapsed = t - m.entered
    motion(phase, m.start, m.end, m.length, elapsed, m.p, m.v)
    share = smooth(elapsed / phase.duration) if phase.duration > 0.0 else 1.0
    m.F_ref = m.F_start + share * (phase.F_end - m.F_start) if phase.force_on else 0.0
