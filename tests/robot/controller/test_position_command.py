"""Speed into angle for a servo that counts otherwise than the motor."""

import math

import numpy as np
import pytest

from tests.laws.runs import ComponentStepper
from twin.robot.controller.drive_loops import DriveSpeedIntegrator, Servo


@pytest.mark.parametrize("ratio", [0.5, -3.0])
def test_the_goal_is_the_command_from_the_zero_of_the_servo_in_turns_of_the_motor(ratio: float):
    step = ComponentStepper(DriveSpeedIntegrator(Servo(zero=0.2, ratio=ratio), theta_m=1.0))
    for k in range(5):
        command, goal = step(np.array([4.0, 1.0]), 1e-3 * k, 1e-3)
        # rounding
        assert command == pytest.approx(1.0 + 4e-3 * (k + 1), rel=1e-14)
        assert goal == pytest.approx(command - 0.2, rel=1e-14)


def test_within_its_turn_the_goal_is_that_of_the_command_but_for_whole_turns():
    step = ComponentStepper(DriveSpeedIntegrator(Servo(zero=0.0, ratio=2.0, wrap=-math.pi), theta_m=2.0))
    command, goal = step(np.array([1.0, 2.0]), 0.0, 1e-3)
    assert command == pytest.approx(2.001, rel=1e-14)
    assert 2.0 * goal == pytest.approx(2.0 * command - 2.0 * math.pi, rel=1e-13)
