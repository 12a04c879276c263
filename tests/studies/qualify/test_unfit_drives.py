"""Drives that are wrong on purpose, and what the qualification says of them."""

import warnings
from pathlib import Path

import pytest

from tests.conftest import ROOT
from tests.kernel.fmi.archives import redescribed
from tests.kernel.fmi.faulty import faulty_drive
from tests.kernel.fmi.three_axes import three_axes_drive
from twin.robot.experiment.drive_files import load_drive
from twin.studies.qualify.qualification import Qualification, qualify_drive
from twin.studies.qualify.text import draw_drive_check

COMMAND = ('Commanded motor speed, held over a step">', "rad/s", 'rad="1" s="-1"')
LOAD = ('positive opposes positive omega_m">', "N.m", 'kg="1" m="2" s="-2"')
SPEED = ('description="Motor speed" initial="exact">', "rad/s", 'rad="1" s="-1"')


def rescaled(good: Path, folder: Path, variable: tuple[str, str, str], factor: float) -> Path:
    """A copy of `good` that takes one of its variables for `factor` times what it is."""
    description, unit, base = variable
    other = f'<Unit name="odd"><BaseUnit {base} factor="{factor}" /></Unit></UnitDefinitions>'
    half = redescribed(good, folder / "half.fmu", "</UnitDefinitions>", other)
    old = f'{description}\n      <Real start="0.0" unit="{unit}" />'
    return redescribed(half, folder / "bad.fmu", old, old.replace(unit, "odd"))


def checked(fmu: Path) -> Qualification:
    return qualify_drive(load_drive(str(fmu), ROOT))


def test_a_drive_that_turns_against_its_command_fails(velocity_servo: Path, tmp_path: Path):
    assert "direction" in checked(rescaled(velocity_servo, tmp_path, COMMAND, -1.0)).failed_checks


def test_a_load_that_pushes_the_shaft_forward_fails(velocity_servo: Path, tmp_path: Path):
    assert checked(rescaled(velocity_servo, tmp_path, LOAD, -1.0)).failed_checks == ("load",)


def test_a_command_in_the_wrong_unit_fails(velocity_servo: Path, tmp_path: Path):
    # a tenth of the speed: rpm taken for rad/s are 9.5 times as wrong
    assert checked(rescaled(velocity_servo, tmp_path, COMMAND, 9.5)).failed_checks == ("scale",)


@pytest.mark.parametrize("factor", [-1.0, 1.1])
def test_a_reported_speed_that_is_not_the_rate_of_the_angle_fails(velocity_servo: Path, tmp_path: Path, factor: float):
    assert checked(rescaled(velocity_servo, tmp_path, SPEED, factor)).failed_checks == ("rate",)


def test_a_load_without_a_unit_that_is_a_thousand_times_off_is_doubted_until_the_mapping_gives_its_unit(
    velocity_servo: Path, tmp_path: Path
):
    description, unit, _ = LOAD
    old = f'{description}\n      <Real start="0.0" unit="{unit}" />'
    silent = redescribed(velocity_servo, tmp_path / "silent.fmu", old, old.replace(f' unit="{unit}"', ""))
    # what a servo in N mm is, seen as one in N m
    in_mm = {"parameters": {"droop": 0.6e-3, "tau_max": 600.0}}
    drive = load_drive(str(silent), ROOT)
    drive = drive.model_copy(update=in_mm | {"inputs": {**drive.inputs, "tau_load": "tau_load"}})
    (doubt,) = qualify_drive(drive).doubts
    assert doubt == (
        "it turns against 294 N m, the drives of fmus/ stall by 2.94 N m; its load is without a unit; if it is in "
        "N mm, "
        'map tau_load = "tau_load[N.mm]"'
    )
    mended = qualify_drive(drive.model_copy(update={"inputs": {**drive.inputs, "tau_load": "tau_load[N.mm]"}}))
    assert mended.doubts == () and not mended.failed_checks
    assert mended.value("droop") == pytest.approx(0.6, rel=0.02)
    assert mended.value("stall_torque") == pytest.approx(0.6, rel=0.02)


def test_a_droop_of_the_size_of_no_drive_is_doubted(velocity_servo: Path):
    # the load in N mm at a servo in N m
    weak = load_drive(str(velocity_servo), ROOT).model_copy(update={"parameters": {"tau_max": 0.6e-3}})
    droop, stall = qualify_drive(weak).doubts
    assert droop.startswith(
        "its droop is 1.49e+04 rad/s per N m, of the drives of fmus/ at most 0.6; its load is in N.m"
    )
    assert stall.startswith("it stalls at 0.0018") and "the drives of fmus/ from 0.378 N m on" in stall


def test_a_gear_shows_in_the_stall_torque_and_not_in_the_speed(velocity_servo: Path):
    # command and angle are both divided by it, the torque is multiplied; 2 %: the window of the mean speed
    geared = load_drive(str(velocity_servo), ROOT).model_copy(update={"gear_ratio": 2.0})
    assert qualify_drive(geared).value("stall_torque") == pytest.approx(1.2, rel=0.02)


def test_turning_the_sign_over_mirrors_a_symmetric_drive_and_changes_nothing(velocity_servo: Path):
    # the mapping turns command, angle and load over together
    mirrored = qualify_drive(load_drive(str(velocity_servo), ROOT).model_copy(update={"sign": -1}))
    assert mirrored.failed_checks == ()
    assert mirrored.value("speed") == pytest.approx(0.5, abs=1e-9)


def test_a_drive_that_returns_nan_fails_and_the_measures_say_so(tmp_path: Path):
    faulty = load_drive(str(faulty_drive(ROOT, tmp_path)), ROOT).model_copy(update={"parameters": {"droop": 2.0}})
    judged = qualify_drive(faulty)
    assert "runs" in judged.failed_checks
    assert "NaN" in next(check.detail for check in judged.checks if check.name == "runs")
    assert all(measure.value is None and measure.remark for measure in judged.measures)


def test_three_axes_in_one_fmu_are_commanded_alike_and_the_first_is_measured(tmp_path: Path):
    judged = checked(three_axes_drive(ROOT, tmp_path))
    assert judged.failed_checks == ()
    assert "three axes" in judged.checks[0].detail
    # rounding of an angle after 2 s of turning
    assert judged.value("speed") == pytest.approx(0.5, abs=1e-6)


def test_a_shaft_that_stands_still_follows_nothing_and_no_number_is_made_of_it(velocity_servo: Path, tmp_path: Path):
    still = load_drive(str(velocity_servo), ROOT).model_copy(update={"parameters": {"omega_max": 0.0}})
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        judged = qualify_drive(still)
        draw_drive_check(judged, tmp_path / "still.png")
    assert "direction" in judged.failed_checks
    assert {m.name for m in judged.measures if m.value is None} >= {"bandwidth", "rise_time", "stall_torque"}
    assert next(m.remark for m in judged.measures if m.name == "bandwidth") == "does not follow its command"


def test_an_angle_that_no_shaft_has_ends_the_run_with_a_sentence(velocity_servo: Path, tmp_path: Path):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        judged = checked(rescaled(velocity_servo, tmp_path, SPEED, 1e300))
        draw_drive_check(judged, tmp_path / "odd.png")
    runs = next(check for check in judged.checks if check.name == "runs")
    assert runs.verdict == "FAIL" and "returned omega_m = " in runs.detail and "too fast for a shaft" in runs.detail
