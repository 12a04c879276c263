import numpy as np
import pytest

from twin.robot.assembly.drives import planned
from twin.robot.experiment.drive_files import lone_drive
from twin.studies.analyse.operating_point import identified, sum_of_sines

TICK = 1e-3


def test_the_default_drive_is_its_own_equation(root):
    drive = identified(planned(lone_drive("velocity_servo", root)), TICK, 0.05)
    # T_m d omega / dt = omega_ref - droop tau_load - omega, solved exactly over a tick with inputs held
    assert drive.A == pytest.approx(np.array([[np.exp(-TICK / 0.02)]]), rel=1e-9)
    # advance per tick of a speed command, and of a load with a droop of 0.6 rad/s per N m; a fit by least squares
    np.testing.assert_allclose(drive.steady_gain, [TICK, -0.6 * TICK], rtol=1e-9)


@pytest.mark.parametrize("name", ["brushed_dc", "pmsm_foc", "torque_motor_fmi3"])
def test_drives_of_other_kinds_follow_their_command_at_rest(root, name):
    drive = identified(planned(lone_drive(name, root)), TICK, 0.05)
    # 5 %: ripple and friction of the nonlinear ones
    np.testing.assert_allclose(drive.steady_gain, [TICK, 0.0], atol=0.05 * TICK)


def test_the_same_drive_gives_the_same_model_twice(root):
    plan = planned(lone_drive("pmsm_foc", root))
    one, two = identified(plan, TICK, 0.05), identified(plan, TICK, 0.05)
    np.testing.assert_array_equal(one.A, two.A)
    np.testing.assert_array_equal(one.B, two.B)


def test_a_sum_of_sines_has_its_lines_and_nothing_else():
    lines = np.array([1, 4, 9])
    wave = sum_of_sines(1000, lines, np.array([0.3, 2.0, 5.0]))
    spectrum = np.abs(np.fft.rfft(wave))
    # powers fall as 1/f; a transform's rounding
    np.testing.assert_allclose(spectrum[lines] / spectrum[1], 1.0 / np.sqrt(lines), rtol=1e-9)
    assert np.delete(spectrum, lines).max() < 1e-9 * spectrum[1]
    assert np.max(np.abs(wave)) == pytest.approx(1.0)


@pytest.mark.parametrize("name", ["smart_servo", "xl330"])
def test_a_drive_that_swallows_small_signals_is_measured_while_it_turns(root, name):
    """Registers do so, and friction that sticks."""
    assert identified(planned(lone_drive(name, root)), TICK, -0.002).turning


def test_a_drive_that_answers_small_signals_is_measured_at_rest(root):
    assert not identified(planned(lone_drive("velocity_servo", root)), TICK, 0.05).turning
