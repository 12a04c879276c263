"""Capability of a robot at the height of its surface, from geometry, springs, encoders and drives.

With tau_l = k_s N eta (theta_m - N theta_l) (Eq. 18-20), dtheta_l = J dp_B (Eq. 13-17) and F_ee_B = J^T tau_l + weight
(Eq. 21-27) at the working pose p = (0, 0, height):

- stiffness along an axis e, the others held, motors held: e^T J^T k J e, k = k_s N^2 eta.
- natural frequency along e: see `own_robot.natural_frequency`.
- smallest force along e: it turns some joint by a whole count of its encoder, k (2 pi / n_l) / max_i |(J^-T e)_i|.
- force of the counts along e: of one count on all six encoders, k_s N eta (2 pi / n_m + N 2 pi / n_l) sum_i |J_ie|.
- largest force along e: no motor torque beyond the drive's stall torque T, |(J^-T (F e - weight))_i| <= N eta T; along
  x and y the smaller of both directions, along z downwards.
- largest speed along e: no motor faster than the drive runs without load at the controller's limit, N |J e|_i <= omega.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin.kernel.errors import InputRefused
from twin.robot.assembly.checks.reach import free_poses
from twin.robot.assembly.drives import plan_drive
from twin.robot.assembly.own_robot import APPROACH_HEIGHT, FLOOR_DEPTH, cylinder_poses, natural_frequency
from twin.robot.experiment.differences import robot_values
from twin.robot.experiment.experiment import Experiment
from twin.robot.experiment.schema import Drive
from twin.robot.mechanism.geometry import geometry_of
from twin.robot.mechanism.kinematics import distal_volume, jacobian, joint_angles, transmission_sines
from twin.robot.mechanism.statics import Masses, force_on_environment, platform_stiffness
from twin.studies.accuracy.budget import UNCERTAINTIES, accuracy_budget
from twin.studies.command import Say, ignore_progress
from twin.studies.qualify.bench import response
from twin.studies.qualify.definitions import AVERAGE_TIME, MAX_LOAD, TICK
from twin.studies.qualify.motion import overload, stall_torque

Numbers = NDArray[np.float64]
REACH_STEPS = 150
"""Steps per length of the distal links in the search for an edge of the reach, which is then bisected."""
EDGE_TOLERANCE = 1e-6
"""Tolerance (m) of the edges of the reach."""
RUN_UP = 1.0
"""Time (s) before the drive's speed is measured."""
RANKED_VALUES = 5
IN_RUN = ("encoder counts", "backlash")
"""Imperfections of the accuracy budget that are values of the robot."""


class DriveLimits(NamedTuple):
    """Stall torque (N m) and speed without load (rad/s) at a motor shaft; a remark if the torque is a lower bound."""

    label: str
    torque: float
    speed: float
    remark: str


class RankedValue(NamedTuple):
    """A value of the robot, its effect on the estimated force, rms (N), and the reason for the assumed change."""

    label: str
    rms: float
    meaning: str


@dataclass(frozen=True)
class Capability:
    """Capability of a robot, SI; vectors (3,) along x, y, z, see above.

    Attributes:
        pose: working pose on the axis (m).
        reach_z: lowest and highest free z on the axis (m).
        radius, bottom, top: largest free vertical cylinder about the axis, between floor and travelling height (m).
        serial, parallel: distance from singularities at the pose: least `transmission_sines`, size of `distal_volume`.
        least_serial, least_parallel: the same, least in the cylinder.
        weight, weight_deflection, sag: own weight that the springs carry at the platform (N), the largest deflection
            (rad, motor side) and the descent of the platform with the motors held (m) by it.
        own, assumed: number of own values of [robot], keys whose source begins with "assumed".
        ranking, unranked: values that matter most for the force, the largest first, or the reason for none.
    """

    name: str
    pose: Numbers
    reach_z: tuple[float, float]
    radius: float
    bottom: float
    top: float
    serial: float
    parallel: float
    least_serial: float
    least_parallel: float
    stiffness: Numbers
    natural_frequency: Numbers
    smallest_force: Numbers
    count_force: Numbers
    largest_force: Numbers
    largest_speed: Numbers
    weight: float
    weight_deflection: float
    sag: float
    drives: tuple[DriveLimits, ...]
    own: int
    assumed: tuple[str, ...]
    ranking: tuple[RankedValue, ...]
    unranked: str


def capability(experiment: Experiment, rank: bool = True, say: Say = ignore_progress) -> Capability:
    """Compute the capability of an experiment's true robot; its drives are measured through their FMUs.

    `rank`: order the values by their effect on the force.

    Raises:
        InputRefused: the working pose is not free, or a drive is invalid.
        ComponentFailed: a drive failed.
    """
    plant, height, approach = experiment.plant, experiment.contact.height, experiment.approach
    geometry, pose, step = geometry_of(plant), np.array([0.0, 0.0, height]), plant.l_b / REACH_STEPS

    def is_free(z: float) -> bool:
        return z < 0.0 and bool(free_poses(plant, np.array([[0.0, 0.0, z]]))[0])

    if not is_free(height):
        raise InputRefused(
            f"{experiment.name}: the surface at z = {1e3 * height:g} mm is out of the robot's free reach"
        )
    bottom = approach.floor if approach else height - 1e-3 * FLOOR_DEPTH
    top = approach.height if approach else height + 1e-3 * APPROACH_HEIGHT
    radius = _edge(step, lambda r: bool(free_poses(plant, cylinder_poses(r, bottom, top)).all()))
    J, inside = jacobian(geometry, pose), jacobian(geometry, cylinder_poses(radius, bottom, top) if radius else pose)
    k, back = plant.k_s * plant.N**2 * plant.eta, np.linalg.inv(J).T
    masses = Masses(plant.m_a, plant.m_b, plant.m_p, plant.I_r)
    theta_l = joint_angles(geometry, pose)
    weight = force_on_environment(geometry, masses, theta_l, pose, np.zeros(3))
    say("drives", 0.0)
    # equal drives are measured once
    firsts = [experiment.drives.index(table) for table in experiment.drives]
    measured = {n: _measure_drive(experiment.drives[n], experiment.controller.speed_limit) for n in {*firsts}}
    drives = tuple(measured[n] for n in firsts)
    held, carried = plant.N * plant.eta * np.array([one.torque for one in drives])[:, None], (back @ weight)[:, None]
    speed = np.array([one.speed for one in drives])[:, None] / plant.N
    count_m, count_l = 2.0 * math.pi / plant.motor_counts_per_turn, 2.0 * math.pi / plant.joint_counts_per_turn
    stiffness, robot = platform_stiffness(J, k), experiment.values["robot"]
    with np.errstate(divide="ignore"):
        up, down = (np.min((held + way * np.sign(back) * carried) / np.abs(back), axis=0) for way in (1.0, -1.0))
        largest_speed = np.min(speed / np.abs(J), axis=0)
    ranking, unranked = _ranking(experiment, say) if rank else ((), "not asked for")
    return Capability(
        name=experiment.name,
        pose=pose,
        reach_z=(
            height - _edge(step, lambda d: is_free(height - d)),
            height + _edge(step, lambda d: is_free(height + d)),
        ),
        radius=radius,
        bottom=bottom,
        top=top,
        serial=float(transmission_sines(geometry, J).min()),
        parallel=float(abs(distal_volume(J))),
        least_serial=float(transmission_sines(geometry, inside).min()),
        least_parallel=float(np.abs(distal_volume(inside)).min()),
        stiffness=stiffness,
        natural_frequency=natural_frequency(plant, pose),
        smallest_force=k * count_l / np.abs(back).max(axis=0),
        count_force=plant.k_s * plant.N * plant.eta * (count_m + plant.N * count_l) * np.abs(J).sum(axis=0),
        largest_force=np.array([*np.minimum(up, down)[:2], down[2]]),
        largest_speed=largest_speed,
        weight=float(-weight[2]),
        weight_deflection=float(np.abs(carried).max() / (plant.k_s * plant.N * plant.eta)),
        sag=float(-weight[2] / stiffness[2]),
        drives=drives,
        own=robot_values(experiment.values, experiment.origins)["own"],
        assumed=tuple(key for key in robot if experiment.origins.get(f"robot.{key}", "").startswith("assumed")),
        ranking=ranking,
        unranked=unranked,
    )


def _edge(step: float, is_free: Callable[[float], bool]) -> float:
    """Return the largest distance (m) up to which all are free, by steps of `step`; 0 if none is."""
    good = 0.0
    while is_free(good + step):
        good += step
    bad = good + step
    while bad - good > EDGE_TOLERANCE:
        middle = 0.5 * (good + bad)
        good, bad = (middle, bad) if is_free(middle) else (good, middle)
    return good


def _measure_drive(table: Drive, command: float) -> DriveLimits:
    plan = plan_drive(table)
    stall = stall_torque(plan, overload(plan))
    ticks = round((RUN_UP + AVERAGE_TIME) / TICK)
    free = response(plan, np.full(ticks, command), np.zeros(ticks))
    torque = MAX_LOAD if stall.value is None else stall.value
    return DriveLimits(
        plan.label, torque, free.mean_speed(RUN_UP, RUN_UP + AVERAGE_TIME), stall.remark * (stall.value is None)
    )


def _ranking(experiment: Experiment, say: Say) -> tuple[tuple[RankedValue, ...], str]:
    """Return the values that matter most for the estimated force, by the accuracy budget, or a reason for none."""
    try:
        budget = accuracy_budget(experiment, say)
    except InputRefused as problem:
        return (), str(problem)
    found = [RankedValue(one.label, one.rms, one.meaning) for one in budget.contributions if one.label in IN_RUN]
    alike: dict[tuple[str, ...], list[RankedValue]] = {}
    for uncertainty, one in zip(UNCERTAINTIES, budget.contributions_of("parameter"), strict=True):
        alike.setdefault(uncertainty.names, []).append(RankedValue(one.label, one.rms, one.meaning))
    for values in alike.values():
        label = values[0].label.replace("encoder 1", "encoders")
        found.append(RankedValue(label, math.hypot(*(value.rms for value in values)), values[0].meaning))
    return tuple(sorted(found, key=lambda one: -one.rms)[:RANKED_VALUES]), ""
