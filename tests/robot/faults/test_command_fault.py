import numpy as np
import pytest

from tests.robot.faults.robot import SPEED_LIMIT, TICK, Robot, run
from twin.robot.experiment.fault import Fault

ONSET, END = 40, 80


@pytest.mark.parametrize("three_axes", [False, True])
def test_saturation_limits_the_speed_of_one_drive(three_axes):
    robot = Robot(three_axes)
    fault = Fault("drive_saturation", "drive_3", ONSET, END, 0.5)
    clean = np.diff(run(robot=robot)["plant.seen"], axis=0) / TICK
    faulty = np.diff(run(fault, robot=robot)["plant.seen"], axis=0) / TICK
    expected = clean.copy()
    expected[ONSET:END, 2] = np.clip(clean[ONSET:END, 2], -0.5, 0.5)
    # differences of angles of about 1 rad over a tick
    np.testing.assert_allclose(faulty, expected, rtol=0.0, atol=1e-11)


@pytest.mark.parametrize("three_axes", [False, True])
def test_a_brown_out_leaves_all_drives_the_stated_share_of_their_speed(three_axes):
    done = run(Fault("brown_out", "drives", ONSET, END, 0.05), robot=Robot(three_axes))
    omega_ref = done["controller.omega_ref"]
    expected = omega_ref.copy()
    expected[ONSET:END] = np.clip(omega_ref[ONSET:END], -0.05 * SPEED_LIMIT, 0.05 * SPEED_LIMIT)
    np.testing.assert_array_equal(done["fault_1.omega_ref"], expected)
    speeds = np.diff(done["plant.seen"], axis=0) / TICK
    np.testing.assert_allclose(speeds, expected[:-1], rtol=0.0, atol=1e-11)


def test_limits_of_a_drive_lie_behind_the_monitor_and_late_commands_before_it():
    robot = Robot(power_off=1000)
    done = run(
        Fault("drive_saturation", "drive_2", ONSET, END, 0.5),
        Fault("controller_overrun", "controller", ONSET, END, 4 * TICK),
        robot=robot,
    )
    np.testing.assert_array_equal(done["monitor.omega_ref"], done["fault_2.omega_ref"])
    asked = done["monitor.omega_ref"][:, 1]
    assert np.all(asked[ONSET:END] > 0.5)
    np.testing.assert_array_equal(done["fault_1.omega_ref"][ONSET:END, 0], 0.5)
