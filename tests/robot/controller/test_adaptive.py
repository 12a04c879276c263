"""What a controller may do besides its law, as settings become memory."""

import numpy as np

from tests.robot.controller.test_taps import SENSING
from twin.robot.controller.adaptive import ADAPTIVE_RECORD, AdaptiveOptions
from twin.robot.controller.schedule import SchedulePoint, Scheduling, schedule_table

POINTS = [SchedulePoint(300.0, 4e-3, 8e-2), SchedulePoint(800.0, 3e-3, 4e-2)]


def test_a_schedule_is_on_with_all_its_points_and_off_without_them():
    memory = np.zeros(1, dtype=ADAPTIVE_RECORD)[0]
    table = AdaptiveOptions(SENSING, Scheduling(0.3, 2.0, 1.0, 5e-4, 5e-3), POINTS).fill(memory)
    np.testing.assert_array_equal(table["gain_table"], schedule_table(POINTS))
    assert memory["scheduled"] == 1 and memory["schedule"]["count"] == 2
    assert AdaptiveOptions(SENSING).fill(memory) == {}
    assert memory["scheduled"] == 0 and memory["schedule"]["count"] == 0
