"""Task controller: the state machine of phases in front of the force-position law of Fig. 3 B; table [controller].

It differs from `controller.py` in four ways. The reference is a machine that reacts to contact (`machine.py`). Velocity
and deflection of the springs are fed forward. Oscillations of the platform on its springs are damped. The force loop
acts in pressing phases only, starting from the present force, so neither the loop nor the reference jumps.
"""

from collections.abc import Sequence
from functools import cache

import numpy as np

from twin.kernel.compiled.function import carray, njit, pointer_to
from twin.kernel.cosim.component import NativeComponent, step_function
from twin.kernel.cosim.port import Port, memory_of, record, states
from twin.kernel.cosim.system import System
from twin.kernel.settings import Settings, numbers, setting
from twin.robot.controller.adaptive import AdaptiveOptions, adapt, with_adaptive, write_outputs
from twin.robot.controller.breath import Breath
from twin.robot.controller.compliance import (
    DAMPER_RECORD,
    FEED_FORWARD_RECORD,
    Damping,
    FeedForward,
    FeedForwardModel,
    damp,
    damper,
    friction_force,
    load_torques,
)
from twin.robot.controller.controller import LAW_INPUTS as ESTIMATES
from twin.robot.controller.controller import (
    LAW_OUTPUTS,
    LAW_RECORD,
    Controller,
    Law,
    WayPointReference,
    controller_ports,
    force_correction,
    motor_speeds,
    unwind_integral,
)
from twin.robot.controller.energy_tank import EnergyTank
from twin.robot.controller.machine import MACHINE_RECORD, advance_machine, motion
from twin.robot.controller.pid import (
    LOW_PASS_RECORD,
    PID_RECORD,
    ForceLoop,
    Gains,
    PositionLoop,
    Processor,
    cached_share,
    loop_record,
    reset_loop,
)
from twin.robot.controller.program import PHASE_RECORD, Phase
from twin.robot.controller.taps import learn_taps
from twin.robot.controller.tissue import Tissue
from twin.robot.mechanism.geometry import Model

TASK_INPUTS = (*ESTIMATES, Port("tau_l", 3, "N m", "estimated joint torques"))
TASK_OUTPUTS = (
    *LAW_OUTPUTS,
    Port("v_ref_B", 3, "m/s", "velocity of the reference, fed forward"),
    Port("task", 1, "1", "task of the sequence that is on, counted from 1", "int"),
    Port("phase", 1, "1", "what it is doing, see the recording's metadata 'phases'", "int"),
)
TASK_MEMORY = record(
    law=LAW_RECORD,
    forward=FEED_FORWARD_RECORD,
    damper=DAMPER_RECORD,
    force=PID_RECORD,
    position=(PID_RECORD, (3,)),
    machine=MACHINE_RECORD,
    phases="i8",
    count="i8",
    **states(low=LOW_PASS_RECORD, F_z="f8", F_rate="f8", dp_z="f8", p="3f8", v="3f8", lead="3f8"),
)
ADAPTIVE_TASK_MEMORY = with_adaptive(TASK_MEMORY)
_phases_at = pointer_to(PHASE_RECORD)


class Touch(Settings):
    """[controller.touch]: detection of contact in a task, and learning of taps."""

    contact: float = setting(
        "N", gt=0, field="contact_force", exported=False, help="pressing force that counts as contact"
    )
    patience: float = setting("ms", gt=0, help="maximum time without contact while pressing")
    turn: float = setting("ms", ge=0, le=100, field="t_turn", help="initial time before its depth at which a tap turns")
    learning: float = setting(ge=0, le=1, help="share of a tap's depth error that the next tap corrects")
    force_learning: float = setting(
        into="taps", field="share", default=0.0, ge=0, le=1, help="share of a force error that the next tap corrects"
    )


@njit(cache=True)
def write_feed_forward(m, phase, J, t, h, v_shift):
    """Compute the feed-forward motor speeds (rad/s) into `m.lead`, predicted by the drives' `lag` from `t`.

    They follow the reference's motion, the springs' deflection, and an additional velocity `v_shift` (m/s) in z.
    """
    machine, forward = m.machine, m.forward
    elapsed = t - machine.entered
    if elapsed >= 0.0:
        motion(phase, machine.start, machine.end, machine.length, elapsed + forward.lag, m.p, m.v)
    else:
        # the machine reverses before the next call, and has set the mean speed until then
        m.v[0], m.v[1], m.v[2] = machine.v[0], machine.v[1], machine.v[2]
    for i in range(3):
        m.lead[i] = m.law.N * (J[3 * i] * m.v[0] + J[3 * i + 1] * m.v[1] + J[3 * i + 2] * (m.v[2] + v_shift))
    # friction at rest is constant, so only moving phases need its feed-forward
    if phase.force_on and (phase.radius > 0.0 or machine.length > 0.0):
        F_x, F_y = friction_force(forward.mu, machine.F_ref, m.v[0], m.v[1])
        motion(phase, machine.start, machine.end, machine.length, elapsed + forward.lag + h, m.p, m.v)
        next_x, next_y = friction_force(forward.mu, machine.F_ref, m.v[0], m.v[1])
        tau = load_torques(J, next_x - F_x, next_y - F_y, 0.0)
        for i in range(3):
            m.lead[i] += tau[i] / (h * forward.k_s * m.law.N * forward.eta)


@njit(cache=True, inline="always")
def control(m, t, h, u, y, shift, v_shift):
    """Execute one call of the task controller: state machine, then force-position law.

    Its z reference is shifted by `shift` (m) and moves at `v_shift` (m/s).
    """
    phases, machine = carray(_phases_at(m.phases), m.count), m.machine
    share = cached_share(m.low, m.law.corner, h)
    before = m.F_z
    m.F_z += share * (-u.F_ee_B[2] - m.F_z)
    m.F_rate += share * ((m.F_z - before) / h - m.F_rate)
    # a first-order low-pass lags a ramp by its time constant
    lag = h * (1.0 - share) / share
    advance_machine(machine, phases, t, h, u.p_B[2], -u.F_ee_B[2], m.F_z, m.F_rate, lag, m.dp_z)
    phase = phases[machine.index]
    if phase.force_on:
        m.dp_z = force_correction(m.law, m.force, machine.F_ref - m.F_z, h)
    else:
        m.dp_z = 0.0
        reset_loop(m.force)
    write_feed_forward(m, phase, u.J, t, h, v_shift)
    damp(m.damper, m.law.N * m.forward.eta, u.tau_l, h, m.lead)
    for i in range(3):
        y.p_ref_B[i], y.v_ref_B[i], y.p_cmd_B[i] = machine.p[i], machine.v[i], machine.p[i]
    y.p_cmd_B[2] += m.dp_z
    y.p_cmd_B[2] += shift
    motor_speeds(m.law, m.position, u.J, u.p_B, y.p_cmd_B, m.lead, h, y.omega_ref)
    y.dp_z, y.triggered, y.F_z, y.F_z_ref = m.dp_z, phase.force_on, m.F_z, machine.F_ref
    y.task, y.phase = phase.task, phase.kind


@cache
def make_step(adaptive, tank):
    """Compile the step function of the task controller, with or without adaptive options and an energy tank."""

    @step_function(
        ADAPTIVE_TASK_MEMORY if adaptive else TASK_MEMORY, *controller_ports(TASK_INPUTS, TASK_OUTPUTS, adaptive, tank)
    )
    def step(m, t, h, u, y):
        shift = v_shift = 0.0
        if tank:
            unwind_integral(m.force, m.position[2].error, u.share, h)
        if adaptive:
            known, machine, z, F = m.adaptive, m.machine, u.p_B[2], -u.F_ee_B[2]
            adapt(known, m.gain_table, m.force, h, z, F, u.J, machine.F_ref)
            if known.taps.share > 0.0 and machine.index >= 0:
                phases = carray(_phases_at(m.phases), m.count)
                learn_taps(known.taps, known.tissue, machine, phases[machine.index], t, h, z, F, u.J)
            shift, v_shift = known.shift, known.v_shift
        control(m, t, h, u, y, shift, v_shift)
        if adaptive:
            write_outputs(m.adaptive, m.force, y.triggered, y)
        return 0

    return step


class TaskController(NativeComponent):
    """Sampled component of the task controller: estimates in, motor speeds out, led by a program of phases.

    Args:
        law: settings; its F_z_ref and triggers are not used.
        phases: the program; the last phase is permanent.
        start: initial platform position (3,), m.
        position, force, period, adapting, tank: see `Controller`.
    """

    def __init__(
        self,
        law: Law,
        position: Gains,
        force: Gains,
        feed_forward: FeedForwardModel,
        damping: Damping,
        touch: Touch,
        phases: Sequence[Phase],
        start: Sequence[float],
        period: int = 1,
        adapting: AdaptiveOptions | None = None,
        tank: bool = False,
    ):
        table = np.array([tuple(phase) for phase in phases], dtype=PHASE_RECORD)
        memory = memory_of(
            ADAPTIVE_TASK_MEMORY if adapting else TASK_MEMORY,
            law=tuple(law),
            force=loop_record(force),
            position=[loop_record(position)] * 3,
        )
        memory["forward"][0], memory["damper"][0] = tuple(feed_forward), damper(damping)
        memory["count"] = len(table)
        machine = memory[0]["machine"]
        machine["index"], machine["p"], machine["z_turn"] = -1, start, -np.inf
        for name, value in numbers(touch).items():
            machine[name] = value
        arrays = {"phases": table}
        if adapting:
            arrays |= adapting.fill(memory["adaptive"][0])
        variant = adapting is not None, tank
        sides = controller_ports(TASK_INPUTS, TASK_OUTPUTS, *variant)
        super().__init__("controller", *sides, True, make_step(*variant), memory, period=period, pointers=arrays)


class Computer(Processor):
    """[controller]: the robot's computer. `touch`, `feed_forward` and `damping` belong to tasks."""

    position: PositionLoop
    force: ForceLoop
    touch: Touch | None = None
    feed_forward: FeedForward | None = None
    damping: Damping | None = None
    tissue: Tissue | None = None
    breath: Breath | None = None
    energy_tank: EnergyTank | None = None
    model: Model


def set_hold_point(system: System, p_B: Sequence[float]) -> None:
    """Move the point where the controller holds the platform to `p_B` (3,), m.

    This changes the last waypoint, and the line of the current phase, in the memory of the system's controller.
    """
    for component in system.components:
        if isinstance(component, (Controller, WayPointReference)):
            component.points[-1] = p_B
        elif isinstance(component, TaskController):
            component.memory["machine"]["start"] = component.memory["machine"]["end"] = p_B
