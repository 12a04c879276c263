"""Capability of a robot, against statics and kinematics that do without its formulas."""

from dataclasses import replace
from pathlib import Path
from unittest import mock

import numpy as np
import pytest

from twin.kernel.errors import InputRefused
from twin.robot.assembly.build import plant_parameters
from twin.robot.assembly.checks.reach import find_obstruction, reach_error
from twin.robot.assembly.own_robot import load_on_robot, start_robot
from twin.robot.experiment.experiment import Experiment
from twin.robot.mechanism.geometry import geometry_of
from twin.robot.mechanism.kinematics import joint_angles, position
from twin.robot.mechanism.statics import Masses, force_on_environment
from twin.robot.plant.component import rest_state
from twin.robot.plant.contact import apex_frame
from twin.robot.plant.dynamics import INITIAL_ANCHORS, acceleration
from twin.studies.accuracy.budget import accuracy_budget
from twin.studies.result import render_text
from twin.studies.workspace import capability as study
from twin.studies.workspace.capability import Capability, capability
from twin.studies.workspace.text import capability_result, draw_capability

Case = tuple[Experiment, Capability]


@pytest.fixture(scope="module", params=["shipped", "other"])
def case(request: pytest.FixtureRequest, root: Path, tmp_path_factory: pytest.TempPathFactory) -> Case:
    """The shipped robot, and one of another shape with other springs and encoders."""
    path = root / "experiments" / "robots" / "massage_robot.toml"
    if request.param == "other":
        path = tmp_path_factory.mktemp("robot") / "other.toml"
        more = ["robot.k_s_Nm_per_rad=1.5", "robot.joint_counts_per_turn=8192", "robot.eta=0.9"]
        start_robot(path, ["a=80", "b=35", "l_a=100", "l_b=180"], ["m_p=140"], more)
    experiment = load_on_robot(path)
    return experiment, capability(experiment, rank=False)


def _spring_torques(experiment: Experiment, p_B: np.ndarray, theta_m: np.ndarray) -> np.ndarray:
    p = experiment.plant
    return p.k_s * p.N * p.eta * (theta_m - p.N * joint_angles(geometry_of(p), p_B))


def _force(experiment: Experiment, p_B: np.ndarray, tau_l: np.ndarray) -> np.ndarray:
    p = experiment.plant
    masses = Masses(p.m_a, p.m_b, p.m_p, p.I_r)
    return force_on_environment(geometry_of(p), masses, joint_angles(geometry_of(p), p_B), p_B, tau_l)


def _torques(experiment: Experiment, p_B: np.ndarray, F_ee_B: np.ndarray) -> np.ndarray:
    """Spring torques at which the robot exerts a force: the force is affine in them."""
    unloaded = _force(experiment, p_B, np.zeros(3))
    columns = np.array([_force(experiment, p_B, one) - unloaded for one in np.eye(3)]).T
    return np.linalg.solve(columns, F_ee_B - unloaded)


def test_stiffness_is_the_force_of_a_small_displacement_with_the_motors_held(case: Case):
    experiment, done = case
    p_B, h = np.array(done.pose), 1e-6
    # unloaded springs: a loaded spring's force also turns with the links
    theta_m = experiment.plant.N * joint_angles(geometry_of(experiment.plant), p_B)
    for axis, e in enumerate(np.eye(3)):
        ends = [_force(experiment, p, _spring_torques(experiment, p, theta_m)) for p in (p_B + h * e, p_B - h * e)]
        weights = [_force(experiment, p, np.zeros(3)) for p in (p_B + h * e, p_B - h * e)]
        change = (ends[0] - weights[0]) - (ends[1] - weights[1])
        assert -change[axis] / (2.0 * h) == pytest.approx(done.stiffness[axis], rel=1e-6)


def test_the_natural_frequency_is_that_of_the_plant_within_its_coupling_terms(case: Case):
    experiment, done = case
    parameters = plant_parameters(experiment.plant, experiment.contact)._replace(K=0.0, b_j=0.0, backlash=0.0)
    x, theta_m = rest_state(parameters, (0.0, 0.0, done.pose[2]))
    apex, h = apex_frame(parameters), 1e-6
    for axis in range(3):
        ends = []
        for way in (h, -h):
            p = tuple(x[:3] + way * np.eye(3)[axis])
            a, _ = acceleration(
                parameters, p, (0.0, 0.0, 0.0), (0.0, 0.0), tuple(theta_m), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), apex,
                INITIAL_ANCHORS.copy(), False,
            )  # fmt: skip
            ends.append(a[axis])
        omega = np.sqrt((ends[1] - ends[0]) / (2.0 * h))
        # the rods' coupling terms, and loaded springs that turn with the links
        assert omega / (2.0 * np.pi) == pytest.approx(done.natural_frequency[axis], rel=0.15)


def test_soft_springs_are_noted(case: Case):
    _, done = case
    soft = replace(done, natural_frequency=0.2 * done.natural_frequency)
    assert "below 6 Hz" in render_text(capability_result(soft, {}))
    assert "below 6 Hz" not in render_text(capability_result(done, {}))


def test_the_smallest_force_turns_a_joint_by_a_count(case: Case):
    experiment, done = case
    p, p_B = experiment.plant, np.array(done.pose)
    for e, F in zip(np.eye(3), done.smallest_force, strict=True):
        more = _torques(experiment, p_B, F * e) - _torques(experiment, p_B, 0.0 * e)
        turned = np.abs(more) / (p.k_s * p.N**2 * p.eta)
        assert turned.max() == pytest.approx(2.0 * np.pi / p.joint_counts_per_turn)


def test_no_six_counts_are_worth_more_than_the_force_of_the_counts(case: Case):
    experiment, done = case
    p, p_B = experiment.plant, np.array(done.pose)
    motor, joint = 2.0 * np.pi / p.motor_counts_per_turn, 2.0 * np.pi / p.joint_counts_per_turn
    signs = np.array(np.meshgrid(*[[-1, 0, 1]] * 6)).reshape(6, -1).T
    tau = p.k_s * p.N * p.eta * (motor * signs[:, :3] - p.N * joint * signs[:, 3:])
    unloaded = _force(experiment, p_B, np.zeros(3))
    forces = np.array([_force(experiment, p_B, one) - unloaded for one in tau])
    assert np.abs(forces).max(axis=0) == pytest.approx(done.count_force)


def test_at_the_largest_force_one_motor_is_at_its_stall_torque(case: Case):
    experiment, done = case
    p, p_B = experiment.plant, np.array(done.pose)
    stall = done.drives[0].torque
    for e, F in zip(((1, 0, 0), (0, 1, 0), (0, 0, -1)), done.largest_force, strict=True):
        ways = [
            np.abs(_torques(experiment, p_B, way * F * np.array(e))).max() for way in ((1, -1) if e[2] == 0 else (1,))
        ]
        assert max(ways) / (p.N * p.eta) == pytest.approx(stall)
    # the springs of a robot that only carries its weight
    hanging = _torques(experiment, p_B, np.zeros(3))
    assert done.weight_deflection == pytest.approx(np.abs(hanging).max() / (p.k_s * p.N * p.eta))
    assert done.sag == pytest.approx(done.weight / done.stiffness[2])


def test_at_the_largest_speed_one_motor_runs_as_fast_as_without_load(case: Case):
    experiment, done = case
    geometry, p_B, dt = geometry_of(experiment.plant), np.array(done.pose), 1e-7
    for e, v in zip(np.eye(3), done.largest_speed, strict=True):
        turned = joint_angles(geometry, p_B + v * dt * e) - joint_angles(geometry, p_B - v * dt * e)
        assert np.abs(turned).max() * experiment.plant.N / (2.0 * dt) == pytest.approx(done.drives[0].speed, rel=1e-6)
    assert done.drives[0].speed == pytest.approx(experiment.controller.speed_limit, rel=0.05)


def test_just_inside_the_reach_is_free_and_just_outside_is_not(case: Case):
    experiment, done = case
    geometry, plant, little = geometry_of(experiment.plant), experiment.plant, 1e-5

    def is_free(*p_B: float) -> bool:
        place = np.array([p_B])
        if reach_error(geometry, place) is not None or find_obstruction(plant, place):
            return False
        # on the home pose's side of the parallel singularity the joint angles have this pose
        return bool(np.allclose(position(geometry, joint_angles(geometry, place)), place, atol=1e-9))

    low, high = done.reach_z
    assert low < done.bottom < done.pose[2] < done.top < high
    assert is_free(0.0, 0.0, low + little) and not is_free(0.0, 0.0, low - little)
    assert is_free(0.0, 0.0, high - little) and not is_free(0.0, 0.0, high + little)
    angles = np.radians(np.arange(0.0, 360.0, 1.0))
    for r, expected in ((done.radius - 1e-4, True), (done.radius + 1e-4, False)):
        rims = [is_free(r * np.cos(a), r * np.sin(a), z) for z in (done.bottom, done.top) for a in angles]
        assert all(rims) == expected


def test_distances_from_singularities_are_those_of_the_worst_pose(case: Case):
    _, done = case
    assert 0.0 < done.least_serial <= done.serial <= 1.0
    assert 0.0 < done.least_parallel <= done.parallel <= 1.0


def test_the_springs_carry_the_weight_of_platform_and_links(root: Path):
    light = load_on_robot(root / "experiments" / "robots" / "massage_robot.toml", ["plant.m_p_g=50"])
    heavy = load_on_robot(root / "experiments" / "robots" / "massage_robot.toml", ["plant.m_p_g=150"])
    with mock.patch.object(study, "_measure_drive", lambda *_: study.DriveLimits("none", 1.0, 1.0, "")):
        weights = [capability(one, rank=False).weight for one in (light, heavy)]
    assert weights[1] - weights[0] == pytest.approx(0.1 * 9.81)


def test_a_surface_out_of_reach_is_refused(root: Path):
    with pytest.raises(InputRefused, match="out of the robot's free reach"):
        capability(load_on_robot(root / "experiments" / "fig4_position.toml", ["contact.height_mm=-400"]), rank=False)


def test_what_is_assumed_and_what_is_own_is_listed(case: Case):
    experiment, done = case
    own = sum(not text.startswith(("assumed", "Sec.", "Eq.")) for text in (
        experiment.origins[f"robot.{key}"] for key in experiment.values["robot"] if key != "name"
    ))  # fmt: skip
    assert done.own == own
    assert "backlash_deg" in done.assumed and "k_s_Nm_per_rad" not in done.assumed
    assert ("a_mm" in done.assumed) == (own == 0)


@pytest.mark.slow
def test_the_five_values_are_the_largest_of_the_accuracy_budget(root: Path):
    experiment = load_on_robot(root / "experiments" / "robots" / "massage_robot.toml")
    ranking, reason = study._ranking(experiment, lambda *_: None)
    budget = accuracy_budget(experiment)
    parameters = {one.label: one.rms for one in budget.contributions_of("parameter")}
    zeros = [rms for label, rms in parameters.items() if label.startswith("zero of joint")]
    assert reason == "" and len(ranking) == 5
    assert [one.rms for one in ranking] == sorted((one.rms for one in ranking), reverse=True)
    found = {one.label: one.rms for one in ranking}
    assert found["masses +5 %"] == parameters["masses +5 %"]
    assert found["zero of joint encoders +0.05 deg"] == pytest.approx(np.sqrt(np.sum(np.square(zeros))))
    assert all(
        rms <= min(found.values()) for label, rms in parameters.items() if label not in found and "zero" not in label
    )


def test_an_experiment_without_a_budget_says_why(root: Path):
    ranking, reason = study._ranking(load_on_robot(root / "experiments" / "tapping.toml"), lambda *_: None)
    assert ranking == () and "taps" in reason


def test_page_and_picture(case: Case, tmp_path: Path):
    experiment, done = case
    text = render_text(capability_result(replace(done, unranked="not asked for"), {"picture": "robot.png"}))
    assert max(map(len, text.splitlines())) <= 80
    for word in ("reach", "cylinder", "singular", "stiffness", "smallest force", "largest force", "weight", "assumed"):
        assert word in text
    draw_capability(done, experiment, tmp_path / "robot.png")
    assert (tmp_path / "robot.png").read_bytes().startswith(b"\x89PNG")
