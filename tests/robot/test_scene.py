"""The frames close the chain wherever the robot works."""

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader
from scipy.spatial.transform import Rotation

from tests.robot.mechanism.poses import GEOMETRY, HOME, triple, working_poses
from tests.robot.scene.pictures import at, frames, messages, numbers
from twin.kernel.errors import InputRefused
from twin.kernel.recording.reader import Recording, read
from twin.robot.assembly.load import load_experiment
from twin.robot.mechanism.geometry import AXIS, OUTWARD
from twin.robot.mechanism.kinematics import joint_angles
from twin.robot.run.run import execute
from twin.robot.scene import (
    ARROW_LENGTH,
    ESTIMATE_OFFSET,
    HALF_WIDTH,
    IDENTITY_ROTATION,
    SCENE_FRAMES,
    axis_rotation,
    direction_rotation,
    poses,
    product,
)

# rounding of a dozen operations on numbers up to 1
ROUNDING = 1e-14
angles = st.floats(-math.pi, math.pi)
axes = st.sampled_from([0, 1, 2])


@given(axes, angles)
def test_a_turn_is_right_handed_about_its_axis(axis, angle):
    expected = Rotation.from_euler("xyz"[axis], angle).as_matrix()
    np.testing.assert_allclose(Rotation.from_quat(axis_rotation(axis, angle)).as_matrix(), expected, atol=ROUNDING)


@given(axes, angles, axes, angles)
def test_a_product_turns_by_its_second_factor_first(axis, angle, other_axis, other_angle):
    p, q = axis_rotation(axis, angle), axis_rotation(other_axis, other_angle)
    expected = Rotation.from_quat(p) * Rotation.from_quat(q)
    found = Rotation.from_quat(product(p, q))
    np.testing.assert_allclose(found.as_matrix(), expected.as_matrix(), atol=ROUNDING)


@given(triple.filter(lambda v: np.linalg.norm(v) > 0))
def test_a_pointing_turn_takes_e_x_to_the_direction_of_its_vector(v):
    found = Rotation.from_quat(direction_rotation(*v)).apply([1.0, 0.0, 0.0])
    np.testing.assert_allclose(found, v / np.linalg.norm(v), atol=ROUNDING)


def test_nothing_points_nowhere_without_a_turn():
    assert np.array_equal(direction_rotation(0.0, 0.0, 0.0), IDENTITY_ROTATION)


# rounding of a dozen operations on lengths of 0.1 m
SURFACE = np.array([0.0, 0.0, -0.1, 0.0, 0.0, 0.0, 1.0])


def frames_at(p_B):
    """Frame -> pose (1, 7) with the platform at p_B."""
    found = poses(GEOMETRY, joint_angles(GEOMETRY, p_B)[None], p_B[None], SURFACE[None])
    return {frame: found[:, i] for i, frame in enumerate(SCENE_FRAMES)}


@given(working_poses)
def test_links_carry_the_rods_and_the_rods_end_at_the_platform_joints(p_B):
    frames = frames_at(p_B)
    for leg in range(3):
        for side, aside in (("minus", -HALF_WIDTH), ("plus", HALF_WIDTH)):
            link, rod = frames[f"link_{leg + 1}"], frames[f"rod_{leg + 1}_{side}"]
            end_of_link = at(link, (GEOMETRY.l_a, aside, 0.0))
            np.testing.assert_allclose(at(rod, (0.0, 0.0, 0.0)), end_of_link, atol=ROUNDING)
            joint = p_B + GEOMETRY.b * OUTWARD[leg] + aside * AXIS[leg]
            np.testing.assert_allclose(at(rod, (GEOMETRY.l_b, 0.0, 0.0)), joint[None], atol=ROUNDING)


@given(working_poses)
def test_a_link_turns_about_the_axis_of_its_joint(p_B):
    frames = frames_at(p_B)
    for leg in range(3):
        link = frames[f"link_{leg + 1}"]
        np.testing.assert_allclose(at(link, (0.0, 1.0, 0.0)) - link[:, :3], AXIS[leg][None], atol=ROUNDING)
        np.testing.assert_allclose(link[0, :3], GEOMETRY.a * OUTWARD[leg], atol=ROUNDING)


def test_at_home_every_rod_hangs_in_the_plane_of_its_leg():
    frames = frames_at(np.array(HOME))
    for leg in range(3):
        rod = frames[f"rod_{leg + 1}_plus"]
        # the rod's own y axis is the joint's as long as it does not swing sideways
        np.testing.assert_allclose(at(rod, (0.0, 1.0, 0.0)) - rod[:, :3], AXIS[leg][None], atol=ROUNDING)


def test_a_pose_that_is_no_number_is_refused():
    with pytest.raises(InputRefused, match="p_B"):
        poses(GEOMETRY, np.zeros((1, 3)), np.full((1, 3), np.nan), SURFACE[None])


# rounding of a dozen operations on lengths of 0.1 m
# a run's state is integrated, its angles come from the inverse kinematics: the chain closes to their rounding
CLOSED = 1e-13


@pytest.fixture(scope="module")
def shifted(root: Path, tmp_path_factory: pytest.TempPathFactory) -> Recording:
    """Fig. 4's start over a sphere, tilted both ways, that jumps sideways and up."""
    overrides = [
        "duration_s=0.5", "contact.tilt_deg=10", "contact.tilt_x_deg=-5", "contact.shape='sphere'",
        "contact.radius_mm=80", "contact.shift={by_mm=[3, 4, 5], start_s=0.1, rise_s=0.2}",
    ]  # fmt: skip
    experiment = load_experiment(root / "experiments/fig4_position.toml", overrides)
    return read(execute(experiment, tmp_path_factory.mktemp("shifted")).recording)


def test_there_are_50_pictures_a_second_of_every_frame(force_position: Recording):
    found = messages(force_position.path, "/tf")
    assert [time for time, _ in found] == [20_000_000 * k for k in range(1001)]
    assert [time for time, _ in messages(force_position.path, "/force")] == [time for time, _ in found]
    for time, message in found:
        assert [transform.child_frame_id for transform in message.transforms] == list(SCENE_FRAMES)
        assert {transform.timestamp.ToNanoseconds() for transform in message.transforms} == {time}


def test_the_chain_closes_in_every_picture_of_a_run(force_position: Recording):
    found = frames(force_position.path)
    p_B = force_position["plant.p_B"][::20]
    np.testing.assert_array_equal(found["platform"], np.hstack([p_B, np.tile([0.0, 0.0, 0.0, 1.0], (len(p_B), 1))]))
    for leg in range(3):
        for side, aside in (("minus", -HALF_WIDTH), ("plus", HALF_WIDTH)):
            link, rod = found[f"link_{leg + 1}"], found[f"rod_{leg + 1}_{side}"]
            np.testing.assert_allclose(rod[:, :3], at(link, (GEOMETRY.l_a, aside, 0.0)), atol=CLOSED)
            joint = at(found["platform"], tuple(GEOMETRY.b * OUTWARD[leg] + aside * AXIS[leg]))
            np.testing.assert_allclose(at(rod, (GEOMETRY.l_b, 0.0, 0.0)), joint, atol=CLOSED)


def test_the_links_are_where_the_joint_angles_put_them(force_position: Recording):
    found = frames(force_position.path)
    theta_l = force_position["plant.theta_l"][::20]
    for leg in range(3):
        below = at(found[f"link_{leg + 1}"], (1.0, 0.0, 0.0))[:, 2] - found[f"link_{leg + 1}"][:, 2]
        np.testing.assert_allclose(below, -np.sin(theta_l[:, leg]), atol=ROUNDING)


def test_the_arrow_of_the_pressing_force_points_down_and_is_as_long_as_the_force(force_position: Recording):
    F_ee_B, p_B = force_position["plant.F_ee_B"][::20], force_position["plant.p_B"][::20]
    pressing = 0
    for k, (_, message) in enumerate(messages(force_position.path, "/force")):
        (arrow,) = message.entities[0].arrows
        x, y, z, *q = numbers(arrow.pose.position, arrow.pose.orientation)
        assert (message.entities[0].id, message.entities[0].frame_id, [x, y, z]) == ("true", "base", list(p_B[k]))
        along = Rotation.from_quat(q).apply([arrow.shaft_length + arrow.head_length, 0.0, 0.0])
        np.testing.assert_allclose(along, ARROW_LENGTH * F_ee_B[k], atol=ROUNDING)
        pressing += along[2] < -0.03
    # more than 3 N from 6 s on
    assert pressing > 600


def test_the_estimate_has_an_arrow_of_its_own_beside_the_true_one(force_position: Recording):
    F_ee_B, p_B = force_position["estimator.F_ee_B"][::10], force_position["plant.p_B"][::20]
    for k, (_, message) in enumerate(messages(force_position.path, "/force")):
        (arrow,) = message.entities[1].arrows
        x, y, z, *q = numbers(arrow.pose.position, arrow.pose.orientation)
        np.testing.assert_array_equal([x, y, z], p_B[k] + [ESTIMATE_OFFSET, 0.0, 0.0])
        along = Rotation.from_quat(q).apply([arrow.shaft_length + arrow.head_length, 0.0, 0.0])
        np.testing.assert_allclose(along, ARROW_LENGTH * F_ee_B[k], atol=ROUNDING)
        assert message.entities[1].id == "estimated"
        assert arrow.color != message.entities[0].arrows[0].color


def test_one_message_at_the_start_tells_for_ever_what_every_frame_looks_like(force_position: Recording):
    ((time, scene),) = messages(force_position.path, "/scene")
    assert time == 0
    assert [entity.frame_id for entity in scene.entities] == ["base", *SCENE_FRAMES]
    assert len({entity.id for entity in scene.entities}) == len(scene.entities)
    for entity in scene.entities:
        assert entity.frame_locked
        assert entity.lifetime.ToNanoseconds() == 0
        assert entity.cylinders or entity.cubes or entity.spheres
        assert all(cylinder.color.a > 0 for cylinder in entity.cylinders)


def test_a_links_and_a_rods_cylinder_reach_from_joint_to_joint(force_position: Recording):
    ((_, scene),) = messages(force_position.path, "/scene")
    for entity in scene.entities:
        length = {"link": GEOMETRY.l_a, "rod": GEOMETRY.l_b}.get(entity.frame_id.split("_")[0])
        if length is not None:
            bar = entity.cylinders[0]
            ends = np.array([[0.0, 0.0, -bar.size.z / 2], [0.0, 0.0, bar.size.z / 2]])
            x, y, z, *q = numbers(bar.pose.position, bar.pose.orientation)
            np.testing.assert_allclose(
                Rotation.from_quat(q).apply(ends) + np.array([x, y, z]),
                np.array([[0, 0, 0], [length, 0, 0]]),
                atol=ROUNDING,
            )


def test_a_scale_is_drawn_with_its_top_where_the_robot_meets_it(force_position: Recording):
    surface = frames(force_position.path)["surface"]
    assert np.all(surface == [0.0, 0.0, -0.101, 0.0, 0.0, 0.0, 1.0])
    ((_, scene),) = messages(force_position.path, "/scene")
    (plate,) = scene.entities[-1].cubes
    assert plate.pose.position.z + plate.size.z / 2 == 0.0


def test_a_body_is_drawn_tilted_as_the_plants_surface_and_moves_with_it(shifted: Recording):
    surface = frames(shifted.path)["surface"]
    apex = np.array([0.0, 0.0, -0.101])
    np.testing.assert_allclose(surface[:, :3], apex + shifted["body.s_B"][::20], atol=ROUNDING)
    np.testing.assert_allclose(surface[-1, :3] - surface[0, :3], [3e-3, 4e-3, 5e-3], atol=ROUNDING)
    tilt, tilt_x = math.radians(10), math.radians(-5)
    # the normal that twin/robot/plant/contact.py derives
    normal = [math.sin(tilt) * math.cos(tilt_x), -math.sin(tilt_x), math.cos(tilt) * math.cos(tilt_x)]
    found = at(surface, (0.0, 0.0, 1.0)) - surface[:, :3]
    np.testing.assert_allclose(found, np.tile(normal, (len(found), 1)), atol=ROUNDING)


def test_a_sphere_lies_below_its_apex(shifted: Recording):
    ((_, scene),) = messages(shifted.path, "/scene")
    (sphere,) = scene.entities[-1].spheres
    assert sphere.pose.position.z + sphere.size.z / 2 == 0.0
    assert sphere.size.x == sphere.size.y == sphere.size.z == 0.16


@pytest.mark.parametrize(("shape", "axis"), [("cylinder_x", [1, 0, 0]), ("cylinder_y", [0, 1, 0])])
def test_a_cylinder_lies_along_the_axis_it_is_named_after(root: Path, tmp_path: Path, shape: str, axis: list[int]):
    overrides = ["duration_s=0.02", f"contact.shape='{shape}'", "contact.radius_mm=40"]
    experiment = load_experiment(root / "experiments/fig4_position.toml", overrides)
    ((_, scene),) = messages(execute(experiment, tmp_path).recording, "/scene")
    (cylinder,) = scene.entities[-1].cylinders
    x, y, z, *q = numbers(cylinder.pose.position, cylinder.pose.orientation)
    np.testing.assert_allclose(np.abs(Rotation.from_quat(q).apply([0.0, 0.0, 1.0])), axis, atol=ROUNDING)
    assert (x, y, z, cylinder.size.x) == (0.0, 0.0, -0.04, 0.08)


def test_the_pictures_come_with_their_types(force_position: Recording):
    with force_position.path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    types = {channel.topic: summary.schemas[channel.schema_id].name for channel in summary.channels.values()}
    assert types["/tf"] == "foxglove.FrameTransforms"
    assert types["/scene"] == types["/force"] == "foxglove.SceneUpdate"
    assert types["/events"] == "foxglove.Log"


def test_a_tick_that_no_picture_falls_on_still_has_its_50_a_second(root: Path, tmp_path: Path):
    overrides = ["duration_s=0.3", "cosim.tick_ms=0.3", "controller.period_ms=0.6", "scale.period_ms=3"]
    experiment = load_experiment(root / "experiments/fig4_position.toml", overrides)
    recording = execute(experiment, tmp_path).recording
    # 67 ticks of 0.3 ms are the nearest to 20 ms
    assert [time for time, _ in messages(recording, "/tf")] == [20_100_000 * k for k in range(15)]
