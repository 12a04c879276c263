"""What `twin robot` reports of robots of other shapes, found again by search."""

import math
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest

from tests.studies.workspace.brute_force import BruteRobot
from twin.robot.assembly.own_robot import load_on_robot, start_robot
from twin.studies.workspace.capability import Capability, capability

ROBOTS = {
    "shipped": "a=50 b=30 l_a=60 l_b=113.9",
    "0.6 of the size": "a=30 b=18 l_a=36 l_b=68.3",
    "long rods": "a=80 b=35 l_a=100 l_b=180",
    "platform wider than the base": "a=40 b=60 l_a=60 l_b=130",
}
MASSES = "m_a=50 m_b=40 m_p=150"
of_every_robot = pytest.mark.parametrize("name", ROBOTS)
AXES = np.eye(3)


@cache
def robot(name: str) -> tuple[Capability, BruteRobot]:
    with TemporaryDirectory() as folder:
        file = Path(folder) / "mine.toml"
        start_robot(file, ROBOTS[name].split(), MASSES.split())
        experiment = load_on_robot(file)
        found = capability(experiment, rank=False)
        return found, BruteRobot(experiment.plant, np.array(found.pose))


@pytest.mark.slow
@of_every_robot
def test_reach_on_the_axis_ends_where_a_fine_grid_ends(name: str):
    found, brute = robot(name)
    inside = np.arange(found.reach_z[0], found.reach_z[1], 1e-3)[1:]
    assert all(brute.is_free(np.array([0.0, 0.0, z])) for z in inside)
    for end, step in zip(found.reach_z, (-2e-4, 2e-4), strict=True):
        assert not brute.is_free(np.array([0.0, 0.0, end + step])) or end + step >= 0.0
        assert brute.is_free(np.array([0.0, 0.0, end - step]))


@of_every_robot
def test_the_cylinder_is_free_and_a_wider_one_is_not(name: str):
    found, brute = robot(name)
    random = np.random.default_rng(4)
    for _ in range(60):
        r, turn = 0.99 * found.radius * math.sqrt(random.random()), random.uniform(0.0, 2.0 * math.pi)
        z = random.uniform(found.bottom, found.top)
        assert brute.is_free(np.array([r * math.cos(turn), r * math.sin(turn), z]))
    wider = found.radius + 5e-4
    ring = [
        np.array([wider * math.cos(turn), wider * math.sin(turn), z])
        for turn in np.radians(np.arange(0.0, 360.0, 5.0))
        for z in (found.bottom, found.top)
    ]
    assert not all(map(brute.is_free, ring))


@pytest.mark.slow
@of_every_robot
def test_the_smallest_force_turns_a_joint_by_one_count(name: str):
    found, brute = robot(name)
    pose, count = np.array(found.pose), 2.0 * math.pi / brute.plant.joint_counts_per_turn
    rest = brute.pose_angles(pose)
    for axis, force in zip(AXES, found.smallest_force, strict=True):
        grid = np.linspace(0.95, 1.05, 11)
        turned = [np.abs(brute.pose_angles(brute.deflected(pose, s * force * axis)) - rest).max() for s in grid]
        first = grid[np.flatnonzero(np.array(turned) >= count)[0]]
        # one step of the grid, and the bend of the springs' law over a count
        assert first == pytest.approx(1.0, abs=0.011)


@of_every_robot
def test_stiffness_and_weight_follow_from_energies(name: str):
    found, brute = robot(name)
    pose, d = np.array(found.pose), 1e-4
    rest = brute.pose_angles(pose)
    for axis, stiffness in zip(AXES, found.stiffness, strict=True):
        energy = 0.5 * sum(brute.spring_energy(pose + way * d * axis, rest) for way in (1.0, -1.0))
        assert 2.0 * energy / d**2 == pytest.approx(stiffness, rel=1e-3)
    rise = (brute.height_energy(pose + d * AXES[2]) - brute.height_energy(pose - d * AXES[2])) / (2.0 * d)
    assert rise == pytest.approx(found.weight, rel=1e-3)


@of_every_robot
def test_the_natural_frequency_follows_from_energies(name: str):
    found, brute = robot(name)
    pose = np.array(found.pose)
    for axis, stiffness, frequency in zip(AXES, found.stiffness, found.natural_frequency, strict=True):
        expected = math.sqrt(stiffness / brute.moving_mass(pose, axis)) / (2.0 * math.pi)
        assert frequency == pytest.approx(expected, rel=1e-4)


@of_every_robot
def test_the_drives_hold_the_largest_force_and_no_more(name: str):
    found, brute = robot(name)
    pose, c = np.array(found.pose), brute.plant
    rates = brute.angle_rates(pose)
    pull = np.array([brute.height_energy(pose + 1e-5 * e) - brute.height_energy(pose - 1e-5 * e) for e in AXES]) / 2e-5
    held = np.array([c.N * c.eta * drive.torque for drive in found.drives])
    for axis, way in ((0, 1.0), (0, -1.0), (1, 1.0), (1, -1.0), (2, -1.0)):
        grid = np.linspace(0.0, 1.05, 2101) * found.largest_force[axis]
        # virtual work: torques . d theta = (force on the body + weight) . d p
        torques = np.linalg.solve(rates.T, (way * np.multiply.outer(grid, AXES[axis]) + pull).T).T
        largest = grid[(np.abs(torques) <= held).all(axis=1)].max()
        assert largest >= found.largest_force[axis] * 0.999
        if axis == 2:
            assert largest == pytest.approx(found.largest_force[axis], rel=2e-3)
    speeds = [drive.speed for drive in found.drives]
    for axis in range(3):
        motors = c.N * np.abs(rates[:, axis]) * found.largest_speed[axis]
        assert (motors / speeds).max() == pytest.approx(1.0, rel=1e-4)
