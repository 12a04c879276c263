"""Least squares that knows what it cannot know."""

import numpy as np
import pytest

from tests.studies.identify.calibrations import PLANE, STEP, belief, true_parameters, windows_of_statics
from twin.studies.identify.identification import Fit, fit, line, sandwich, t_factor
from twin.studies.identify.windows import BACKLASH, COMPLIANCE, KAPPA, OFFSET, Windows, in_air, on_scale, parameters


def test_two_clusters_have_one_degree_of_freedom():
    # Student's t of one degree of freedom is Cauchy's: tan(pi 0.475)
    np.testing.assert_allclose(t_factor(2), np.tan(np.pi * 0.475), rtol=1e-9)
    assert t_factor(1) == np.inf


def test_repeating_every_row_makes_no_interval_narrower():
    rng = np.random.default_rng(1)
    A, y, cluster = rng.normal(size=(40, 2)), rng.normal(size=40), np.arange(40) // 4
    once, often = line(A, y, cluster), line(np.tile(A, (9, 1)), np.tile(y, 9), np.tile(cluster, 9))
    assert once is not None and often is not None
    np.testing.assert_allclose(often.coefficients, once.coefficients, rtol=1e-9)
    np.testing.assert_allclose(often.half_widths, once.half_widths, rtol=1e-9)


def test_the_scatter_between_clusters_is_that_of_leaving_each_out():
    rng = np.random.default_rng(2)
    A, y, cluster = rng.normal(size=(30, 3)), rng.normal(size=30), np.arange(30) // 5
    c = np.linalg.lstsq(A, y, rcond=None)[0]
    without = [np.linalg.lstsq(A[cluster != g], y[cluster != g], rcond=None)[0] - c for g in range(6)]
    expected = 5.0 / 6.0 * np.transpose(without) @ without
    np.testing.assert_allclose(sandwich(A, np.linalg.pinv(A), y - A @ c, cluster), expected, rtol=1e-9, atol=1e-12)


def test_what_the_rows_do_not_say_has_no_line():
    assert line(np.ones((9, 2)), np.arange(9.0), np.arange(9)) is None


LEVEL = (11, 12, 13)


def fitted(seen: Windows, height: float | None = None) -> Fit:
    robot = belief()
    unknowns = parameters(robot, PLANE if height is None else height)
    return fit(seen, robot, unknowns, STEP, () if height is None else LEVEL)


def test_statics_without_noise_give_every_parameter_back():
    x = true_parameters()
    found = fitted(windows_of_statics(x, np.random.default_rng(1)), height=-0.1012)
    seen = np.setdiff1d(np.arange(17), [1, 2])
    # Newton's method ends at 1e-6 of sizes of up to 10 (s/m)
    np.testing.assert_allclose(found.x[seen], x[seen], atol=1e-4, rtol=1e-4)
    assert found.x[KAPPA] == pytest.approx(0.828, rel=1e-6)


def test_whatever_friction_pulls_sideways_leaves_the_springs_as_they_are():
    x = true_parameters()
    for side_force in (0.0, 0.3):
        seen = windows_of_statics(x, np.random.default_rng(2), side_force=side_force)
        # 1e-6: side forces of up to 1.8 N would move it by a tenth if they entered
        assert fitted(seen, height=-0.1012).x[KAPPA] == pytest.approx(0.828, rel=1e-6)


@pytest.mark.endurance
def test_intervals_hold_the_truth_nineteen_times_in_twenty():
    x, rng = true_parameters(), np.random.default_rng(3)
    told = [KAPPA, OFFSET, OFFSET + 1, BACKLASH, COMPLIANCE]
    inside = np.zeros(len(told))
    repetitions = 200
    for _ in range(repetitions):
        found = fitted(windows_of_statics(x, rng, noise=np.radians(0.03)), height=-0.1012)
        inside += [abs(found.x[i] - x[i]) <= found.half_width(found.one(i)) for i in told]
    # 200 draws of 95 % scatter by 1.5 %
    np.testing.assert_allclose(inside[:-1] / repetitions, 0.95, atol=0.04)
    # the scale's stiffness does not feel the motors' noise, and is right every time
    assert inside[-1] == repetitions


@pytest.mark.endurance
def test_few_stretches_have_intervals_that_hold_as_well():
    x, rng = true_parameters(), np.random.default_rng(4)
    inside, repetitions = 0, 100
    for _ in range(repetitions):
        seen = windows_of_statics(x, rng, noise=np.radians(0.03))
        found = fitted(seen.where(seen.cluster < 9), height=-0.1012)
        inside += abs(found.x[BACKLASH] - x[BACKLASH]) <= found.half_width(found.one(BACKLASH))
    # 100 draws of 95 % scatter by 2.2 %
    assert inside >= 0.90 * repetitions


def test_a_wrong_length_moves_every_log_alike_and_their_mean_as_much():
    """Intervals know of chance only, and so does the scatter between logs."""
    x, rng = true_parameters(), np.random.default_rng(5)
    wrong = belief()._replace(l_a=belief().l_a + 5e-4)
    found = []
    for _ in range(3):
        seen = windows_of_statics(x, rng, noise=np.radians(0.003))
        found.append(fit(seen, wrong, parameters(wrong, -0.1012), STEP, LEVEL).x[KAPPA] / x[KAPPA] - 1.0)
    # 0.28 % per 0.1 mm in the calibration (docs/identification_method.md), 0.23 % in these windows
    assert np.abs(found) == pytest.approx(0.0115, rel=0.1)
    # by their scatter the mean of three would be far better known than that
    assert abs(np.mean(found)) > 10.0 * np.std(found, ddof=1) / np.sqrt(3)


def test_a_search_that_is_cut_short_says_so(monkeypatch: pytest.MonkeyPatch):
    seen = windows_of_statics(true_parameters(), np.random.default_rng(8))
    assert fitted(seen).converged
    monkeypatch.setattr("twin.studies.identify.identification.STEPS", 2)
    assert not fitted(seen).converged


def test_free_air_alone_does_not_tell_backlash_from_zeros():
    seen = windows_of_statics(true_parameters(), np.random.default_rng(4))
    found = fitted(seen.where(in_air(seen)))
    together = np.zeros(17)
    # every spring holds the platform up, on one side of its dead zone
    together[OFFSET : OFFSET + 3], together[BACKLASH] = 1.0, 2.0
    together /= np.linalg.norm(together)
    assert np.linalg.norm(found.unseen.T @ together) == pytest.approx(1.0, abs=1e-3)
    assert not found.is_determined(found.one(BACKLASH), found.unknowns[BACKLASH].size)


def test_what_is_not_seen_stays_as_it_is_believed():
    seen = windows_of_statics(true_parameters(), np.random.default_rng(5))
    found = fitted(seen.where(in_air(seen)))
    assert found.x[COMPLIANCE] == found.unknowns[COMPLIANCE].start


def test_one_pose_repeated_ever_so_often_tells_nothing():
    seen = windows_of_statics(true_parameters(), np.random.default_rng(6))
    found = fitted(seen.where(on_scale(seen)).where(np.arange(108) == 5).where(np.zeros(500, dtype=int)))
    assert not any(found.is_determined(found.one(i), one.size) for i, one in enumerate(found.unknowns))
