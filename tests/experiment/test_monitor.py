import pytest
from pydantic import ValidationError

from tests.monitor.motions import BELIEF, LIMITS
from twin.assembly.beliefs import monitor_limits
from twin.assembly.checks.monitor import contradictions
from twin.experiment.mistakes import keys
from twin.experiment.monitor import Monitor
from twin.monitor.limits import Limits


def told(**values):
    return contradictions(Monitor.model_validate(values), BELIEF, 2e-3, 8.0)


def test_an_empty_table_is_complete_and_without_contradiction():
    assert told() == []
    assert Monitor.model_validate({}).enabled


def test_limits_are_si():
    assert monitor_limits(Monitor(), 8.0) == LIMITS
    assert (LIMITS.penetration_limit, LIMITS.speed_limit, LIMITS.z_min) == (0.025, 0.25, -0.135)
    assert LIMITS.retract == pytest.approx(0.5236, abs=1e-4)


def test_a_command_is_saturated_at_the_controllers_limit_unless_another_is_given():
    assert monitor_limits(Monitor(), 6.0).command_limit == 6.0
    assert monitor_limits(Monitor.model_validate({"command_limit_rad_per_s": 5.0}), 6.0).command_limit == 5.0


def test_a_monitor_that_is_not_enabled_contradicts_nothing():
    assert told(enabled=False, z_min_mm=-75.0, z_max_mm=-80.0) == []


def test_every_limit_has_a_key_with_its_unit():
    assert set(Monitor.model_fields) == {*Limits._fields, "enabled", "period"}
    assert all(key == "enabled" or "_" in key for key in keys(Monitor))


@pytest.mark.parametrize("key", ["force_limit_N", "filter_Hz", "retract_deg", "follow_time_ms"])
@pytest.mark.parametrize("value", [0.0, -1.0, float("nan"), float("inf")])
def test_what_is_no_limit_is_refused(key, value):
    with pytest.raises(ValidationError):
        Monitor.model_validate({key: value})


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"z_min_mm": -75.0, "z_max_mm": -80.0}, "z_min_mm = -75 is not below z_max_mm = -80"),
        (
            {"deflection_limit_deg": 8.0},
            "force_limit_N = 15 is never reached: at z = -105 mm it winds a spring up by 9.3 deg "
            "(k_s N eta = 2 N m/rad), and deflection_limit_deg = 8 trips before",
        ),
        ({"contact_force_N": 16.0}, "contact_force_N = 16 is not below force_limit_N = 15"),
        ({"contact_force_N": 0.3}, "one count is worth 0.248 at z = -105 mm; expected at least 3 times that"),
        ({"penetration_limit_mm": 0.1}, "penetration_limit_mm = 0.1 is within what the encoders cannot tell apart"),
        ({"jump_limit_rad_per_s": 2.0}, "jump_limit_rad_per_s = 2 is within"),
        ({"speed_limit_mm_per_s": 20.0}, "speed_limit_mm_per_s = 20 is within"),
        ({"force_rate_limit_N_per_s": 50.0}, "force_rate_limit_N_per_s = 50 is within"),
        ({"follow_limit_rad_per_s": 0.4}, "follow_limit_rad_per_s = 0.4 is within"),
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
