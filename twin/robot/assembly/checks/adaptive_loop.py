"""Consistency of the controller's options beyond the paper's law: tissue, schedule, breath, learning taps."""

from collections.abc import Iterator
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from twin.kernel.settings import Triple
from twin.robot.assembly.build import tissue_sensing
from twin.robot.controller.pid import low_pass_share
from twin.robot.controller.schedule import SchedulePoint, gains_at, schedule_table
from twin.robot.controller.task_controller import Computer
from twin.robot.mechanism.geometry import geometry_of
from twin.robot.mechanism.kinematics import jacobian
from twin.robot.plant.dynamics import TrueRobot

MAX_BAND_RATIO = 0.05
"""Maximum centre frequency of the tissue estimate times the controller's period: 20 calls per swing."""
RUNGE_KUTTA_STEPS = 4
"""Runge-Kutta steps per period of the controller."""


class Loop(NamedTuple):
    """Model of the robot's vertical motion on a tissue: one mass on its springs, with a first-order drive; SI.

    Attributes:
        mass, spring, friction: moving mass (kg), stiffness in z (N/m), joint friction in z (N s/m).
        lag: lag of the drive (s).
        kp: gain of the position loop (1/s).
        corner: corner frequency of the force's low-pass (Hz).
        give, slow: gain (1/s) and corner of the motors' yielding to swings of the springs' torque.
        period: period of the controller (s).
    """

    mass: float
    spring: float
    friction: float
    lag: float
    kp: float
    corner: float
    give: float
    slow: float
    period: float


def spectral_radius(loop: Loop, stiffness: float, kp: float, ki: float) -> float:
    """Compute the largest pole magnitude of the sampled position and force loops on a tissue.

    The tissue has `stiffness` (N/m), the force law the given gains. The continuous states are height, speed, motor and
    drive speed; the command is held for a period.
    """
    m, K = loop.mass, loop.spring
    A = np.zeros((5, 5))
    A[0, 1] = 1.0
    A[1] = [-(K + stiffness) / m, -loop.friction / m, K / m, 0.0, 0.0]
    A[2, 3] = 1.0
    # a drive without lag is modelled with a very short one
    A[3, 3:] = np.array([-1.0, 1.0]) / max(loop.lag, 0.2 * loop.period)
    z = A * (loop.period / RUNGE_KUTTA_STEPS)
    one = np.eye(5)
    held = np.linalg.matrix_power(one + z @ (one + z / 2.0 @ (one + z / 3.0 @ (one + z / 4.0))), RUNGE_KUTTA_STEPS)
    # further states: low-passed force, integral, slow force of the springs
    F = np.zeros(8)
    F[[0, 2]] = K, -K
    force, giving = low_pass_share(loop.corner, loop.period), low_pass_share(loop.slow, loop.period)
    sampled = np.eye(8)
    sampled[5] = force * F
    sampled[5, 5] += 1.0 - force
    sampled[6] -= ki * loop.period * sampled[5]
    sampled[7] = giving * F
    sampled[7, 7] += 1.0 - giving
    shift = kp * sampled[5] - sampled[6]
    command = loop.kp * shift + loop.give / K * (F - sampled[7])
    command[0] -= loop.kp
    sampled[4] = command
    whole = np.eye(8)
    whole[:5, :5] = held
    return float(np.abs(np.linalg.eigvals(whole @ sampled)).max())


def adaptive_errors(computer: Computer, plant: TrueRobot | None, start: Triple | None) -> Iterator[str]:
    """Yield an error message for each adaptive option that the controller cannot fulfil on this robot.

    Args:
        plant: true robot; None if its table is invalid.
        start: initial platform position (m); None if unknown.
    """
    touch, force = computer.touch, computer.force
    needs = {
        "[controller.force] schedule": bool(force.schedule),
        "[controller.breath]": computer.breath is not None,
        "[controller.touch] force_learning": touch is not None and touch.force_learning > 0.0,
    }
    if computer.tissue is None:
        yield from (
            f"{name} needs [controller.tissue], which it takes the stiffness from; add it"
            for name in needs
            if needs[name]
        )
        return
    if computer.mode != "force_position":
        mode = f'[controller] mode = "{computer.mode}"'
        yield f"{mode}: never presses by force, so [controller.tissue] never learns; remove that"
    if computer.tissue.frequency * computer.period > MAX_BAND_RATIO:
        yield (
            f"[controller.tissue] frequency_Hz = {computer.tissue.frequency:g}: the controller is called every "
            f"{1e3 * computer.period:g} ms; expected at most {MAX_BAND_RATIO / computer.period:g}"
        )
    if force.schedule and plant is not None and start is not None:
        yield from _unstable_gains(computer, plant, start)


def believed_loop(computer: Computer, plant: TrueRobot, start: Triple) -> Loop:
    """Build the model of vertical motion for the check of scheduled gains, as the controller believes the robot."""
    known, model = tissue_sensing(computer, start), computer.model
    squares = float(np.sum(jacobian(geometry_of(model), start)[:, 2] ** 2))
    forward, damping = computer.feed_forward, computer.damping
    return Loop(
        mass=known.mass + (known.inertia + plant.I_r) * squares,
        spring=known.joint_spring * squares,
        friction=plant.b_j * squares,
        lag=0.0 if forward is None else forward.lag,
        kp=computer.position.kp,
        corner=computer.force.filter,
        give=0.0 if damping is None else damping.gain * model.k_s,
        slow=0.0 if damping is None else damping.corner,
        period=computer.period,
    )


def _unstable_gains(computer: Computer, plant: TrueRobot, start: Triple) -> Iterator[str]:
    """Yield an error message for the first scheduled gains that are unstable on their tissue stiffness.

    Checked are the points of the schedule and the midpoints between them.
    """
    loop = believed_loop(computer, plant, start)
    points = [SchedulePoint.from_tables(point) for point in computer.force.schedule]
    table = schedule_table(points).view(np.recarray)
    tried = [(f"point {n}", point) for n, point in enumerate(points, start=1)]
    for n, (below, above) in enumerate(pairwise(points), start=1):
        middle = float(np.sqrt(below.stiffness * above.stiffness))
        tried.append((f"between points {n} and {n + 1}", SchedulePoint(middle, *gains_at(table, 0, middle)[:2])))
    for name, (stiffness, kp, ki) in tried:
        if spectral_radius(loop, stiffness, kp, ki) >= 1.0:
            gains = f"kp = {1e3 * kp:.3g} mm/N and ki = {1e3 * ki:.3g} mm/(N s)"
            yield (
                f"[controller.force] schedule: {name}: {gains} shake on {stiffness:.4g} N/m, with a drive that lags as "
                "the controller believes; expected gains that are stable where they act: lower them, or let twin tune "
                "--schedule find some"
            )
            return
