"""An oscillator that locks to the breath, from height and force of a robot that follows it well or not at all."""

import numpy as np
import pytest

from twin.robot.controller.breath import BREATH_RECORD, breath_velocity
from twin.robot.controller.tissue import TISSUE_RECORD

T_s = 2e-3
K = 1500.0


def followed(seconds, rate=0.25, begun=0.25, amplitude=1e-3, gives_way=0.9, lag=0.0, std=50.0, noise=0.0):
    """(velocity told, that of the surface, rate believed) at each call.

    Args:
        gives_way: share of the surface's motion that the robot goes along with; the rest presses.
        noise: rms of the height (m).
    """
    m, tissue = np.zeros(1, dtype=BREATH_RECORD)[0], np.zeros(1, dtype=TISSUE_RECORD)[0]
    m["rate"], m["lag"] = begun, lag
    tissue["known"], tissue["k"], tissue["std"], tissue["since"], tissue["pressing"] = 1, K, std, 1.0, 1
    t = np.arange(round(seconds / T_s)) * T_s
    omega = 2.0 * np.pi * rate
    surface, v = amplitude * (1.0 - np.cos(omega * t)), amplitude * omega * np.sin(omega * (t + lag))
    z = gives_way * surface + noise * np.random.default_rng(1).standard_normal(len(t))
    F = 5.0 + K * (surface - z)
    told = [
        (breath_velocity(m, tissue, T_s, a, b), float(m["omega"]) / (2.0 * np.pi)) for a, b in zip(z, F, strict=True)
    ]
    return np.array(told)[:, 0], v, np.array(told)[:, 1]


def left(told, v):
    """Rms that is left of the surface's velocity, as a share, of the last half."""
    half = slice(len(v) // 2, None)
    return np.sqrt(np.mean((told - v)[half] ** 2) / np.mean(v[half] ** 2))


@pytest.mark.parametrize("gives_way", [0.0, 0.5, 1.0])
def test_the_velocity_of_the_surface_is_told_however_well_the_robot_follows(gives_way):
    told, v, _ = followed(16.0, gives_way=gives_way)
    # the cosine of the low-pass's lag is taken to second order; 1 degree of phase is 2 %
    assert left(told, v) < 0.03


@pytest.mark.parametrize("rate", [0.18, 0.25, 0.33])
def test_it_locks_to_the_rate_and_is_useful_before(rate):
    told, v, believed = followed(24.0, rate)
    assert believed[-1] == pytest.approx(rate, rel=0.02) and left(told, v) < 0.05
    second = slice(round(1.0 / rate / T_s), round(2.0 / rate / T_s))
    # from the second breath on at most a third is left
    assert np.std((told - v)[second]) < 0.34 * np.std(v[second])


def test_it_is_ahead_by_the_lag_of_the_robot():
    told, v, _ = followed(16.0, lag=0.15)
    assert left(told, v) < 0.04
    assert left(followed(16.0)[0], v) > 0.2


def test_rounding_hardly_moves_the_robot():
    told, v, believed = followed(16.0, noise=5e-6)
    assert left(told, v) < 0.05 and believed[-1] == pytest.approx(0.25, rel=0.03)


def test_nothing_is_fed_forward_of_a_tissue_that_is_not_known():
    assert not followed(4.0, std=1000.0)[0].any()


def test_a_surface_that_stands_still_stays_still_and_the_rate_as_it_was():
    told, _, believed = followed(8.0, amplitude=0.0)
    assert not told.any() and believed[-1] == pytest.approx(0.25)
