"""Taps that learn from their force: what the last one pressed too hard, the next one goes less deep.

The force of statics lacks the platform's inertia, as much as a light tap where it turns round, and the friction of the
joints. Height and force pass one low-pass, whose derivatives of the height tell how the platform moves:

    F = F_est + m d2z/dt2 + b dz/dt,                                                                             (K2)

with b from the way through the air, where F is 0. The probe tells the stiffness, and how deep the surface is pressed in
from the touch to the force that is asked for. A tap turns that much below the height at which it feels the surface, at
whatever height that is by then; its largest F less the one asked for, over the stiffness, is what it was too deep.
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
"""Of the low-pass (Hz): a tap at 100 mm/s loses 2 % of its peak, rounding adds 0.03 N."""
LOW_PASS_DAMPING = 1.4
"""1/Q of the low-pass: no peak of its own."""
AIR_CLEARANCE = 2e-3
"""Height (m) above where the probe touched from which on there is air."""
MIN_AIR_VELOCITY = 0.02
"""Speed (m/s) from which on friction in the air is looked at."""
UNREACHED_HEIGHT = 1e-4
"""Height (m) above its turn at which a tap is over before it got there: its force ended it."""

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
"""share: of the error that the next tap corrects. mass: of what moves up and down (kg), as of the beginning of the
phase. g: of the filters; 0: they do not run. z_fast .. F_slow: of the filters, from the height z_0 on. kind: phase of
the call before. vF, vv: sums of speed times force and of its square in the air. z_begun, F_begun: where the probe
began. k, depth: the stiffness it felt (N/m), and how deep a tap goes from the touch on (m). z_before, F_before: of the
call before. felt: whether the tap that is on has felt the surface. peak, level: its largest force, and what is asked
for (N). speed, t_turn: its speed, and how long before its lowest point it was to turn.
"""


@njit(cache=True, error_model="numpy")
def _update_probe(m, z, F):
    """The probe goes on: what it has felt by now."""
    if m.kind != PhaseKind.PROBE:
        m.z_begun, m.F_begun, m.k = z, F, 0.0
    elif z < m.z_begun:
        m.depth = m.z_begun - z
        m.k = min(max((F - m.F_begun) / m.depth, MIN_STIFFNESS), MAX_STIFFNESS)


@njit(cache=True, error_model="numpy")
def _update_tap(m, machine, phase, elapsed, z, F):
    """A tap goes down: feel the surface, and turn as far below it as was learnt."""
    if m.kind != PhaseKind.TAP:
        m.felt, m.peak, m.level, m.speed, m.t_turn = 0, 0.0, phase.level, phase.speed, machine.t_turn
    m.peak = max(m.peak, F)
    if not m.felt and m.k > 0.0 and elapsed >= phase.ramp_in and F >= m.F_begun:
        m.felt = 1
        share = (m.F_begun - m.F_before) / (F - m.F_before) if m.F_before < m.F_begun else 0.0
        # where contact was there before, the surface is as far up as the force tells
        surface = m.z_before + share * (z - m.z_before) if share > 0.0 else z + (F - m.F_begun) / m.k
        machine.z_turn = surface - m.depth


@njit(cache=True, error_model="numpy")
def _correct_depth(m, machine):
    """The tap is over: what it was too deep, the next one turns higher, or earlier if its force has ended it."""
    too_deep = m.share * (m.peak - m.level) / m.k
    if machine.z_lowest - machine.z_turn > UNREACHED_HEIGHT:
        machine.t_turn = min(max(m.t_turn + too_deep / m.speed, 0.0), MAX_TURN_TIME)
    else:
        m.depth -= too_deep
        machine.depth -= too_deep
        machine.z_turn += too_deep


@njit(cache=True, error_model="numpy")
def learn_taps(m, tissue, machine, phase, t, h, z, F, J):
    """Note the force of a tap; when it is over, correct the depth of the next one.

    Args:
        tissue: what is known of the robot's own mass.
        machine: of the phases; where its taps turn is corrected.
        phase: in which the call before ended.
        z, F, J: height (m), pressing force (N) and Jacobian (9,) as estimated, unfiltered.
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
