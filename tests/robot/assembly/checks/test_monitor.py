"""Limits of [monitor] that cannot all mean something."""

import pytest

from tests.robot.monitor.motions import BELIEF
from twin.robot.assembly.checks.monitor_limits import contradictions
from twin.robot.monitor.limits import Monitor


def told(**values):
    return contradictions(Monitor.model_validate(values), BELIEF, 2e-3, 8.0)


def test_the_defaults_contradict_nothing():
    assert told() == []


def test_a_monitor_that_is_not_enabled_contradicts_nothing():
    assert told(enabled=False, z_min_mm=-75.0, z_max_mm=-80.0) == []


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"z_min_mm": -75.0, "z_max_mm": -80.0}, "z_min_mm = -75 is not below z_max_mm = -80"),
        (
            {"deflection_limit_deg": 8.0},
            "force_limit_N = 15 is never reached: at z = -105 mm it deflects a spring by 9.3 deg "
            "(k_s N eta = 2 N m/rad), and deflection_limit_deg = 8 trips before",
        ),
        ({"contact_force_N": 16.0}, "contact_force_N = 16 is not below force_limit_N = 15"),
        ({"contact_force_N": 0.3}, "one count is worth 0.248 at z = -105 mm; expected at least 3 times that"),
        ({"penetration_limit_mm": 0.1}, "penetration_limit_mm = 0.1 is below the resolution of the encoders"),
        ({"jump_limit_rad_per_s": 2.0}, "jump_limit_rad_per_s = 2 is below"),
        ({"speed_limit_mm_per_s": 20.0}, "speed_limit_mm_per_s = 20 is below"),
        ({"force_rate_limit_N_per_s": 50.0}, "force_rate_limit_N_per_s = 50 is below"),
        ({"follow_limit_rad_per_s": 0.4}, "follow_limit_rad_per_s = 0.4 is below"),
        ({"stale_time_ms": 2.0}, "stale_time_ms = 2 is no longer than one sample of 2 ms"),
        ({"period_ms": 4.0}, "period_ms = 4 holds back the controller's commands, which come every 2 ms"),
        ({"period_ms": 150.0}, "follow_time_ms = 150 is no longer than one sample of 150 ms"),
        ({"command_limit_rad_per_s": 9.0}, "never reached: the controller commands at most 8 rad/s"),
        ({"retract_speed_rad_per_s": 1.0}, "retract_speed_rad_per_s = 1 is not above follow_limit_rad_per_s = 1.5"),
        ({"z_max_mm": -55.0}, "retract_deg = 30 is longer than the workspace: from (35, 20, -55) mm"),
        ({"workspace_radius_mm": 120.0}, "leaves the robot's reach from (120, 0, -75) mm"),
        ({"z_min_mm": -190.0, "z_max_mm": -180.0}, "the middle of z_min_mm and z_max_mm: p_B = "),
    ],
)
def test_limits_that_contradict_each_other_are_told_in_a_sentence(values, said):
    assert any(said in sentence for sentence in told(**values)), told(**values)


def test_all_contradictions_are_told_at_once():
    found = told(deflection_limit_deg=8.0, contact_force_N=0.2, stale_time_ms=2.0, retract_speed_rad_per_s=1.0)
    assert len(found) == 4
    assert all(sentence.startswith("[monitor] ") for sentence in found)
