"""Adaptive options of the controller: tissue estimate, scheduled gains, compensation of breathing.

They extend the law of Fig. 3 B through its interface: they set the gains of the force loop, move its integral and add a
shift to its reference. A controller without options is unaffected.

The dither is a swing of the reference while the tissue is poorly known, as a quiet press gives `tissue` no information.
It costs force, so its amplitude depends on the possible gain (dual control; Åström and Wittenmark 1995, Adaptive
Control, Ch. 7). While the reference rises it has its full force. While the reference is constant it hides beneath the
present force error, and stops without one, as better gains would not help. While the reference falls it stops, as the
press ends too soon to learn.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from twin.kernel.compiled.function import njit
from twin.kernel.cosim.port import Port, record, state, states
from twin.kernel.settings import fields_of_form, numbers
from twin.robot.controller.breath import BREATH_RECORD, Breath, breath_velocity
from twin.robot.controller.pid import state_variable
from twin.robot.controller.schedule import (
    SCHEDULE_RECORD,
    SchedulePoint,
    Scheduling,
    follow_reference,
    schedule_gains,
    schedule_table,
)
from twin.robot.controller.taps import TAPS_RECORD
from twin.robot.controller.tissue import MAX_STIFFNESS, TISSUE_RECORD, Sensing, reset_estimate, update_tissue

MAX_DITHER_AMPLITUDE = 5e-4
"""Maximum amplitude of the dither (m)."""
HIDDEN_FORCE_RATIO = 0.3
"""Maximum ratio of the dither's force amplitude to the rms of the remaining force error, at a constant reference."""
NOTCH_DAMPING = 2.0
"""1/Q of the notch at the dither's frequency; it settles in 1/(2 pi f), as fast as the force error of a quick loop."""
MIN_FORCE_SHARE = 0.05
"""Minimum share of its full force; below it, the dither stops."""
ADAPTIVE_OUTPUTS = (
    Port("k_hat", 1, "N/m", "stiffness of the tissue, estimated while pressing; 0: not yet"),
    Port("k_std", 1, "N/m", "its standard error, grown by what may have changed since"),
    Port("c_hat", 1, "N s/m", "damping of the tissue and of the robot's joints, estimated with it"),
    Port("excited", 1, "1", "whether something moved enough to learn from", "bool"),
    Port("kp_F", 1, "m/N", "proportional gain of the force loop"),
    Port("ki_F", 1, "m/N s", "integral gain of the force loop"),
    Port("shift_z", 1, "m", "shift of the z reference in addition to dp_z: the dither"),
    Port("breath_rate", 1, "Hz", "rate of the breath that is followed; 0: none is looked for"),
    Port("breath_v", 1, "m/s", "velocity of the surface that is fed forward"),
)
ADAPTIVE_RECORD = record(
    tissue=TISSUE_RECORD,
    schedule=SCHEDULE_RECORD,
    breath=BREATH_RECORD,
    taps=TAPS_RECORD,
    scheduled="i8",
    breathing="i8",
    **states(pressing="i8", **fields_of_form("f8", "shift v_shift v")),
)
"""The options' records and which are enabled; whether the force loop acted in the previous call; shift of the z
reference and its rate, and velocity of the breath, in this call."""


@njit(cache=True, error_model="numpy")
def dither(m, h, F, F_ref):
    """Advance the dither, a sine added to the z reference, by one call; return (shift (m), its rate (m/s)).

    Both are 0 if the tissue is known well enough. `F` and `F_ref` are the pressing force and its reference (N).
    """
    change = F_ref - m.F_ref
    m.F_ref, m.leading, m.falling = F_ref, change != 0.0, change < 0.0
    if m.since == 0.0 or m.dither == 0.0:
        m.off, m.off_squared, m.notch.fast, m.notch.slow = F_ref - F, 0.0, 0.0, F_ref - F
        return 0.0, 0.0
    m.off += m.smoothing * (F_ref - F - m.off)
    _, band, _, m.notch.fast, m.notch.slow = state_variable(NOTCH_DAMPING, m.g, m.notch.fast, m.notch.slow, m.off)
    besides = m.off - NOTCH_DAMPING * band
    m.off_squared += m.averaging * (besides * besides - m.off_squared)
    force = m.dither
    if change < 0.0:
        force = 0.0
    elif change == 0.0:
        force = min(force, HIDDEN_FORCE_RATIO * math.sqrt(m.off_squared))
    doubt = m.std / m.k if m.known else MAX_STIFFNESS
    if not m.dithering and doubt > m.doubtful and force > 2.0 * MIN_FORCE_SHARE * m.dither:
        m.dithering, m.phase, m.sine, m.cosine, m.amplitude = 1, 0.0, 0.0, 1.0, 0.0
        reset_estimate(m)
    if not m.dithering:
        return 0.0, 0.0
    m.phase += m.omega * h
    # rotated from call to call: evaluating sine and cosine would take a sixth of this function's time
    m.sine, m.cosine = (
        m.sine * m.turn_cosine + m.cosine * m.turn_sine,
        m.cosine * m.turn_cosine - m.sine * m.turn_sine,
    )
    # the dither ends after a whole swing
    if m.phase >= 2.0 * math.pi:
        m.phase -= 2.0 * math.pi
        if doubt < m.enough or force < MIN_FORCE_SHARE * m.dither:
            m.dithering, m.phase = 0, 0.0
            return 0.0, 0.0
    # unknown tissue may be hard
    k = min(m.k + 2.0 * m.std, MAX_STIFFNESS) if m.known else MAX_STIFFNESS
    asked = min(force * (1.0 / k + 1.0 / m.spring), MAX_DITHER_AMPLITUDE)
    least = force * (1.0 / MAX_STIFFNESS + 1.0 / m.spring)
    m.amplitude = min(max(m.growth * m.amplitude, least), asked)
    return m.amplitude * m.sine, m.amplitude * m.omega * m.cosine


@dataclass(frozen=True)
class AdaptiveOptions:
    """Settings of the controller's adaptive options: tissue estimate, scheduled gains, breath, learning of taps.

    Attributes:
        scheduling, points: gains over stiffness; None and empty for the fixed gains of the experiment.
        breathing: parameters of the breath's oscillator; None to disable it.
        tap_learning: share of a tap's force error that the next one corrects.
    """

    sensing: Sensing
    scheduling: Scheduling | None = None
    points: Sequence[SchedulePoint] = ()
    breathing: Breath | None = None
    tap_learning: float = 0.0
    table: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "table", schedule_table(self.points))

    def fill(self, memory: Any) -> dict[str, np.ndarray]:
        """Write the adaptive options into the controller's memory record; return the arrays that it points to."""
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
    """Return the record type of a controller's memory, extended by the memory of the adaptive options."""
    # first, because numba confuses a record with its leading record, and warns about it; the gains of the force loop
    # become state, as they follow the tissue
    fields = {name: kind[name] for name in kind.names or ()} | {"force": state(kind["force"])}
    return record(adaptive=ADAPTIVE_RECORD, gain_table="i8", **fields)


@njit(cache=True)
def adapt(m, table, pid, h, z, F, J, F_ref):
    """Update tissue estimate, breath, taps and scheduled gains before a call of the force-position law.

    Args:
        table: address of the schedule's points.
        z, F, J: estimated height (m), pressing force (N) and Jacobian (9,), unfiltered.
        F_ref: reference of the force loop (N) in the previous call.
    """
    tissue, pressing = m.tissue, m.pressing
    update_tissue(tissue, h, z, F, J, pressing)
    m.shift, m.v_shift = dither(tissue, h, F, F_ref)
    m.v = 0.0
    if m.scheduled:
        schedule_gains(m.schedule, table, tissue, pid, h)
        m.v_shift += follow_reference(m.schedule, tissue.spring, pid, F_ref, pressing, h)
    if m.breathing:
        m.v = breath_velocity(m.breath, tissue, h, z, F)
        m.v_shift += m.v
        pid.integral -= m.v * h


@njit(cache=True)
def write_outputs(m, pid, pressing, y):
    """Store whether the force loop acts, and write the adaptive options' outputs, after a call of the control law."""
    m.pressing = pressing
    tissue = m.tissue
    y.k_hat, y.k_std, y.c_hat, y.excited = tissue.k, tissue.std_late, tissue.c, tissue.excited
    y.kp_F, y.ki_F, y.shift_z = pid.kp, pid.ki, m.shift
    y.breath_rate, y.breath_v = m.breath.omega / (2.0 * np.pi), m.v
