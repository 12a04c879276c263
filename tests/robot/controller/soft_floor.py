"""A program of phases carried out by the task controller on a soft floor, without robot and drives."""

import math
from typing import NamedTuple

import numpy as np

from tests.laws.runs import ComponentStepper
from twin.robot.controller.compliance import Damping, FeedForwardModel
from twin.robot.controller.controller import Law
from twin.robot.controller.pid import Gains
from twin.robot.controller.program import Approach, Press, Push, Roll, Tap, program
from twin.robot.controller.task_controller import TaskController, Touch

T_s = 2e-3
FLOOR, STIFFNESS = -0.1, 1000.0
"""Height (m) of the soft floor, and its stiffness (N/m)."""
APPROACH = Approach.model_construct(height=-0.09, floor=-0.12, speed=0.04, descent=0.01, ramp=0.1, release=0.5)
CONTACT = 0.6
"""Pressing force (N) that counts as touching."""
LAW = Law(N=2.0, omega_max=8.0, F_z_ref=0.0, trigger_force=math.inf, trigger_time=math.inf, dp_z_max=0.03, corner=0.0)
FORCE_GAINS = Gains(5e-4, 4e-3)
FORWARD = FeedForwardModel(k_s=1.0, eta=1.0, mu=0.0, lag=0.0)
UNDAMPED = Damping.model_construct(gain=0.0, corner=4.0)
TOUCH = Touch.model_construct(contact=CONTACT, patience=0.3, turn=0.0, learning=0.0)
J_HOME = np.array([0.0, -10.0, -15.0, 9.0, 5.0, -15.0, -9.0, 5.0, -15.0])
"""About the Jacobian at home (rad/m), row by row."""
IN_THE_CENTRE = (0.0, 0.0)
PRESS = Press.model_construct(point=IN_THE_CENTRE, force=5.0, build_up=1.0, hold=2.0)
TAP = Tap.model_construct(point=IN_THE_CENTRE, force=3.0, speed=0.1, lift=0.006, period=0.4, times=5)
ROLL = Roll.model_construct(point=IN_THE_CENTRE, force=4.0, build_up=1.0, radius=0.005, rate=1.0, turns=2.0)
PUSH = Push.model_construct(point=(0.0, 0.01), force=4.0, build_up=1.0, to=(0.0, -0.01), speed=0.02)


def task_controller(
    tasks,
    approach=APPROACH,
    law=LAW,
    forward=FORWARD,
    damping=UNDAMPED,
    touch=TOUCH,
    position=0.0,
    force=FORCE_GAINS,
    adapting=None,
):
    """The task controller under test, above the first point."""
    start = (*tasks[0].point, approach.height)
    gains = Gains(position)
    return TaskController(
        law, gains, force, forward, damping, touch, program(approach, CONTACT, tasks), start, adapting=adapting
    )


class World(NamedTuple):
    """What the controller meets.

    Attributes:
        follows: "command": the platform is where it was told to be a call ago, exactly; "velocity": in z it moves at
            the reference's velocity of `late` calls ago, as drives do that are fed forward.
        gone: (start, end) in s during which there is no floor. stuck: likewise, in which z does not follow.
        lifted: (time, height): from then on (s) the floor is so much higher (m).
        noise: force that the estimate is wrong by (N), drawn anew for every call.
        drag: force per speed that the estimate takes for pressing where the platform goes down (N s/m).
    """

    follows: str = "command"
    late: int = 0
    gone: tuple[float, float] = (0.0, 0.0)
    stuck: tuple[float, float] = (0.0, 0.0)
    lifted: tuple[float, float] = (0.0, 0.0)
    noise: float = 0.0
    drag: float = 0.0


OBEDIENT = World()


def carried_out(tasks, seconds, world=OBEDIENT, **settings):
    """Outputs of the task controller by port, and the platform's "z", call by call."""
    component = task_controller(tasks, **settings)
    controller = ComponentStepper(component)
    calls = round(seconds / T_s)
    rows = np.empty((calls, len(component.initial_outputs)))
    heights = np.empty(calls)
    p = np.array([*tasks[0].point, settings.get("approach", APPROACH).height])
    noise = world.noise * np.random.default_rng(1).uniform(-1.0, 1.0, calls)
    estimates = np.concatenate([p, J_HOME, np.zeros(6)])
    z_before = p[2]
    for k in range(calls):
        there = not world.gone[0] <= k * T_s < world.gone[1]
        floor = FLOOR + world.lifted[1] * (k * T_s >= world.lifted[0])
        F_z = STIFFNESS * max(0.0, floor - p[2]) * there + noise[k] - world.drag * (p[2] - z_before) / T_s
        z_before = p[2]
        estimates[:3], estimates[14] = p, -F_z
        rows[k], heights[k] = controller(estimates, k * T_s, T_s), p[2]
        if world.follows == "command":
            p = rows[k, 6:9]
        elif k >= world.late and not world.stuck[0] <= k * T_s < world.stuck[1]:
            p[2] += T_s * rows[k - world.late, 15]
    sizes = np.cumsum([port.size for port in component.outputs])
    values = np.split(rows, sizes[:-1], axis=1)
    named = {port.name: v.squeeze() for port, v in zip(component.outputs, values, strict=True)}
    return named | {"z": heights, "t": np.arange(calls) * T_s}


def phases_of(rows):
    """(task, kind, first call) of each phase that was walked through, in order."""
    both = np.stack([rows["task"], rows["phase"]], axis=1).astype(int)
    first = np.flatnonzero(np.any(np.diff(both, axis=0, prepend=0) != 0, axis=1))
    return [(*map(int, both[k]), int(k)) for k in first]
