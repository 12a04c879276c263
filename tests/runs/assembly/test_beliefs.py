"""The limits of [monitor] become those of the safety monitor, in SI."""

import pytest

from tests.monitor.motions import LIMITS
from twin.monitor.limits import Limits, Monitor
from twin.runs.assembly.beliefs import monitor_limits


def test_every_limit_of_the_component_is_in_the_table():
    assert set(Monitor.model_fields) == {*Limits._fields, "enabled", "period"}


def test_limits_are_si():
    assert monitor_limits(Monitor(), 8.0) == LIMITS
    assert (LIMITS.penetration_limit, LIMITS.speed_limit, LIMITS.z_min) == (0.025, 0.25, -0.135)
    assert LIMITS.retract == pytest.approx(0.5236, abs=1e-4)


def test_a_command_is_saturated_at_the_controllers_limit_unless_another_is_given():
    assert monitor_limits(Monitor(), 6.0).command_limit == 6.0
    assert monitor_limits(Monitor.model_validate({"command_limit_rad_per_s": 5.0}), 6.0).command_limit == 5.0
