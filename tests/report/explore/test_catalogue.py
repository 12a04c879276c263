"""Sliders are made of the declared settings alone: ranges lie within the bounds, and about the file's value."""

import math

import pytest

from tests.laws.runs import shipped
from twin.kernel.errors import InputRefused
from twin.report.explore.catalogue import FIRST_KEYS, check_value, sliders
from twin.robot.assembly.declared import DECLARED_TABLES, TABLE_PATHS

FIG4, MASSAGE = "fig4_force_position", "massage"


@pytest.mark.parametrize("name", [FIG4, MASSAGE, "track_circle", "step_joint_1"])
def test_a_slider_has_two_ends_within_the_declared_bounds_and_the_files_value_between_them(name: str):
    found = sliders(shipped(name))
    assert len(found) > 100
    for slider in found.values():
        assert math.isfinite(slider.low) and math.isfinite(slider.high) and slider.low < slider.high, slider.key
        assert not slider.log or slider.low > 0.0, slider.key
        if slider.kind in ("number", "whole") and slider.value is not None:
            assert slider.low <= slider.value <= slider.high, slider.key
    declared = {
        f"{path}.{setting.key(name)}": setting
        for table, path in TABLE_PATHS.items()
        for name, setting in table.settings.items()
    }
    for key in found.keys() & declared.keys():
        more = declared[key].more
        assert found[key].low >= more.get("ge", more.get("gt", -math.inf)), key
        assert found[key].high <= more.get("le", more.get("lt", math.inf)), key
        assert (found[key].unit, found[key].help) == (declared[key].unit, declared[key].help) or key == "reference.t_s"


def test_every_number_choice_and_switch_of_the_experiments_tables_has_a_slider():
    values = shipped(FIG4).values
    found = sliders(shipped(FIG4))
    for table in ("robot", "plant", "contact", "cosim", "scale"):
        for key, value in values[table].items():
            if isinstance(value, int | float) or (isinstance(value, str) and key not in ("name", "body")):
                assert f"{table}.{key}" in found


def test_a_bound_above_zero_makes_a_logarithmic_slider_and_one_at_zero_a_linear_one():
    found = sliders(shipped(FIG4))
    spring, gain = found["robot.k_s_Nm_per_rad"], found["controller.force.kp_mm_per_N"]
    assert (spring.low, spring.high, spring.log) == (0.1, 10.0, True)
    assert (gain.low, gain.high, gain.log) == (0.0, 8.0, False)


def test_about_a_dozen_keys_come_first_and_only_those_that_the_experiment_has():
    for name in (FIG4, MASSAGE):
        shown = [slider for slider in sliders(shipped(name)).values() if slider.first is not None]
        assert 10 <= len(shown) <= len(FIRST_KEYS)
        assert sorted(s.first for s in shown if s.first is not None) == list(range(len(shown)))
    assert sliders(shipped(FIG4))["controller.force.reference_N"].first is not None
    # tasks have forces of their own
    assert sliders(shipped(MASSAGE))["controller.force.reference_N"].first is None
    assert "task.2.speed_mm_per_s" in sliders(shipped(MASSAGE))
    assert "drive.parameters.droop" in sliders(shipped(FIG4))


def test_a_table_that_needs_several_keys_is_offered_only_where_it_is_there():
    assert "controller.damping.gain_rad_per_s_per_Nm" not in sliders(shipped(FIG4))
    assert "controller.damping.gain_rad_per_s_per_Nm" in sliders(shipped(MASSAGE))
    # one key turns it on
    assert "monitor.force_limit_N" in sliders(shipped(FIG4))


def test_no_key_names_a_file():
    found = sliders(shipped(MASSAGE))
    assert not {key for key in found if key.rpartition(".")[2] in ("fmu", "python", "sha256", "body", "extends")}
    assert DECLARED_TABLES.tables.keys() >= {key.partition(".")[0] for key in found} - {"task", "drive"}


@pytest.mark.parametrize(
    ("key", "value", "expected"),
    [
        ("robot.k_s_Nm_per_rad", "1", "expected a number"),
        ("robot.k_s_Nm_per_rad", True, "expected a number"),
        ("robot.k_s_Nm_per_rad", math.inf, "expected a number"),
        ("controller.delay_ticks", 1.5, "expected a whole number"),
        ("controller.delay_ticks", 1e300, "expected a whole number"),
        ("controller.mode", "x", "expected 'force_position', 'position'"),
        ("controller.gravity_compensation", 1, "expected true or false"),
        ("reference.t_s", [0.0] * 9, "expected a factor"),
        ("reference.t_s", 0.0, "expected a factor"),
        ("controller.force.kp", 1.0, "did you mean 'controller.force.kp_mm_per_N'?"),
        ("drive.fmu", "evil.fmu", "no key that can be changed here"),
    ],
)
def test_what_a_page_must_not_say_is_refused_in_a_sentence(key: str, value: object, expected: str):
    with pytest.raises(InputRefused, match=f"(?s){key}.*") as refused:
        check_value(sliders(shipped(FIG4)), key, value)
    assert expected in str(refused.value)
    assert len(str(refused.value)) < 300


def test_a_whole_number_stays_whole_and_a_number_one_with_a_point():
    found = sliders(shipped(FIG4))
    assert repr(check_value(found, "controller.delay_ticks", 3.0)) == "3"
    assert repr(check_value(found, "robot.k_s_Nm_per_rad", 2)) == "2.0"
