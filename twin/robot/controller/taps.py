"""Learning of taps from their force: if one pressed too hard, the next one is less deep.

The force of statics lacks the platform's inertia, which is as large as a light tap at its reversal, and the friction of
the joints. Height and force pass the same low-pass, whose derivatives of the height give the platform's motion:

    F = F_est + m d2z/dt2 + b dz/dt,                                                                             (K2)

with b from the motion through the air, where F is 0. The probe measures the stiffness, and the indentation from contact
to the requested force. A tap reverses that far below the detected surface; the excess of its largest F over the
requested one, divided by the stiffness, is its depth error.
"""

import math

from twin.kernel.compiled.function import njit
from twin.kernel.cosim.port import record, states
from twin.kernel.settings import fields_of_form
from twin.robot.controller.machine import MAX_TURN_TIME
from twin.robot.controller.pid import state_variable
from twin.robot.controller.program import PhaseKind
from twin.robot.controller.tissue import MAX_STIFFNESS, MIN_STIFFNESS, moving_mass

LOW_PASS_CORNER = 35.0
"""Corner frequency (Hz) of the low-pass: a tap at 100 mm/s loses 2 % of its peak, rounding adds 0.03 N."""
LOW_PASS_DAMPING = 1.4
"""1/Q of the low-pass, which has no resonance."""
AIR_CLEARANCE = 2e-3
"""Minimum height (m) above the probe's contact that counts as air."""
MIN_AIR_VELOCITY = 0.02
"""Minimum speed (m/s) for estimating friction in the air."""
UNREACHED_HEIGHT = 1e-4
"""Minimum height (m) of a tap's lowest point above its planned reversal for a tap that was ended early by its force."""

TAPS_RECORD = record(
    share="f8",
    **states(
        **fields_of_form("f8", "mass g z_fast z_slow F_fast F_slow z_0"),
        kind="i8",
        **fields_of_form("f8", "vF vv z_begun F_begun k depth z_before F_before"),
        felt="i8",
        **fields_of_form("f8", "peak level speed t_turn"),
    ),
)
"""State of the learning.

share: share of the error that the next tap corrects. mass: moving mass (kg) at the beginning of the phase. g: filter
coefficient; 0 while the filters are stopped. z_fast .. F_slow: filter states, relative to the height z_0.
kind: phase of the previous call. vF, vv: sums of speed times force and of squared speed in the air. z_begun, F_begun:
start of the probe. k, depth: stiffness measured by it (N/m), and depth of a tap from contact (m). z_before, F_before:
height and force of the previous call. felt: whether the current tap has detected the surface. peak, level: its largest
and its requested force (N). speed, t_turn: its speed, and the planned lead time of its reversal.
"""


@njit(cache=True, error_model="numpy")
def _update_probe(m, z, F):
    """Update the tissue stiffness and the indentation depth that the first slow press measures."""
    if m.kind != PhaseKind.PROBE:
        m.z_begun, m.F_begun, m.k = z, F, 0.0
    elif z < m.z_begun:
        m.depth = m.z_begun - z
        m.k = min(max((F - m.F_begun) / m.depth, MIN_STIFFNESS), MAX_STIFFNESS)


@njit(cache=True, error_model="numpy")
def _update_tap(m, machine, phase, elapsed, z, F):
    """Detect the surface during a tap, and plan the reversal at the learned depth below it."""
    if m.kind != PhaseKind.TAP:
        m.felt, m.peak, m.level, m.speed, m.t_turn = 0, 0.0, phase.level, phase.speed, machine.t_turn
    m.peak = max(m.peak, F)
    if not m.felt and m.k > 0.0 and elapsed >= phase.ramp_in and F >= m.F_begun:
        m.felt = 1
        share = (m.F_begun - m.F_before) / (F - m.F_before) if m.F_before < m.F_begun else 0.0
        # if there was contact before, the surface is estimated from force and stiffness
        surface = m.z_before + share * (z - m.z_before) if share > 0.0 else z + (F - m.F_begun) / m.k
        machine.z_turn = surface - m.depth


@njit(cache=True, error_model="numpy")
def _correct_depth(m, machine):
    """Correct the depth of the next tap by the force error of the last one.

    If the force ended the last tap before its depth, the lead time of the reversal is corrected instead.
    """
    too_deep = m.share * (m.peak - m.level) / m.k
    if machine.z_lowest - machine.z_turn > UNREACHED_HEIGHT:
        machine.t_turn = min(max(m.t_turn + too_deep / m.speed, 0.0), MAX_TURN_TIME)
    else:
        m.depth -= too_deep
        machine.depth -= too_deep
        machine.z_turn += too_deep


@njit(cache=True, error_model="numpy")
def learn_taps(m, tissue, machine, phase, t, h, z, F, J):
    """Track the force of each tap, and correct the depth of the next tap by its error.

    Args:
        machine: state machine, whose planned reversal is corrected.
        phase: phase at the end of the previous call.
        z, F, J: estimated height (m), pressing force (N) and Jacobian (9,), unfiltered.
    """
    kind, omega = phase.kind, 2.0 * math.pi * LOW_PASS_CORNER
    if kind != PhaseKind.DESCEND and (kind < PhaseKind.RETRACT or kind > PhaseKind.WAIT):
        m.g, m.kind = 0.0, kind
        return
    if m.g == 0.0:
        m.g, m.z_0 = math.tan(math.pi * LOW_PASS_CORNER * h), z
        m.z_fast, m.z_slow, m.F_fast, m.F_slow = 0.0, 0.0, 0.0, F
    if kind != m.kind:
        m.mass = moving_mass(tissue, J)
    low, first, second, m.z_fast, m.z_slow = state_variable(LOW_PASS_DAMPING, m.g, m.z_fast, m.z_slow, z - m.z_0)
    F_low, _, _, m.F_fast, m.F_slow = state_variable(LOW_PASS_DAMPING, m.g, m.F_fast, m.F_slow, F)
    z_low, v = m.z_0 + low, omega * first
    force = F_low + m.mass * omega * omega * second
    if abs(v) > MIN_AIR_VELOCITY and z_low > m.z_begun + AIR_CLEARANCE and m.k > 0.0:
        m.vF, m.vv = m.vF - v * force, m.vv + v * v
    if m.vv > 0.0:
        force += m.vF / m.vv * v
    if kind == PhaseKind.PROBE:
        _update_probe(m, z_low, force)
    elif kind == PhaseKind.TAP:
        _update_tap(m, machine, phase, t - machine.entered, z_low, force)
    elif kind == PhaseKind.RISE:
        m.peak = max(m.peak, force)
    elif m.kind == PhaseKind.RISE and m.k > 0.0:
        _correct_depth(m, machine)
    m.kind, m.z_before, m.F_before = kind, z_low, force
