"""Hybrid force-position control (Fig. 3 B): the outer force loop shifts the z reference, position is the inner loop.

The position loop turns the Cartesian error into motor speeds, omega_ref = N J PID(p_cmd - p_est). The force loop is
triggered by the pressing force F_z, or at a set time, and stays on: dp_z = -PID(F_z_ref - F_z), within +-limit.
"""

import math
from collections.abc import Sequence
from functools import cache

import numpy as np

from twin.compiled.function import carray, njit
from twin.controller.adaptive import ADAPTIVE_OUTPUTS, Adapting, adapt, tell, with_adaptive
from twin.controller.loops import ForceLoop
from twin.controller.pid import LOW_PASS, PID, Gains, accept, kept_share, loop, proposal
from twin.controller.processor import Processor
from twin.cosim.component import NativeComponent
from twin.cosim.native import doubles_at, step_function
from twin.cosim.port import Port, memory_of, record, record_of
from twin.robot.model import Model
from twin.settings import Values, taken

INPUTS = (
    Port("p_B", 3, "m", "estimated platform position"),
    Port("J", 9, "rad/m", "Jacobian at the estimated position, row by row"),
    Port("F_ee_B", 3, "N", "estimated force by the robot on the environment"),
)
OMEGA_REF = Port("omega_ref", 3, "rad/s", "commanded motor speeds")
SHARE = Port("share", 1, "1", "of the motor speeds commanded in the call before, what an energy tank has passed on")
OUTPUTS = (
    OMEGA_REF,
    Port("p_ref_B", 3, "m", "pre-defined reference position"),
    Port("p_cmd_B", 3, "m", "reference of the position loop: p_ref_B shifted by the force loop"),
    Port("dp_z", 1, "m", "correction of the force loop to the z reference; negative presses harder"),
    Port("triggered", 1, "1", "whether the force loop is on", "bool"),
    Port("F_z", 1, "N", "estimated pressing force, low-passed: what trigger and force loop use"),
    Port("F_z_ref", 1, "N", "reference of the force loop"),
)


Ports = tuple[Port, ...]


def ports(inputs: Ports, outputs: Ports, adaptive: bool, tank: bool) -> tuple[Ports, Ports]:
    """Those of a controller that adapts or does not, and has an energy tank behind it or has none."""
    return inputs + (SHARE,) * tank, outputs + ADAPTIVE_OUTPUTS * adaptive


class Law(Values, parts=(taken(Model, "N"), taken(Processor, "speed_limit"), taken(ForceLoop))):
    """Settings of the force-position law, SI: the belt ratio as believed, limits, and what starts the force loop.

    It starts at a pressing force F_z above `trigger_force`, as in the caption of Fig. 4, or at `trigger_time`; a pull
    starts nothing. Infinity: never.
    """


LAW = record_of(Law)
MEMORY = record(
    law=LAW,
    force=PID,
    position=(PID, (3,)),
    low=LOW_PASS,
    lead="3f8",
    F_z="f8",
    triggered="i8",
    segment="i8",
    way_points="i8",
    times="i8",
    points="i8",
)


@njit(cache=True)
def reference_position(times, points, segment, t):
    """Point (m) of the trajectory at `t` (s), and the segment it lies in.

    Args:
        times: (n,) ascending, s.
        points: (n, 3), m.
        segment: any index at or before the right one; pass the one returned last.

    Returns:
        (x, y, z, segment). Before the first way point the first, after the last the last.
    """
    last = times.shape[0] - 1
    while segment < last and t >= times[segment + 1]:
        segment += 1
    if segment == last or t <= times[0]:
        return points[segment, 0], points[segment, 1], points[segment, 2], segment
    share = (t - times[segment]) / (times[segment + 1] - times[segment])
    a, b = points[segment], points[segment + 1]
    return (
        a[0] + share * (b[0] - a[0]),
        a[1] + share * (b[1] - a[1]),
        a[2] + share * (b[2] - a[2]),
        segment,
    )


@njit(cache=True)
def force_correction(law, pid, e, h):
    """dp_z (m) of the force loop for the force error `e` = F_z_ref - F_z (N)."""
    u, integral = proposal(pid, e, h)
    if abs(u) <= law.dp_z_max:
        accept(pid, integral)
    return -min(max(u, -law.dp_z_max), law.dp_z_max)


@njit(cache=True, error_model="numpy")
def follow_passed(pid, z, share, h):
    """Let the integral go to where the share of the last command leads that an energy tank has passed on.

    What does not get through winds up nothing: back-calculation within half of the integral's own time kp/ki (Åström
    and Hägglund 2006, Advanced PID Control, Sec. 3.5). A way back up is never held back.

    Args:
        pid: the force loop.
        z: what the position loop was off by in the call before (m); negative: it was told to go down.
        share: of that command.
    """
    if share < 1.0 and pid.started and z < 0.0 and pid.ki > 0.0:
        pid.integral += (1.0 - share) * min(2.0 * pid.ki * h / pid.kp, 1.0) * z


@njit(cache=True)
def motor_speeds(law, pids, J, p_B, p_cmd_B, lead, h, omega_ref):
    """omega_ref (3,) of the position loop from `p_B` to `p_cmd_B` (3,), m, plus feed-forward `lead` (3,), rad/s.

    Each is kept within +-omega_max.
    """
    ux, ix = proposal(pids[0], p_cmd_B[0] - p_B[0], h)
    uy, iy = proposal(pids[1], p_cmd_B[1] - p_B[1], h)
    uz, iz = proposal(pids[2], p_cmd_B[2] - p_B[2], h)
    within = True
    for i in range(3):
        omega = law.N * (J[3 * i] * ux + J[3 * i + 1] * uy + J[3 * i + 2] * uz) + lead[i]
        within = within and abs(omega) <= law.omega_max
        omega_ref[i] = min(max(omega, -law.omega_max), law.omega_max)
    if within:
        accept(pids[0], ix)
        accept(pids[1], iy)
        accept(pids[2], iz)


@njit(cache=True, inline="always")
def control(m, t, h, u, y, shift):
    """A call of the law, its z reference shifted by `shift` (m) besides."""
    times, points = carray(doubles_at(m.times), m.way_points), carray(doubles_at(m.points), (m.way_points, 3))
    p_ref_B = y.p_ref_B
    p_ref_B[0], p_ref_B[1], p_ref_B[2], m.segment = reference_position(times, points, m.segment, t)
    m.F_z += kept_share(m.low, m.law.corner, h) * (-u.F_ee_B[2] - m.F_z)
    if m.F_z > m.law.trigger_force or t >= m.law.trigger_time - 0.5 * h:
        m.triggered = 1
    y.dp_z = force_correction(m.law, m.force, m.law.F_z_ref - m.F_z, h) if m.triggered else 0.0
    y.p_cmd_B[0], y.p_cmd_B[1], y.p_cmd_B[2] = p_ref_B[0], p_ref_B[1], p_ref_B[2] + y.dp_z + shift
    motor_speeds(m.law, m.position, u.J, u.p_B, y.p_cmd_B, m.lead, h, y.omega_ref)
    y.triggered, y.F_z, y.F_z_ref = m.triggered, m.F_z, m.law.F_z_ref


ADAPTIVE_MEMORY = with_adaptive(MEMORY)


@cache
def step_over(adaptive, tank):
    """The step of the law with or without all that comes before and after it, and an energy tank behind it."""

    @step_function(ADAPTIVE_MEMORY if adaptive else MEMORY, *ports(INPUTS, OUTPUTS, adaptive, tank))
    def step(m, t, h, u, y):
        shift = 0.0
        if tank:
            follow_passed(m.force, m.position[2].error, u.share, h)
        if adaptive:
            adapt(m.adaptive, m.gain_table, m.force, h, u.p_B[2], -u.F_ee_B[2], u.J, m.law.F_z_ref)
            for i in range(3):
                m.lead[i] = m.law.N * u.J[3 * i + 2] * m.adaptive.v_shift
            shift = m.adaptive.shift
        control(m, t, h, u, y, shift)
        if adaptive:
            tell(m.adaptive, m.force, m.triggered, y)
        return 0

    return step


class Controller(NativeComponent):
    """Sampled component: estimates in, motor speeds out.

    Args:
        law: settings.
        position, force: gains of the two loops; position acts on m and gives m/s, force acts on N and gives m.
        times, points: way points of the reference, (n,) s ascending and (n, 3) m.
        period: in ticks.
        adapting: what it does besides; None: nothing.
        tank: whether an energy tank stands behind it, and tells what it passes on.
    """

    def __init__(
        self,
        law: Law,
        position: Gains,
        force: Gains,
        times: Sequence[float],
        points: Sequence[Sequence[float]],
        period: int = 1,
        adapting: Adapting | None = None,
        tank: bool = False,
    ):
        times_, points_ = np.array(times, dtype=float), np.array(points, dtype=float)
        memory = memory_of(
            ADAPTIVE_MEMORY if adapting else MEMORY, law=tuple(law), force=loop(force), position=[loop(position)] * 3
        )
        memory["way_points"] = len(times_)
        kept = {"times": times_, "points": points_}
        if adapting:
            kept |= adapting.fill(memory["adaptive"][0])
        variant = adapting is not None, tank
        sides = ports(INPUTS, OUTPUTS, *variant)
        super().__init__("controller", *sides, True, step_over(*variant), memory, period=period, pointers=kept)


NEVER = math.inf
