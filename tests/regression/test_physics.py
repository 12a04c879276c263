"""What theory says of the repository's baselines with a drive that does at once what it is told.

The position loop is then omega = kp (reference - position), first order with the time constant 1/kp.
"""

import numpy as np
import pytest

from tests.conftest import ROOT
from tests.laws.runs import shipped
from twin.regression.baseline import read_baseline
from twin.robot.gravity import G_ACCELERATION

KP = shipped("step_z_air").controller.position.kp


def value(experiment: str, name: str) -> float:
    return read_baseline(ROOT / f"tests/baselines/{experiment}/ideal_velocity.toml").metrics[name].value


@pytest.mark.parametrize("number", ["step_z_air:z", "step_z_side:z", "step_z_low:z", "step_joint_2:joint"])
def test_a_step_takes_the_times_of_a_first_order_loop(number: str):
    experiment, _, name = number.partition(":")
    # the final value is a mean over samples to which 0.7 % of the way are still to come: 3 % of the rise time less
    assert value(experiment, f"{name}.rise_time") == pytest.approx(np.log(9.0) / KP, rel=0.04)
    assert value(experiment, f"{name}.delay_time") == pytest.approx(np.log(2.0) / KP, rel=0.04)


def test_along_a_line_the_platform_comes_later_by_the_time_constant():
    # at the turns it catches up
    assert value("track_line", "x_lag.lag") == pytest.approx(1.0 / KP, rel=0.06)


def test_round_a_circle_it_runs_inside_by_what_the_loop_leaves_of_the_amplitude():
    omega, radius = 2.0 * np.pi * 0.2, 0.015
    inside = radius * (1.0 - 1.0 / np.hypot(1.0, omega / KP))
    # the play of 0.1 deg either way on the motor's side moves the platform by 0.1 mm, an encoder count by some more
    assert value("track_circle", "path.max_error") == pytest.approx(inside, abs=1.5e-4)


@pytest.mark.parametrize("experiment", ["step_z_air", "step_z_side"])
def test_on_the_way_down_the_weight_works_on_the_motors(experiment: str):
    robot = shipped(experiment).plant
    # platform, and of each rod pair the half that goes with it; the rest and the knees go down less than 5 mm
    lower = (robot.m_p + 1.5 * robot.m_b) * G_ACCELERATION * 0.005
    upper = (robot.m_p + 3.0 * robot.m_b + 3.0 * robot.m_a) * G_ACCELERATION * 0.005
    assert lower < value(experiment, "motors.work_returned") < upper
    assert value(experiment, "motors.work_delivered") < 0.01 * lower


def test_on_the_way_up_the_motors_lift_it():
    assert value("step_z_low", "motors.work_delivered") > 100.0 * value("step_z_low", "motors.work_returned")


def test_after_a_joint_step_the_next_joint_is_where_it_was():
    # a count of the motor encoder, 0.8 mrad at the joint
    assert value("step_joint_2", "next_joint.max_error") < 2.0 * np.pi / 4096 / 2.0
