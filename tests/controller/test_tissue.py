"""The stiffness of the tissue from height and force alone, of tissues without robot, noise or springs."""

import math

import numpy as np
import pytest

from twin.controller.dither import dither
from twin.controller.tissue import HIGHEST, TISSUE, band_passed, sense

T_s = 2e-3
MASS, INERTIA, SQUARES = 0.15, 8e-5, 600.0
J = np.array([0.0, -9.0, 10.0, 8.0, 4.0, 10.0, -8.0, 4.0, 20.0])
"""A Jacobian (rad/m) whose z column has the sum of squares SQUARES."""
Z = -0.1


def tissue(**settings):
    m = np.zeros(1, dtype=TISSUE)[0]
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
        sense(m, T_s, height, force, J, True)
    return m


@pytest.mark.parametrize("k", [300.0, 1500.0, 5000.0])
def test_stiffness_and_damping_of_an_ideal_tissue_are_found_with_the_inertia_of_the_platform_taken_out(k):
    m = pressed(tissue(), 2.0, k, c=20.0)
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


def test_where_nothing_moves_the_estimate_is_held_and_doubted_more_and_more():
    m = pressed(tissue(), 2.0)
    k, std = float(m["k"]), float(m["std"])
    pressed(m, 1.5, amplitude=0.0)
    before = float(m["k"])
    pressed(m, 3.0, amplitude=0.0)
    assert m["k"] == before == pytest.approx(k, rel=0.05)
    assert not m["excited"] and m["std"] > std
    # 3 % of it each second, in 3 s
    assert m["std"] == pytest.approx(0.09 * k, rel=0.4)


def test_a_force_that_changes_makes_it_doubtful_in_proportion():
    m = pressed(tissue(), 2.0, F_0=4.0)
    sense(m, T_s, Z, 8.0, J, True)
    # 0.7 of the share by which the force has changed since
    assert m["std"] > 0.3 * m["k"]


def test_what_moves_less_than_rounding_is_no_excitation():
    m = pressed(tissue(angle_rounding=1e-2), 2.0)
    assert not m["known"] and not m["excited"] and m["std"] == HIGHEST


def test_noise_is_told_by_the_standard_error():
    """Of white noise in the height, as rounding makes it where something moves."""
    m = pressed(tissue(angle_rounding=2e-5 * math.sqrt(SQUARES)), 3.0, noise=2e-5)
    assert abs(m["k"] - 1500.0) < 3.0 * m["error"] < 450.0


def test_a_new_press_knows_nothing_of_the_last_one():
    m = pressed(tissue(), 2.0)
    sense(m, T_s, Z + 0.01, 0.0, J, False)
    assert m["known"]
    sense(m, T_s, Z, 1.0, J, True)
    assert not m["known"] and m["std"] == HIGHEST


def test_nothing_is_learnt_in_the_air_or_without_the_force_loop():
    for pressing, F in ((True, 0.2), (False, 4.0)):
        m = tissue()
        for n in range(1000):
            sense(m, T_s, Z + 1e-4 * np.sin(2.0 * np.pi * 5.0 * n * T_s), F, J, pressing)
        assert not m["known"] and not m["excited"]


def test_the_dither_makes_the_force_it_is_told_and_ends_with_a_whole_swing_once_the_tissue_is_known():
    """A tissue that follows the dither at once, behind the springs of the robot."""
    m, k, K = tissue(dither=0.1), 1000.0, 4.0 * SQUARES
    inertia = (MASS + INERTIA * SQUARES) * (2.0 * np.pi * 5.0) ** 2
    shifts, forces = [], []
    for _ in range(1500):
        shift, _ = dither(m, T_s)
        moved = shift * K / (k + K)
        sense(m, T_s, Z + moved, 4.0 - k * moved + inertia * moved, J, True)
        shifts.append(shift)
        forces.append(-k * moved)
    assert m["known"] and not m["dithering"] and m["k"] == pytest.approx(k, rel=0.05)
    at = np.flatnonzero(shifts)
    assert 0.4 < len(at) * T_s < 2.0
    assert abs(shifts[at[-1]]) < 2.0 * np.pi * 5.0 * T_s * max(shifts)
    # as if on rock before it knows: less than is asked for; then as much, but for what the estimate is off by
    assert 0.05 < np.abs(forces).max() <= 0.105


def test_without_a_dither_nothing_is_moved():
    m = tissue(dither=0.0)
    sense(m, T_s, Z, 4.0, J, True)
    assert dither(m, T_s) == (0.0, 0.0)


@pytest.mark.parametrize(("f", "gain"), [(5.0, 1.0), (0.25, 6.3e-4), (50.0, 2.4e-3)])
def test_the_band_pass_has_gain_one_in_its_middle_and_gives_the_derivative_of_what_it_passes(f, gain):
    states = tissue()["z"]
    g, omega = math.tan(math.pi * 5.0 * T_s), 2.0 * np.pi * f
    t = np.arange(5000) * T_s
    passed = np.array([band_passed(states, g, x) for x in np.sin(omega * t)])[2500:]
    assert np.abs(passed[:, 0]).max() == pytest.approx(gain, rel=0.2)
    # of the trapezoidal rule: tan(omega T/2)/tan(pi 5 T) for omega/(2 pi 5 Hz)
    rate = math.tan(0.5 * omega * T_s) / g
    assert np.abs(passed[:, 1]).max() == pytest.approx(rate * np.abs(passed[:, 0]).max(), rel=0.02)
