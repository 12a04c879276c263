"""Drives whose answers follow from their equations (the READMEs in fmus/)."""

from collections.abc import Callable

import numpy as np
import pytest

from tests.conftest import ROOT
from twin.robot.assembly.drives import plan_drive
from twin.robot.experiment.drive_files import load_drive
from twin.studies.qualify.definitions import CHECK_MEANINGS, MEASURE_DEFINITIONS
from twin.studies.qualify.motion import overload, ramped_torque, stall_torque
from twin.studies.qualify.qualification import Qualification

Done = Callable[[str], Qualification]
DRIVES = sorted(folder.name for folder in (ROOT / "fmus").iterdir() if any(folder.glob("*.fmu")))
T_M = 0.020
"""s. Time constant of velocity_servo."""
BRUSHED_STALL = (0.0373 * 3.0 - 4.2e-3) * 19.7 * 0.8
"""N m. (7), (8) of the README of brushed_dc at rest: (k_t i_max - tau_c) G eta."""


def test_the_ideal_drive_does_what_it_is_told_within_one_tick_and_cannot_be_stalled(done: Done):
    ideal = done("ideal_velocity")
    # rounding of an angle after 2 s of turning
    assert ideal.value("speed") == pytest.approx(0.5, abs=1e-9)
    assert ideal.value("no_load_speed") == pytest.approx(8.0, abs=1e-9)
    assert ideal.value("droop") == 0.0
    assert ideal.value("rise_time") == 0.0
    # one tick of 1 ms
    assert ideal.value("settling_time") == pytest.approx(1e-3, abs=1e-9)
    assert ideal.value("overshoot") == 0.0
    assert ideal.value("bandwidth") is None
    assert ideal.value("stall_torque") is None


def test_the_bandwidth_of_a_first_order_lag_is_that_of_its_time_constant(done: Done):
    # 1 %: straight lines between frequencies an eleventh of an octave apart
    assert done("velocity_servo").value("bandwidth") == pytest.approx(1.0 / (2.0 * np.pi * T_M), rel=0.01)


def test_the_droop_of_velocity_servo_is_its_parameter(done: Done):
    # rounding; the lag has died out over 50 time constants
    assert done("velocity_servo").value("droop") == pytest.approx(0.6, abs=1e-6)


def test_the_step_response_of_a_first_order_lag_is_its_exponential(done: Done):
    servo = done("velocity_servo")
    # each end of a duration is a whole tick
    assert servo.value("rise_time") == pytest.approx(T_M * np.log(9.0), abs=1e-3)
    assert servo.value("settling_time") == pytest.approx(T_M * np.log(20.0), abs=1e-3)
    assert servo.value("overshoot") == 0.0


def test_velocity_servo_stalls_at_its_torque_limit(done: Done):
    # 2 %: the load grows by 0.0125 N m within the window of the mean speed
    assert done("velocity_servo").value("stall_torque") == pytest.approx(0.6, rel=0.02)


def test_a_drive_solved_exactly_does_not_depend_on_its_step_size(done: Done):
    # rounding
    assert done("velocity_servo").value("step_error") < 1e-11  # type: ignore[operator]


def test_pmsm_foc_is_as_fast_as_its_readme_says_and_has_no_droop(done: Done):
    machine = done("pmsm_foc")
    # 3 %: the README's 73 Hz is of its linear equations without friction
    assert machine.value("bandwidth") == pytest.approx(73.0, rel=0.03)
    # what an encoder count per second of averaging can show
    assert machine.value("droop") == pytest.approx(0.0, abs=0.015)
    # i_max k_t = 5.7 A 0.105 N m/A, less 0.002 N m of friction; 2 % as above
    assert machine.value("stall_torque") == pytest.approx(0.5965, rel=0.02)


def test_a_heavy_rotor_does_not_raise_the_stall_torque():
    table = load_drive("brushed_dc", ROOT)
    plan = plan_drive(table.model_copy(update={"parameters": {**table.parameters, "J_m": 7e-5}}))
    growing, inertia = overload(plan), 7e-5 * 19.7**2
    # sqrt(2 J omega r) too high when it has braked the shaft; half of that at least, with some friction
    assert ramped_torque(growing) > BRUSHED_STALL + 0.5 * np.sqrt(2.0 * inertia * 0.45 * 0.25)
    # 2 % as above, and 0.5 J of what a load that is held for 1 s does not stop
    assert stall_torque(plan, growing).value == pytest.approx(BRUSHED_STALL, abs=0.02 * BRUSHED_STALL + 0.5 * inertia)


def test_motors_stall_where_their_equations_say(done: Done):
    # 2 % as above
    assert done("brushed_dc").value("stall_torque") == pytest.approx(BRUSHED_STALL, rel=0.02)
    # (8), (9) of its README at a tenth of the speed in use
    assert done("smart_servo").value("stall_torque") == pytest.approx(3.0 * (1.0 - 0.05 / 8.06) - 0.05, rel=0.02)


def test_quantised_and_stepping_drives_are_measured_or_say_why_not(done: Done):
    # the mean speed of a register of 0.229 rpm, nearest to 0.5 rad/s
    assert done("smart_servo").value("speed") == pytest.approx(21 * 0.229 * np.pi / 30.0, abs=5e-4)
    stepper = {measure.name: measure for measure in done("stepper").measures}
    assert stepper["settling_time"].value is None
    assert "ripple" in stepper["settling_time"].remark
    # the holding torque less the detent torque at most: 0.4 - 0.022 N m; 2 % as above
    assert stepper["stall_torque"].value == pytest.approx(0.378, rel=0.02)


@pytest.mark.parametrize("drive", DRIVES)
def test_every_drive_of_the_shelf_qualifies_and_answers_everything(done: Done, drive: str):
    judged = done(drive)
    assert judged.failed_checks == ()
    assert [check.name for check in judged.checks] == list(CHECK_MEANINGS)
    assert [measure.name for measure in judged.measures] == list(MEASURE_DEFINITIONS)
    for measure in judged.measures:
        assert (measure.value is None) <= bool(measure.remark), f"{measure.name} has neither value nor reason"
        assert measure.value is None or np.isfinite(measure.value)
