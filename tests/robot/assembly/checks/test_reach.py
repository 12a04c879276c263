"""Ways on which the robot would bend too far or meet itself are refused before it runs, with the place."""

import numpy as np
import pytest

from tests.laws.runs import EVERY_EXPERIMENT, FORCE, shipped
from tests.robot.assembly.checks.test_tasks import told
from twin.robot.assembly.checks.reach import find_obstruction
from twin.robot.mechanism.geometry import geometry_of
from twin.robot.mechanism.workspace import Bars, ball_joint_angles, clearances

ASIDE = ("reference.t_s=[0, 1, 2]", "reference.p_mm=[[0, 0, -90], [0, 0, -95], [58, 0, -95]]")


def test_a_ball_joint_beyond_its_limit_is_refused_with_place_leg_angle_and_limit():
    (sentence,) = told(FORCE, *ASIDE)
    # asin(57/113.9) = 30.03 deg: leg 1 stands across x
    assert sentence == (
        "[reference] from way point 2 on: at (57.0, 0.0, -95.0) mm the ball joints of leg 1 bend by 30.0 deg, their "
        "sockets let them by [plant] ball_joint_limit_deg = 30; move the point towards the axis"
    )
    assert shipped(FORCE, *ASIDE, "plant.ball_joint_limit_deg=31")


def test_rods_that_would_meet_are_refused():
    (sentence,) = told(FORCE, "plant.rod_spacing_mm=102")
    assert sentence.startswith("[reference] from way point 1 on: at (0.0, 20.0, -85.0) mm a rod of leg ")
    assert "inside each other with [plant] link_diameter_mm, rod_diameter_mm and rod_spacing_mm" in sentence


def test_a_way_into_a_hard_stop_is_refused():
    (sentence,) = told(FORCE, "plant.joint_upper_deg=30")
    assert sentence.startswith("[reference] from way point 2 on: at (0.0, ") and "beyond its hard stop" in sentence
    (sentence,) = told(FORCE, "plant.joint_lower_deg=0")
    assert sentence.startswith("[reference] from way point 1 on: at (0.0, 20.0, -85.0) mm joint 2 is at -3.1 deg")


def test_a_task_on_which_a_ball_joint_bends_too_far_is_refused():
    found = told("pressing", "plant.ball_joint_limit_deg=1", "task.1.point_mm=[20, 0]")
    assert any(
        sentence.startswith("[task 1] at (20.0, 0.0, ") and "ball joints of leg 1" in sentence for sentence in found
    )


def test_a_shape_is_refused_by_its_time():
    (sentence,) = told("track_circle", "plant.ball_joint_limit_deg=3")
    assert sentence.startswith("[reference.circle] from ")


@pytest.mark.parametrize("name", EVERY_EXPERIMENT)
def test_what_ships_has_room_to_spare(name: str):
    plant = shipped(name).plant
    assert None not in (plant.ball_joint_limit, plant.link_diameter, plant.rod_diameter, plant.rod_spacing)


def test_within_the_monitors_workspace_nothing_bends_too_far_or_meets():
    plant = shipped().plant
    radius, height = np.meshgrid(np.linspace(0.0, 0.04, 9), np.linspace(-0.135, -0.075, 13))
    turn = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
    points = np.array(
        [[r * np.cos(a), r * np.sin(a), z] for r, z in zip(radius.flat, height.flat, strict=True) for a in turn]
    )
    assert find_obstruction(plant, points) is None
    geometry = geometry_of(plant)
    assert np.degrees(ball_joint_angles(geometry, points).max()) < 21.0
    sizes = Bars(plant.link_diameter or 0.0, plant.rod_diameter or 0.0, plant.rod_spacing or 0.0)
    assert clearances(geometry, sizes, points)[0].min() > 5e-3
