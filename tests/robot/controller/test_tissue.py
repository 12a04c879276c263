"""The stiffness of the tissue from height and force alone, of tissues without robot, noise or springs."""

import math

import numpy as np
import pytest

from twin.robot.controller.adaptive import dither
from twin.robot.controller.tissue import MAX_STIFFNESS, TISSUE_RECORD, _solve_normal_equations, band_pass, update_tissue

T_s = 2e-3
MASS, INERTIA, SQUARES = 0.15, 8e-5, 600.0
J = np.array([0.0, -9.0, 10.0, 8.0, 4.0, 10.0, -8.0, 4.0, 20.0])
"""A Jacobian (rad/m) whose z column has the sum of squares SQUARES."""
Z = -0.1


def tissue(**settings):
    m = np.zeros(1, dtype=TISSUE_RECORD)[0]
    given = {
        "frequency": 5.0, "window": 0.5, "dither": 0.1, "enough": 0.1, "doubtful": 0.2, "contact": 0.3, "mass": MASS,
        "inertia": INERTIA, "joint_spring": 4.0, "angle_rounding": 1e-4, "torque_rounding": 1e-4,
    }  # fmt: skip
    for name, value in {**given, **settings}.items():
        m[name] = value
    return m


def pressed(m, seconds, k=1500.0, c=0.0, breath=0.0, speed=0.0, amplitude=5e-5, F_0=4.0, noise=0.0):
    """`m` after so long on a tissue of stiffness k and damping c, whose surface breathes, under a sine of 5 Hz.

    What is felt is the force of statics: it lacks the platform's inertia. `noise`: rms of it in height (m).
    """
    omega, slow = 2.0 * np.pi * 5.0, 2.0 * np.pi * 0.25
    t = np.arange(round(seconds / T_s)) * T_s
    z = Z + amplitude * np.sin(omega * t) + speed * t
    v, a = amplitude * omega * np.cos(omega * t) + speed, -amplitude * omega**2 * np.sin(omega * t)
    surface, v_surface = breath * np.sin(slow * t), breath * slow * np.cos(slow * t)
    F = F_0 + k * (surface + Z - z) + c * (v_surface - v) - (MASS + INERTIA * SQUARES) * a
    z = z + noise * np.random.default_rng(1).standard_normal(len(z))
    for height, force in zip(z, F, strict=True):
        update_tissue(m, T_s, height, force, J, True)
    return m


@pytest.mark.parametrize("k", [300.0, 1500.0, 5000.0])
def test_stiffness_and_damping_of_an_ideal_tissue_are_found_with_the_inertia_of_the_platform_taken_out(k):
    # without a dither all that moves is learnt from, to the end
    m = pressed(tissue(dither=0.0), 2.0, k, c=20.0)
    # the second difference of a sine of 5 Hz is (omega T_s)^2/12 = 0.03 % short, 0.07 N/m of 200; the rest is what is
    # left of the beginning after four time constants
    assert m["k"] == pytest.approx(k, abs=1.0 + 2e-3 * k)
    assert m["c"] == pytest.approx(20.0, abs=0.2)
    assert m["known"] and m["std"] < 0.1 * k


def test_a_surface_that_breathes_forty_times_as_far_as_the_dither_does_not_bias_it():
    m = pressed(tissue(), 4.0, breath=2e-3)
    # two stages let 6e-4 of a breath of 0.25 Hz through, 0.02 of the dither; it is not of its frequency
    assert m["k"] == pytest.approx(1500.0, rel=0.02)


def test_a_surface_that_moves_evenly_does_not_bias_it():
    assert pressed(tissue(), 2.0, speed=-2e-4)["k"] == pytest.approx(1500.0, rel=2e-3)


def test_where_nothing_moves_the_estimate_is_held_and_no_more_doubted_than_before():
    m = pressed(tissue(), 2.0)
    pressed(m, 1.5, amplitude=0.0)
    k, std = float(m["k"]), float(m["std"])
    pressed(m, 30.0, amplitude=0.0)
    assert m["k"] == k == pytest.approx(1500.0, rel=0.05)
    # of a height that has settled on another by a fraction of a um
    assert not m["excited"] and m["std"] == pytest.approx(std, rel=0.01)


def test_where_the_height_moves_under_the_same_force_the_estimate_is_doubted_more_and_more():
    m = pressed(tissue(), 2.0)
    k = float(m["k"])
    # 1 mm in 5 s: as much as 0.4 of stiffness would make, but no more than 3 % a second is believed
    pressed(m, 5.0, amplitude=0.0, speed=-2e-4)
    update_tissue(m, T_s, Z - 1e-3, 4.0, J, True)
    assert m["k"] == pytest.approx(k, rel=0.05)
    assert m["std"] == pytest.approx(0.03 * 5.0 * k, rel=0.4)


def test_while_the_reference_stands_still_the_dither_hides_beneath_the_force_error_and_rests_where_there_is_none():
    assert not np.any(dithered(tissue(), 2.0, 1000.0, rising=0.0)[0])
    _, forces = dithered(tissue(enough=0.0), 4.0, 1000.0, rising=0.0, off=0.2)
    # 0.3 of 0.2 N, not the 0.1 N of a rising reference
    assert 0.04 < np.abs(forces[1000:]).max() <= 0.063


def test_while_the_reference_falls_the_dither_rests():
    assert not np.any(dithered(tissue(), 2.0, 1000.0, rising=-1e-3, off=0.2)[0])


def test_a_force_that_changes_makes_it_doubtful_in_proportion():
    m = pressed(tissue(), 2.0, F_0=4.0)
    update_tissue(m, T_s, Z, 8.0, J, True)
    # 0.7 of the share by which the force has changed since
    assert m["std"] > 0.3 * m["k"]


def test_what_moves_less_than_rounding_is_no_excitation():
    m = pressed(tissue(angle_rounding=1e-2), 2.0)
    assert not m["known"] and not m["excited"] and m["std"] == MAX_STIFFNESS


def test_noise_is_told_by_the_standard_error():
    """Of white noise in the height, as rounding makes it where something moves."""
    m = pressed(tissue(angle_rounding=2e-5 * math.sqrt(SQUARES)), 3.0, noise=2e-5)
    assert abs(m["k"] - 1500.0) < 3.0 * m["error"] < 450.0


def test_a_new_press_knows_nothing_of_the_last_one():
    m = pressed(tissue(), 2.0)
    update_tissue(m, T_s, Z + 0.01, 0.0, J, False)
    assert m["known"]
    update_tissue(m, T_s, Z, 1.0, J, True)
    assert not m["known"] and m["std"] == MAX_STIFFNESS


def test_nothing_is_learnt_in_the_air_or_without_the_force_loop():
    for pressing, F in ((True, 0.2), (False, 4.0)):
        m = tissue()
        for n in range(1000):
            update_tissue(m, T_s, Z + 1e-4 * np.sin(2.0 * np.pi * 5.0 * n * T_s), F, J, pressing)
        assert not m["known"] and not m["excited"]


def dithered(m, seconds, k, rising=1e-9, off=0.0):
    """(shift of the reference, force that it makes) of a tissue that follows at once, behind the robot's springs.

    Args:
        rising: what the reference of 4 N rises by in a call (N).
        off: by how much the force is held off it (N).
    """
    K, inertia = 4.0 * SQUARES, (MASS + INERTIA * SQUARES) * (2.0 * np.pi * 5.0) ** 2
    shifts: list[float] = []
    forces: list[float] = []
    for n in range(round(seconds / T_s)):
        F = 4.0 - off + (forces[-1] if forces else 0.0)
        shift, _ = dither(m, T_s, F, 4.0 + rising * n)
        moved = shift * K / (k + K)
        update_tissue(m, T_s, Z + moved, 4.0 - k * moved + inertia * moved, J, True)
        shifts.append(shift)
        forces.append(-k * moved)
    return np.array(shifts), np.array(forces)


def test_the_dither_ends_with_a_whole_swing_once_the_tissue_is_known():
    m = tissue(dither=0.1)
    shifts, forces = dithered(m, 3.0, 1000.0)
    assert m["known"] and not m["dithering"] and m["k"] == pytest.approx(1000.0, rel=0.05)
    at = np.flatnonzero(shifts)
    assert 0.4 < len(at) * T_s < 2.0
    assert abs(shifts[at[-1]]) < 2.0 * np.pi * 5.0 * T_s * max(shifts)
    # as if on rock before it knows: less than is asked for
    assert 0.02 < np.abs(forces).max() <= 0.105


def test_the_dither_grows_to_the_force_it_is_told_and_at_most_twofold_from_swing_to_swing():
    # what never knows enough never ends
    shifts, forces = dithered(tissue(dither=0.1, enough=0.0), 4.0, 1000.0)
    # but for what the estimate is off by, and its error, which counts as stiffer
    assert 0.085 < np.abs(forces).max() <= 0.105
    swings = np.abs(shifts[: 19 * 100]).reshape(-1, 100).max(axis=1)
    assert np.all(swings[1:] <= 2.0 * swings[:-1] * (1.0 + 1e-9))


@pytest.mark.parametrize("stiffer", [3.0, 12.0])
def test_a_tissue_that_has_become_stiff_unnoticed_is_noticed_before_the_dither_makes_much_force(stiffer: float):
    # known as soft, then nothing moves until the dither begins again
    m, k = tissue(dither=0.15), 400.0
    dithered(m, 3.0, k)
    assert not m["dithering"]
    m["error"] = 0.25 * k
    _, forces = dithered(m, 3.0, stiffer * k)
    # the amplitude for the tissue it was would make 1.6 and 2.4 N; the force asked for is 0.15 N
    assert np.abs(forces).max() < 2.0 * 0.15
    assert m["k"] == pytest.approx(stiffer * k, rel=0.1)


@pytest.mark.parametrize("ratio", [0.1, 3.0, 12.0])
def test_a_tissue_whose_stiffness_changes_without_a_new_touch_is_doubted_within_a_swing_and_learnt_anew(ratio: float):
    k = 800.0
    m = pressed(tissue(), 2.0, k, amplitude=2e-4)
    assert m["k"] == pytest.approx(k, rel=0.01) and m["std"] < 0.2 * k
    # twelve times as stiff, as much force from the same height on; what changes is how it goes with the height
    pressed(m, 0.2, ratio * k, amplitude=2e-4)
    assert m["std"] == MAX_STIFFNESS
    pressed(m, 2.0, ratio * k, amplitude=2e-4)
    assert m["k"] == pytest.approx(ratio * k, rel=0.05) and m["std"] < 0.2 * ratio * k


def test_a_force_that_jumps_where_nothing_moves_is_doubted_at_once():
    m = pressed(tissue(), 2.0, amplitude=1e-4)
    pressed(m, 0.05, amplitude=1e-6, F_0=8.0)
    assert m["std"] == MAX_STIFFNESS


def test_what_fits_the_estimate_is_not_doubted_however_far_it_moves():
    m = pressed(tissue(), 2.0, amplitude=5e-5)
    for amplitude in (4e-4, 1e-3):
        pressed(m, 1.0, amplitude=amplitude)
        assert m["std"] < 0.2 * m["k"]


def test_a_count_now_and_then_is_no_misfit():
    # of rounding whose rms is 0.05 N in all of the spectrum: a count is 0.17 N
    m = tissue(torque_rounding=0.05 / math.sqrt(SQUARES))
    pressed(m, 2.0, amplitude=2e-4)
    for n in range(10):
        pressed(m, 0.1, amplitude=0.0, F_0=4.0 + 0.17 * (n % 2))
        assert m["std"] < 0.2 * m["k"]


def test_the_means_that_the_estimate_is_tested_with_are_those_of_half_a_swing():
    m = pressed(tissue(), 0.1)
    assert m["averaging"] == pytest.approx(T_s / (0.5 / 5.0), rel=1e-12)


def test_the_recorded_error_counts_the_lag_of_the_band_pass_where_the_force_rises():
    m = tissue()
    t = np.arange(1500) * T_s
    for height, force in zip(Z + 1e-4 * np.sin(10.0 * np.pi * t), 2.0 + 2.0 * t, strict=True):
        update_tissue(m, T_s, height, force - 1500.0 * (height - Z), J, True)
    # both stages of the band-pass are late by 2 Q/(2 pi f), 0.25 s in all, in which the force has risen by 0.5 N of 8
    late = 0.7 * 0.5 / 8.0
    changed = math.sqrt(m["std"] ** 2 - m["error"] ** 2) / m["k"]
    changed_late = math.sqrt(m["std_late"] ** 2 - m["error"] ** 2) / m["k"]
    assert changed_late - changed == pytest.approx(late, rel=0.15)


def solved(k, error, age=0.0, k_before=1000.0, std_before=100.0):
    """The estimate after one solution (k, its standard error) that comes to one of before that is doubted."""
    m, zz, n = tissue(angle_rounding=0.0), 1e-6, 1000.0
    m["keep"], m["in_band"], m["since"], m["known"], m["age"] = 1.0, 100.0, 1.0, 1, age
    m["k"], m["std"], m["n"], m["zz"], m["vv"], m["zF"] = k_before, std_before, n, zz, zz, -k * zz
    m["zzF"] = 4.0 * zz
    # error^2 = (what is left)/n in_band/zz
    m["FF"] = k * k * zz + n * error * error * zz / 100.0
    _solve_normal_equations(m, 4.0)
    return m


@pytest.mark.parametrize(("k", "error", "taken"), [
    (1000.0, 90.0, True), (1000.0, 110.0, False),
    # a worse one contradicts from 2 (110 + 100) N/m on
    (1410.0, 110.0, False), (1430.0, 110.0, True), (590.0, 110.0, False), (570.0, 110.0, True),
    # as well known, and equal
    (1000.0, 99.99, True),
])  # fmt: skip
def test_of_two_estimates_that_agree_the_better_one_stands_and_one_that_contradicts_is_taken(k, error, taken):
    m = solved(k, error)
    assert (m["error"] == pytest.approx(error, rel=1e-6)) == taken
    assert m["k"] == pytest.approx(k if taken else 1000.0, rel=1e-9)


def test_a_new_estimate_is_not_as_old_as_the_one_before():
    # 3 % a second would make 99 to 134 N/m of a new one in 3 s, and leave the old one
    assert solved(1000.0, 99.0, age=3.0)["error"] == pytest.approx(99.0, rel=1e-6)


def test_without_a_dither_nothing_is_moved():
    m = tissue(dither=0.0)
    update_tissue(m, T_s, Z, 4.0, J, True)
    assert dither(m, T_s, 4.0, 4.0) == (0.0, 0.0)


@pytest.mark.parametrize(("f", "gain"), [(5.0, 1.0), (0.25, 6.3e-4), (50.0, 2.4e-3)])
def test_the_band_pass_has_gain_one_in_its_middle_and_gives_the_derivative_of_what_it_passes(f, gain):
    states = tissue()["z"]
    g, omega = math.tan(math.pi * 5.0 * T_s), 2.0 * np.pi * f
    t = np.arange(5000) * T_s
    passed = np.array([band_pass(states, g, x) for x in np.sin(omega * t)])[2500:]
    assert np.abs(passed[:, 0]).max() == pytest.approx(gain, rel=0.2)
    # of the trapezoidal rule: tan(omega T/2)/tan(pi 5 T) for omega/(2 pi 5 Hz)
    rate = math.tan(0.5 * omega * T_s) / g
    assert np.abs(passed[:, 1]).max() == pytest.approx(rate * np.abs(passed[:, 0]).max(), rel=0.02)
