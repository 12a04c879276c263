from pathlib import Path

import numpy as np
import pytest

from tests.studies.identify.calibrations import belief
from twin.kernel.recording.logs.log import LogError, LogSeries
from twin.studies.identify.windows import windows
from twin.studies.replay.samples import RobotSamples


def log(joint: np.ndarray, t: np.ndarray, force: bool = True) -> RobotSamples:
    """Encoders of joints that all stand at `joint` (n,), rad, and a scale that shows nothing."""
    robot = belief()
    count_l = np.floor(joint * robot.joint_counts / (2 * np.pi) + 0.5)
    count_m = np.floor(robot.N * joint * robot.motor_counts / (2 * np.pi) + 0.5)
    scale = LogSeries(t, np.zeros(len(t)), "N") if force else None
    count_m, count_l = (np.repeat(count[:, None], 3, axis=1) for count in (count_m, count_l))
    return RobotSamples(t, np.hstack([count_m, count_l]), scale, Path("robot.csv"))


T = np.arange(0.0, 4.0, 0.002)


def test_a_robot_at_rest_says_nothing_however_long_it_is_asked():
    assert len(windows(log(np.full(len(T), 0.3), T), belief()).t) == 0


def test_slow_motion_is_kept_with_its_speed():
    seen = windows(log(0.2 + 0.07 * T, T), belief())
    assert len(seen.t) == 40
    # a joint's count is 3.8e-4 rad; a line through samples over 0.1 s finds the slope to a fifth of that per 0.1 s
    np.testing.assert_allclose(seen.speed, 0.07, atol=8e-4)


def test_the_rounding_of_a_moving_encoder_averages_out():
    seen = windows(log(0.2 + 0.07 * T, T), belief())
    motor_step = 2 * np.pi / belief().motor_counts
    # 9 counts per window: the mean is off by a ninth of a step at most
    np.testing.assert_allclose(seen.motor[:, 0], 2 * (0.2 + 0.07 * seen.t), atol=motor_step / 9)


def test_a_start_a_stop_and_a_turn_are_left_out():
    there_and_back = 0.2 + 0.1 * np.abs(T - 2.05)
    seen = windows(log(there_and_back, T), belief())
    assert not np.any(np.abs(seen.t - 2.05) < 0.05)
    assert len(seen.t) == 39


def test_windows_with_lost_samples_are_left_out():
    lost = (T > 1.0) & (T < 1.5)
    kept = log(0.2 + 0.07 * T[~lost], T[~lost])
    seen = windows(kept, belief())
    assert not np.any((seen.t > 1.0) & (seen.t < 1.5))


def test_without_a_scale_there_is_one_sentence():
    with pytest.raises(LogError, match=r"no measured force: .* --map scale\.F_z=COLUMN\[N\], pressing positive$"):
        windows(log(0.2 + 0.07 * T, T, force=False), belief())
