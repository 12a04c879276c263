"""Options beside the law of Fig. 3 B: tissue estimate, scheduled gains, compensation of breathing.

All of it is optional and acts through the law: it sets the gains of the force loop, moves its integral and adds a shift
to its reference. A controller without it does not know of it.

Gains of the force loop over the stiffness that is estimated, without bumps.

Between two points of the table 1/gain is linear in the stiffness, because the gain that a loop bears falls with the
stiffness it sees. Where the estimate is poor, the gains go back to those of the experiment's file, the safe set. Both
the stiffness they are taken at and the share that the table has in them change no faster than a rate; but where the
estimate does not fit the force any more, the safe set is back in the same call. A change of kp moves the integral by
what the error makes of it, so that the output does not move (Åström and Hägglund 2006, Advanced PID Control, Sec. 9.4).

A change of the reference is fed forward: the tissue gives way by dF/k, and the springs deflect by dF/k_spring.

A swing of the reference while the tissue is not known well enough: a quiet press teaches `tissue` nothing. It costs
force, so it asks what there is to be gained (dual control; Åström and Wittenmark 1995, Adaptive Control, Ch. 7). While
the reference rises it has its full force; while it stands still it hides beneath the force error that there is, and
rests where there is none, for gains would not improve it; while the reference falls it rests, for the press is over
before anything is learnt.

The breath under the head: an oscillator that locks to it, and feeds its velocity forward.

While pressing, the surface moves at v_0 = dz/dt + (dF/dt)/k, which the oscillator follows. That is a second-order
generalised integrator with a frequency-locked loop (Rodriguez et al. 2011, IEEE Trans. Ind. Electron. 58:127),

    e = v_0 - x,   dx/dt = w (g e - q),   dq/dt = w x,   dw/dt = -f w e q w/(x^2 + q^2),

of which x and q are the velocity and the same a quarter of a breath before, and w is the rate. It knows one sine, no
shape; what comes at the rate of the breath passes it as it is, whatever else moves the surface is damped and turned.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from twin.kernel.compiled.function import carray, njit, pointer_to
from twin.kernel.cosim.port import Port, record, record_of, state, states
from twin.kernel.settings import Settings, Values, alike, numbers, setting, taken
from twin.robot.controller.machine import TAPS
from twin.robot.controller.pid import ForceLoop, ScheduledGains, low_pass_share, state_variable
from twin.robot.controller.tissue import HIGHEST, TISSUE, Sensing, Tissue, sense, unlearn


class SchedulePoint(Values, parts=(taken(ScheduledGains),)):
    """Gains at a stiffness, SI."""


class Scheduling(
    Values, parts=(taken(Tissue, "tolerance"), taken(ForceLoop, "rate", "follow", "kp", "ki")), first="tolerance"
):
    """Settings, SI: up to which standard error over k_hat the estimate is trusted, and how gains follow; kp and ki are
    the safe set."""


POINT = record_of(SchedulePoint)
SCHEDULE = record_of(
    Scheduling, count="i8", segment=state("i8", below="count"), **states(at="f8", share="f8", F_ref="f8")
)
"""Settings and state: number of points, the segment last used, stiffness that the gains are taken at, share of the
table, last reference."""
_points_at = pointer_to(POINT)


def table_of(points: Sequence[SchedulePoint]) -> np.ndarray:
    """The points as the compiled code takes them."""
    return np.array([tuple(point) for point in points], dtype=POINT)


@njit(cache=True, error_model="numpy")
def gains_at(points, segment, k):
    """(kp, ki, segment) at the stiffness `k` (N/m); beyond the ends those of the end.

    Args:
        segment: any; pass the one returned last.
    """
    last = points.shape[0] - 1
    if k <= points[0].stiffness:
        return points[0].kp, points[0].ki, 0
    if k >= points[last].stiffness:
        return points[last].kp, points[last].ki, last - 1
    while k < points[segment].stiffness:
        segment -= 1
    while k > points[segment + 1].stiffness:
        segment += 1
    a, b = points[segment], points[segment + 1]
    share = (k - a.stiffness) / (b.stiffness - a.stiffness)
    rest = 1.0 - share
    return a.kp * b.kp / (rest * b.kp + share * a.kp), a.ki * b.ki / (rest * b.ki + share * a.ki), segment


@njit(cache=True, error_model="numpy")
def schedule_gains(m, table, tissue, pid, h):
    """Put the gains into the force loop `pid` that the `tissue` asks for.

    Args:
        table: address of the points.
    """
    if not tissue.pressing:
        m.share, pid.kp, pid.ki = 0.0, m.kp, m.ki
        return
    trusted = tissue.known and tissue.std <= m.tolerance * tissue.k
    step = m.rate * h
    if trusted:
        # what has no share yet may begin where it likes
        at = m.at if m.share > 0.0 else tissue.k
        m.at = min(max(tissue.k, at * (1.0 - step)), at * (1.0 + step))
    m.share = min(max(1.0 if trusted else 0.0, m.share - step), m.share + step)
    if tissue.std >= tissue.k:
        # nothing is known: not even of how wrong these gains are
        m.share = 0.0
    kp, ki = m.kp, m.ki
    if m.share > 0.0:
        kp, ki, m.segment = gains_at(carray(_points_at(table), m.count), m.segment, m.at)
        kp, ki = m.kp + m.share * (kp - m.kp), m.ki + m.share * (ki - m.ki)
    pid.integral += (pid.kp - kp) * pid.error
    pid.kp, pid.ki = kp, ki


@njit(cache=True, error_model="numpy")
def follow_reference(m, spring, pid, F_ref, pressing, h):
    """Rate (m/s) at which the motors have to go for the reference `F_ref` (N); the integral follows it."""
    change = F_ref - m.F_ref if pressing else 0.0
    m.F_ref = F_ref
    if m.share == 0.0 or change == 0.0:
        return 0.0
    change *= m.follow * m.share
    pid.integral += change / m.at
    return -change * (1.0 / m.at + 1.0 / spring) / h


LARGEST = 5e-4
"""Largest amplitude of the dither (m)."""
HIDDEN = 0.3
"""Amplitude of its force over the rms of the force error without it, at most, while the reference stands still."""
NOTCH = 2.0
"""1/Q of the notch at the dither's frequency: it is over in 1/(2 pi f), as fast as the force error of a quick loop."""
RESTING = 0.05
"""Share of its full force below which it rests."""


@njit(cache=True, error_model="numpy")
def dither(m, h, F, F_ref):
    """(shift of the reference (m), its rate (m/s)) of this call; 0 where the tissue is known well enough.

    Args:
        F, F_ref: pressing force and its reference (N).
    """
    change = F_ref - m.F_ref
    m.F_ref, m.leading, m.falling = F_ref, change != 0.0, change < 0.0
    if m.since == 0.0 or m.dither == 0.0:
        m.off, m.off_squared, m.notch.fast, m.notch.slow = F_ref - F, 0.0, 0.0, F_ref - F
        return 0.0, 0.0
    m.off += m.smoothing * (F_ref - F - m.off)
    _, band, _, m.notch.fast, m.notch.slow = state_variable(NOTCH, m.g, m.notch.fast, m.notch.slow, m.off)
    besides = m.off - NOTCH * band
    m.off_squared += m.averaging * (besides * besides - m.off_squared)
    force = m.dither
    if change < 0.0:
        force = 0.0
    elif change == 0.0:
        force = min(force, HIDDEN * math.sqrt(m.off_squared))
    doubt = m.std / m.k if m.known else HIGHEST
    if not m.dithering and doubt > m.doubtful and force > 2.0 * RESTING * m.dither:
        m.dithering, m.phase, m.sine, m.cosine, m.amplitude = 1, 0.0, 0.0, 1.0, 0.0
        unlearn(m)
    if not m.dithering:
        return 0.0, 0.0
    m.phase += m.omega * h
    # turned on from call to call: sine and cosine themselves would cost a sixth of all that happens here
    m.sine, m.cosine = (
        m.sine * m.turn_cosine + m.cosine * m.turn_sine,
        m.cosine * m.turn_cosine - m.sine * m.turn_sine,
    )
    # it ends with a whole swing
    if m.phase >= 2.0 * math.pi:
        m.phase -= 2.0 * math.pi
        if doubt < m.enough or force < RESTING * m.dither:
            m.dithering, m.phase = 0, 0.0
            return 0.0, 0.0
    # what is not known may be hard
    k = min(m.k + 2.0 * m.std, HIGHEST) if m.known else HIGHEST
    asked = min(force * (1.0 / k + 1.0 / m.spring), LARGEST)
    least = force * (1.0 / HIGHEST + 1.0 / m.spring)
    m.amplitude = min(max(m.growth * m.amplitude, least), asked)
    return m.amplitude * m.sine, m.amplitude * m.omega * m.cosine


GAIN, RATE_GAIN = 2.5, 0.3
"""g and f above: follows within a quarter of a breath; its rate is right to some percent after two."""
CORNER = 3.0
"""Low-pass (Hz) of the velocity, which is a difference of two roundings; its lag is made up for."""
SLOWEST, FASTEST = 0.5, 2.0
"""Bounds of the rate, over the one it began with."""
SMALLEST = 1e-4
"""Speed (m/s) slower than any breathing."""
TRUSTED = 0.4
"""Standard error over k_hat below which the surface is known."""


class Breath(Settings):
    """[controller.breath]: follow a surface that breathes, with the tissue known by [controller.tissue]."""

    rate: float = setting("1/min", default=15.0, gt=0, le=120, help="believed rate, to begin with")
    lag: float = setting("ms", default=20.0, ge=0, le=1000, help="believed lag of the robot behind its reference")


BREATH = record_of(
    Breath,
    **states(**alike("f8", "omega x q v share z F"), running="i8", **alike("f8", "low ahead")),
)
"""Settings and state: the oscillator's; velocity of the surface, low-passed; the share that is fed forward; height and
force of the call before, and whether there was one; share of the low-pass; how far ahead it is fed forward (s)."""


@njit(cache=True)
def _advance(m, v, h):
    """Let the oscillator follow the velocity `v` (m/s)."""
    e, squared, before = v - m.x, m.x * m.x + m.q * m.q, m.q
    step = m.omega * h
    m.q += step * m.x
    m.x += step * (GAIN * e - m.q)
    if squared > SMALLEST * SMALLEST:
        first = 2.0 * math.pi * m.rate
        # of the state before: the one after holds the noise of e itself
        turned = m.omega * (1.0 - RATE_GAIN * step * e * before / squared)
        m.omega = min(max(turned, SLOWEST * first), FASTEST * first)


@njit(cache=True, error_model="numpy")
def breathe(m, tissue, h, z, F):
    """Velocity (m/s) of the surface, ahead by the robot's lag, as far as the breath is known.

    Args:
        tissue: what is known of it.
        z, F: height (m) and pressing force (N) as estimated, unfiltered.
    """
    if m.omega == 0.0:
        m.omega, m.low = 2.0 * math.pi * m.rate, low_pass_share(CORNER, h)
        m.ahead = m.lag + h * (1.0 - m.low) / m.low
    if not tissue.known or tissue.since == 0.0 or not tissue.pressing:
        m.running, m.share = 0, 0.0
        return 0.0
    if not m.running:
        m.running, m.z, m.F, m.x, m.q, m.v = 1, z, F, 0.0, 0.0, 0.0
    m.v += m.low * ((z - m.z + (F - m.F) / tissue.k) / h - m.v)
    m.z, m.F = z, F
    _advance(m, m.v, h)
    trusted = tissue.std < TRUSTED * tissue.k
    m.share = min(m.share + m.omega * h, 1.0) if trusted else max(m.share - m.omega * h, 0.0)
    # a fraction of a rad
    ahead = m.omega * m.ahead
    return m.share * (m.x * (1.0 - 0.5 * ahead * ahead) - m.q * ahead)


ADAPTIVE_OUTPUTS = (
    Port("k_hat", 1, "N/m", "stiffness of the tissue, estimated while pressing; 0: not yet"),
    Port("k_std", 1, "N/m", "its standard error, grown by what may have changed since"),
    Port("c_hat", 1, "N s/m", "damping of the tissue and of the robot's joints, estimated with it"),
    Port("excited", 1, "1", "whether something moved enough to learn from", "bool"),
    Port("kp_F", 1, "m/N", "proportional gain of the force loop"),
    Port("ki_F", 1, "m/N s", "integral gain of the force loop"),
    Port("shift_z", 1, "m", "shift of the z reference besides dp_z: the dither"),
    Port("breath_rate", 1, "Hz", "rate of the breath that is followed; 0: none is looked for"),
    Port("breath_v", 1, "m/s", "velocity of the surface that is fed forward"),
)
ADAPTIVE = record(
    tissue=TISSUE,
    schedule=SCHEDULE,
    breath=BREATH,
    taps=TAPS,
    scheduled="i8",
    breathing="i8",
    **states(pressing="i8", **alike("f8", "shift v_shift v")),
)
"""The parts; which of them are on; whether the force loop acted in the call before; shift of the z reference and its
rate, and velocity of the breath, of this call."""


@dataclass(frozen=True)
class Adapting:
    """What is asked for.

    Attributes:
        sensing: of the tissue.
        scheduling, points: gains over stiffness; None, none: those of the experiment.
        breathing: of the breath; None: it is not looked for.
        tap_learning: share of a tap's error in force that the next one corrects.
    """

    sensing: Sensing
    scheduling: Scheduling | None = None
    points: Sequence[SchedulePoint] = ()
    breathing: Breath | None = None
    tap_learning: float = 0.0
    table: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "table", table_of(self.points))

    def fill(self, memory: Any) -> dict[str, np.ndarray]:
        """Put the settings into `memory`, a record of `ADAPTIVE`; what else a controller's memory points to."""
        parts = {"tissue": self.sensing._asdict()}
        if self.scheduling is not None:
            parts["schedule"] = self.scheduling._asdict()
        if self.breathing is not None:
            parts["breath"] = numbers(self.breathing)
        for part, values in parts.items():
            for name, value in values.items():
                memory[part][name] = value
        memory["scheduled"], memory["breathing"] = self.scheduling is not None, self.breathing is not None
        memory["taps"]["share"] = self.tap_learning
        memory["schedule"]["count"] = len(self.table)
        return {"gain_table": self.table} if len(self.table) else {}


def with_adaptive(kind: np.dtype) -> np.dtype:
    """The memory `kind` of a controller, with room for what it does besides."""
    # first, because numba takes a record for one that it begins with, and warns of that
    # the gains of the force loop are no constants there: they follow the tissue
    fields = {name: kind[name] for name in kind.names or ()} | {"force": state(kind["force"])}
    return record(adaptive=ADAPTIVE, gain_table="i8", **fields)


@njit(cache=True)
def adapt(m, table, pid, h, z, F, J, F_ref):
    """What comes before a call of the law.

    Args:
        table: address of the points of the schedule.
        pid: the force loop.
        z, F, J: height (m), pressing force (N) and Jacobian (9,) as estimated, unfiltered.
        F_ref: reference of the force loop (N), in the call before.
    """
    tissue, pressing = m.tissue, m.pressing
    sense(tissue, h, z, F, J, pressing)
    m.shift, m.v_shift = dither(tissue, h, F, F_ref)
    m.v = 0.0
    if m.scheduled:
        schedule_gains(m.schedule, table, tissue, pid, h)
        m.v_shift += follow_reference(m.schedule, tissue.spring, pid, F_ref, pressing, h)
    if m.breathing:
        m.v = breathe(m.breath, tissue, h, z, F)
        m.v_shift += m.v
        pid.integral -= m.v * h


@njit(cache=True)
def tell(m, pid, pressing, y):
    """What comes after: note whether the force loop acts, and say what is recorded."""
    m.pressing = pressing
    tissue = m.tissue
    y.k_hat, y.k_std, y.c_hat, y.excited = tissue.k, tissue.std_late, tissue.c, tissue.excited
    y.kp_F, y.ki_F, y.shift_z = pid.kp, pid.ki, m.shift
    y.breath_rate, y.breath_v = m.breath.omega / (2.0 * np.pi), m.v
