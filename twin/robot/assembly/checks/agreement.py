"""Consistency of the tables of an experiment with one another and with the robot.

The contradictions among the limits of [monitor], and between them and the robot.

Whether what a controller does besides the paper's law fits together: tissue, schedule, breath, taps that learn.
"""

import math
from collections.abc import Collection, Iterator, Mapping
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from twin.kernel.settings import Triple
from twin.robot.assembly.build import monitor_belief, plant_parameters, sensing
from twin.robot.assembly.checks.tasks import Situation, reference_mistakes, task_mistakes
from twin.robot.controller.adaptive import SchedulePoint, gains_at, table_of
from twin.robot.controller.pid import low_pass_share
from twin.robot.controller.task_controller import Computer
from twin.robot.experiment.experiment import Tables
from twin.robot.experiment.fault import CATALOGUE
from twin.robot.experiment.schema import WayPoints
from twin.robot.mechanism.geometry import geometry_of
from twin.robot.mechanism.kinematics import jacobian
from twin.robot.mechanism.unreachable import Unreachable
from twin.robot.monitor.checks import Monitor
from twin.robot.monitor.component import MonitorBelief, Resolution, geometry, press_deflection, resolution
from twin.robot.monitor.component import low_pass_share as monitor_share
from twin.robot.monitor.safe_action import retreat
from twin.robot.plant.dynamics import TrueRobot

DISTINCT = 3.0
"""A limit has to be this many times what the encoders resolve, or rounding alone comes near it."""


def contradictions(monitor: Monitor, belief: MonitorBelief, sample_period: float, speed_limit: float) -> list[str]:
    """Every way in which the limits of [monitor] cannot all mean something, one sentence each; none if not enabled.

    Args:
        belief: the monitor's model of the robot.
        sample_period: between two encoder messages, and between two commands (s).
        speed_limit: of the controller's commands (rad/s).
    """
    if not monitor.enabled:
        return []
    if monitor.z_min >= monitor.z_max:
        # no middle of the workspace to look at the others from
        return [
            f"[monitor] z_min_mm = {1e3 * monitor.z_min:g} is not below z_max_mm = {1e3 * monitor.z_max:g}; "
            "exchange them",
            *_among_times(monitor, sample_period, speed_limit),
        ]
    return [
        *_among_times(monitor, sample_period, speed_limit),
        *_against_robot(monitor, belief, sample_period),
        *_of_retraction(monitor, belief),
    ]


def _among_times(monitor: Monitor, sample_period: float, speed_limit: float) -> list[str]:
    mistakes = []
    shortest = max(monitor.period, sample_period)
    for key in ("stale_time", "frozen_time", "saturation_time", "follow_time", "hidden_time"):
        if getattr(monitor, key) <= shortest:
            mistakes.append(
                f"[monitor] {key}_ms = {1e3 * getattr(monitor, key):g} is no longer than one sample of "
                f"{1e3 * shortest:g} ms; allow several samples"
            )
    if monitor.contact_force >= monitor.force_limit:
        mistakes.append(
            f"[monitor] contact_force_N = {monitor.contact_force:g} is not below force_limit_N = "
            f"{monitor.force_limit:g}; lower it, or no contact is ever seen"
        )
    if monitor.period > sample_period:
        mistakes.append(
            f"[monitor] period_ms = {1e3 * monitor.period:g} holds back the controller's commands, which come every "
            f"{1e3 * sample_period:g} ms; expected at most that"
        )
    if monitor.command_limit is not None and monitor.command_limit > speed_limit:
        mistakes.append(
            f"[monitor] command_limit_rad_per_s = {monitor.command_limit:g} is never reached: the controller commands "
            f"at most {speed_limit:g} rad/s; expected at most that"
        )
    if monitor.retract_speed <= monitor.follow_limit:
        mistakes.append(
            f"[monitor] retract_speed_rad_per_s = {monitor.retract_speed:g} is not above follow_limit_rad_per_s = "
            f"{monitor.follow_limit:g}: a jam would go unseen; raise the one or lower the other"
        )
    return mistakes


def _against_robot(monitor: Monitor, belief: MonitorBelief, sample_period: float) -> list[str]:
    p_B = (0.0, 0.0, 0.5 * (monitor.z_min + monitor.z_max))
    at = f"at z = {1e3 * p_B[2]:g} mm"
    try:
        deflection = press_deflection(belief, p_B, monitor.force_limit)
        one_count = resolution(belief, p_B, sample_period)
    except Unreachable as problem:
        return [f"[monitor] the middle of z_min_mm and z_max_mm: {problem}"]
    mistakes = []
    if deflection >= monitor.deflection_limit:
        mistakes.append(
            f"[monitor] force_limit_N = {monitor.force_limit:g} is never reached: {at} it deflects a spring by "
            f"{math.degrees(deflection):.1f} deg (k_s N eta = {belief.k_s * belief.N * belief.eta:g} N m/rad), and "
            f"deflection_limit_deg = {math.degrees(monitor.deflection_limit):g} trips before; lower the force limit "
            "or raise the other"
        )
    share = monitor_share(monitor.filter, sample_period)
    for key, unit, scale, resolved in _resolved(one_count, share):
        if getattr(monitor, key) < DISTINCT * resolved:
            mistakes.append(
                f"[monitor] {key}_{unit} = {scale * getattr(monitor, key):g} is below the resolution of the "
                f"encoders: one count is worth {scale * resolved:.3g} {at}; expected at least {DISTINCT:g} times that"
            )
    return mistakes


def _resolved(one_count: Resolution, share: float) -> list[tuple[str, str, float, float]]:
    """Limits that encoders bound: attribute, unit of its key, that unit per SI, and one count after the low-pass."""
    return [
        ("force_limit", "N", 1.0, one_count.force),
        ("contact_force", "N", 1.0, one_count.force),
        ("penetration_limit", "mm", 1e3, one_count.position),
        ("deflection_limit", "deg", math.degrees(1.0), one_count.deflection),
        ("frozen_travel", "deg", math.degrees(1.0), one_count.deflection),
        ("jump_limit", "rad_per_s", 1.0, one_count.jump),
        ("speed_limit", "mm_per_s", 1e3, share * one_count.velocity),
        ("force_rate_limit", "N_per_s", 1.0, share * one_count.force_rate),
        ("follow_limit", "rad_per_s", 1.0, share * one_count.motor_speed),
    ]


def _of_retraction(monitor: Monitor, belief: MonitorBelief) -> list[str]:
    """The retraction has to raise the platform from everywhere: looked at around the top and around the bottom."""
    for z in (monitor.z_max, monitor.z_min):
        for angle in range(0, 360, 30):
            x = monitor.workspace_radius * math.cos(math.radians(angle))
            y = monitor.workspace_radius * math.sin(math.radians(angle))
            where = f"from ({1e3 * x:.0f}, {1e3 * y:.0f}, {1e3 * z:.0f}) mm"
            try:
                rises = retreat(geometry(belief), belief.N, (x, y, z), monitor.retract).slowest > 0.0
            except Unreachable as problem:
                return [f"[monitor] the workspace or the retraction leaves the robot's reach {where}: {problem}"]
            if not rises:
                return [
                    f"[monitor] retract_deg = {math.degrees(monitor.retract):g} is longer than the workspace: {where} "
                    "the platform would sink again at the end; retract less or lower z_max_mm"
                ]
    return []


BEST_BAND = 0.05
"""Middle of the estimator's band times the controller's period, at most: 20 calls per swing."""
STEPS = 4
"""Runge-Kutta steps per period of the controller."""


class Loop(NamedTuple):
    """The robot going up and down on a tissue, one mass on its springs, with a drive of first order; SI.

    Attributes:
        mass, spring, friction: of the platform with what moves with it (kg), in z (N/m), of the joints in z (N s/m).
        lag: of the drive (s).
        kp: of the position loop (1/s).
        corner: low-pass on the force (Hz).
        give, slow: share of the springs' speed by which the motors give way to swings (1/s), and its corner (Hz).
        period: of the controller (s).
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


def radius(loop: Loop, stiffness: float, kp: float, ki: float) -> float:
    """Largest magnitude of a pole of the sampled loops on a tissue of `stiffness` (N/m) with gains of the force loop.

    The states are height, speed, motor, the drive's speed; what is held for a period is the command.
    """
    m, K = loop.mass, loop.spring
    A = np.zeros((5, 5))
    A[0, 1] = 1.0
    A[1] = [-(K + stiffness) / m, -loop.friction / m, K / m, 0.0, 0.0]
    A[2, 3] = 1.0
    # a drive without lag is one with a very short one
    A[3, 3:] = np.array([-1.0, 1.0]) / max(loop.lag, 0.2 * loop.period)
    z = A * (loop.period / STEPS)
    one = np.eye(5)
    held = np.linalg.matrix_power(one + z @ (one + z / 2.0 @ (one + z / 3.0 @ (one + z / 4.0))), STEPS)
    # then low-passed force, integral, slow force of the springs
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


def adapting_mistakes(computer: Computer, plant: TrueRobot | None, start: Triple | None) -> Iterator[str]:
    """Each reason why the controller cannot do it, in a sentence.

    Args:
        plant: the robot as it is, if that is right.
        start: where the platform begins (m), if that is known.
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
    if computer.tissue.frequency * computer.period > BEST_BAND:
        yield (
            f"[controller.tissue] frequency_Hz = {computer.tissue.frequency:g}: the controller is called every "
            f"{1e3 * computer.period:g} ms; expected at most {BEST_BAND / computer.period:g}"
        )
    if force.schedule and plant is not None and start is not None:
        yield from _unstable(computer, plant, start)


def believed_loop(computer: Computer, plant: TrueRobot, start: Triple) -> Loop:
    """The loop as the check takes it: a robot at `start` (m), with a drive that lags as the controller believes."""
    known, model = sensing(computer, start), computer.model
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


def _unstable(computer: Computer, plant: TrueRobot, start: Triple) -> Iterator[str]:
    """The first set of gains that shakes on the stiffness that it is for: of a point, or between two."""
    loop = believed_loop(computer, plant, start)
    points = [SchedulePoint.made(point) for point in computer.force.schedule]
    table = table_of(points).view(np.recarray)
    tried = [(f"point {n}", point) for n, point in enumerate(points, start=1)]
    for n, (below, above) in enumerate(pairwise(points), start=1):
        middle = float(np.sqrt(below.stiffness * above.stiffness))
        tried.append((f"between points {n} and {n + 1}", SchedulePoint(middle, *gains_at(table, 0, middle)[:2])))
    for name, (stiffness, kp, ki) in tried:
        if radius(loop, stiffness, kp, ki) >= 1.0:
            gains = f"kp = {1e3 * kp:.3g} mm/N and ki = {1e3 * ki:.3g} mm/(N s)"
            yield (
                f"[controller.force] schedule: {name}: {gains} shake on {stiffness:.4g} N/m, with a drive that lags as "
                "the controller believes; expected gains that are stable where they act: lower them, or let twin tune "
                "--schedule find some"
            )
            return


def disagreements(tables: Tables, reference: WayPoints | None, named: Collection[str]) -> list[str]:
    """Every way in which the tables that are right by themselves do not fit together, one sentence each.

    Args:
        tables: of the experiment.
        reference: its way points, if they are right.
        named: what the file has, right or not.
    """
    checked = tables.by_name
    other = tables.stand_ins
    mistakes = _mode_mistakes(checked, named) + _moved_twice(tables, named)
    models = [checked["plant"]] if "plant" in checked else []
    models += [checked["controller"].model] if "controller" in checked else []
    geometries = tuple(geometry_of(model) for model in models)
    if reference is not None:
        mistakes += reference_mistakes(reference, geometries, checked.get("plant"))
    if "monitor" in checked and "monitor" not in other and {"robot", "controller"} <= checked.keys():
        computer = checked["controller"]
        mistakes += contradictions(
            checked["monitor"], monitor_belief(checked["robot"]), computer.period, computer.speed_limit
        )
    mistakes += _adapting_mistakes(tables, reference)
    if tables.tasks and {"plant", "contact", "approach", "controller", "head"} <= checked.keys():
        monitor = checked.get("monitor")
        situation = Situation(
            plant_parameters(checked["plant"], checked["contact"]),
            checked["plant"],
            geometries,
            checked["approach"],
            checked["controller"],
            monitor if monitor is not None and monitor.enabled and "monitor" not in other else None,
        )
        mistakes += task_mistakes(situation, tables.tasks, tables.duration)
    return mistakes


def _adapting_mistakes(tables: Tables, reference: WayPoints | None) -> list[str]:
    """What the controller does besides the paper's law, where it is twin's own."""
    checked = tables.by_name
    computer = checked.get("controller")
    if computer is None or computer.force is None:
        return []
    start = reference.p[0] if reference is not None else None
    if tables.tasks and "approach" in checked:
        start = (*next(iter(tables.tasks.values())).point, checked["approach"].height)
    return list(adapting_mistakes(computer, checked.get("plant"), start))


def _moved_twice(tables: Tables, named: Collection[str]) -> list[str]:
    """A surface that [body] moves moves as that says alone."""
    if "body" not in tables.stand_ins:
        return []
    contact = tables.by_name.get("contact")
    moving = [f"contact.{name}" for name in ("breathing", "shift") if getattr(contact, name, None) is not None]
    moving += [f"fault {n}" for n, fault in enumerate(tables.faults, 1) if CATALOGUE[fault.kind].mechanism == "body"]
    label = tables.stand_ins["body"].label
    return [f"[{name}]: moves the surface, and so does [body], {label}; remove one" for name in moving]


def _mode_mistakes(checked: Mapping[str, Any], named: Collection[str]) -> list[str]:
    """Way points or tasks, position or force: what of the other tables that needs is missing, or is too much."""
    has_tasks = "task" in named
    if has_tasks == ("reference" in named):
        return ["expected either [reference] with way points or [[task]] tables" + (", not both" if has_tasks else "")]
    if "controller" not in checked:
        return []
    computer = checked["controller"]
    if computer.force is None:
        # third-party, with modes and gains of its own
        return ["missing table [approach], which tasks need"] if has_tasks and "approach" not in named else []
    force = {
        "reference_N": computer.force.reference,
        "trigger_N": computer.force.trigger,
        "trigger_time_s": computer.force.trigger_time,
    }
    if not has_tasks:
        missing = computer.mode == "force_position" and computer.force.reference is None
        return ["[controller.force] missing key 'reference_N'"] if missing else []
    mistakes = [] if "approach" in named else ["missing table [approach], which tasks need"]
    for name in ("touch", "feed_forward", "damping"):
        if getattr(computer, name) is None:
            mistakes.append(f"missing table [controller.{name}], which tasks need")
    if computer.mode != "force_position":
        mistakes.append(f'[controller] mode = "{computer.mode}": tasks press; expected "force_position"')
    mistakes += [
        f"[controller.force] {key}: tasks have a force of their own and feel contact by [controller.touch]; remove it"
        for key, value in force.items()
        if value is not None
    ]
    return mistakes
