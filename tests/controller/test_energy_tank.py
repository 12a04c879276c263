"""The tank by itself: what it counts, what it lets pass."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twin.controller.energy_tank import COASTING, EnergyTank, Tank, passed_on
from twin.errors import ComponentFailed
from twin.studies.converge.by_hand import Sampled

SETTINGS = Tank(0.1, horizon=0.1, touch=0.6, release=math.inf, bias=0.0, late=3e-3, k_s=1.0, N=2.0, eta=1.0)
J = np.diag([10.0, 10.0, -10.0])
"""rad/m: a robot whose joints are its axes, and whose third motor lowers it; 400 N/m each."""
PERIOD = 2e-3


def tank(**settings) -> Sampled:
    return Sampled(EnergyTank(SETTINGS._replace(**settings)))


def told(of: Sampled, sample: float, z: float, F_z: float, omega=(0.0, 0.0, 0.0), valid=1.0) -> dict[str, np.ndarray]:
    """One call with the head at height `z` (m), pressing down with `F_z` (N)."""
    ports = {
        "omega_ref": np.array(omega), "p_B": np.array([0.0, 0.0, z]), "J": J.ravel(),
        "F_ee_B": np.array([0.0, 0.0, -F_z]), "valid": np.array([valid]), "sample": np.array([float(sample)]),
    }  # fmt: skip
    return of.named(ports, h=PERIOD)


shares, watts, slopes = st.floats(0.0, 0.5), st.floats(-5.0, 5.0), st.floats(1e-3, 500.0)


@given(shares, watts, slopes)
def test_what_passes_uses_no_more_than_is_left_within_the_horizon(left: float, P: float, Q: float):
    T = 0.1
    s = passed_on(left, T, P, Q)
    assert 0.0 <= s <= 1.0
    # rounding of sums of a few joules
    assert s * P * T + 0.5 * s * s * Q * T * T <= left + 1e-12
    more = min(1.0, 1.001 * s + 1e-6)
    if more > s:
        assert more * P * T + 0.5 * more * more * Q * T * T >= left - 1e-12


@given(st.floats(-0.5, -1e-9), watts, slopes)
def test_an_empty_tank_lets_the_robot_give_way_only(left: float, P: float, Q: float):
    s = passed_on(left, 0.1, P, Q)
    if P >= 0.0:
        assert s <= 1e-6
    else:
        # no other share gives more back, unless it stops where all is back
        used = [share * P * 0.1 + 0.5 * share * share * Q * 0.01 for share in np.linspace(0.0, 1.0, 101)]
        assert s * P * 0.1 + 0.5 * s * s * Q * 0.01 <= max(min(used) + 1e-3, left + 1e-9)


def test_it_counts_force_times_way_and_what_the_springs_hold():
    of = tank()
    told(of, 1, 0.0, 2.0)
    found = told(of, 2, -0.004, 4.0)
    assert found["given"] == pytest.approx(0.5 * (2.0 + 4.0) * 0.004, rel=1e-12)
    assert found["level"] == pytest.approx(0.1 - 0.012, rel=1e-12)
    # 4 N on 400 N/m
    assert found["stored"] == pytest.approx(0.5 * 4.0**2 / 400.0, rel=1e-12)


def test_what_comes_back_fills_it_up_to_its_size():
    of = tank()
    for sample, (z, F_z) in enumerate([(0.0, 2.0), (-0.004, 4.0), (0.004, 4.0)], start=1):
        found = told(of, sample, z, F_z)
    assert found["level"] == 0.1 and found["given"] < 0.0


def test_what_touches_nothing_is_not_counted_and_after_a_while_it_is_full_again():
    of = tank(release=0.01)
    told(of, 1, 0.0, 4.0)
    assert told(of, 2, -0.01, 4.0)["level"] == pytest.approx(0.06)
    for sample in range(3, 8):
        found = told(of, sample, -0.01 * sample, 0.5)
        assert found["given"] == pytest.approx(0.04)
    assert found["level"] == 0.1
    never = tank()
    told(never, 1, 0.0, 4.0), told(never, 2, -0.01, 4.0)
    assert told(never, 5000, 0.0, 0.0)["level"] == pytest.approx(0.06)


def test_a_command_passes_unchanged_as_long_as_there_is_plenty():
    omega = np.array([0.1, -0.2, 0.05])
    found = told(tank(size=5.0), 1, 0.0, 4.0, omega)
    assert found["share"] == 1.0 and np.array_equal(found["omega_ref"], omega)


def test_pressing_harder_it_passes_on_what_lasts_for_the_horizon():
    found = told(tank(size=0.05), 1, 0.0, 4.0, (0.0, 0.0, 4.0))
    # 0.02 J in the springs leave 0.03; 0.4 N m at 2 rad/s of the joint, and 1 N m/rad times 4 rad/s squared
    P, Q, T = 0.8, 16.0, 0.1
    share = (math.sqrt(P * P + 2.0 * Q * 0.03) - P) / (Q * T)
    assert found["share"] == pytest.approx(share, rel=1e-9)
    assert found["omega_ref"][2] == pytest.approx(4.0 * share, rel=1e-9)


def test_in_the_air_it_bounds_the_speed_by_what_a_wall_would_take():
    found = told(tank(), 1, 0.0, 0.0, (0.0, 0.0, 100.0))
    speed = found["omega_ref"][2] / (SETTINGS.N * -J[2, 2])
    # 1/2 400 N/m (v T)^2 = 0.1 J
    assert speed == pytest.approx(math.sqrt(2.0 * 0.1 / 400.0) / 0.1, rel=1e-9)


@pytest.mark.parametrize(("F_z", "omega", "whole"), [
    (0.0, (-8.0, -8.0, -8.0), True), (4.0, (-8.0, -1.0, 0.0), True),  # away from what is touched, or from nothing
    (0.0, (-8.0, -8.0, 0.1), False), (-1.0, (-8.0, -8.0, -8.0), False),  # one goes down; something holds it from above
])  # fmt: skip
def test_a_robot_that_is_told_to_go_up_may_unless_it_pulls(F_z: float, omega: tuple[float, ...], whole: bool):
    found = told(tank(size=0.05), 1, 0.0, F_z, omega)
    assert (found["share"] == 1.0) == whole
    assert np.array_equal(found["omega_ref"], omega) == whole


def test_what_the_motors_still_do_is_taken_off_before():
    of = tank(size=0.004)
    for sample in range(1, 200):
        moving = told(of, sample, 0.0, 1.0, (0.0, 0.0, 0.4))
    resting = told(tank(size=0.004), 1, 0.0, 1.0, (0.0, 0.0, 0.4))
    assert 0.0 < moving["share"] < resting["share"]
    assert 0.0 < COASTING < 1.0


def test_without_a_new_message_the_motors_stand_still():
    of = tank(size=5.0)
    assert told(of, 7, 0.0, 1.0, (0.1, 0.1, 0.1))["share"] == 1.0
    # one that is missing may still come
    assert told(of, 7, 0.0, 1.0, (0.1, 0.1, 0.1))["share"] == 1.0
    for _ in range(3):
        assert np.array_equal(told(of, 7, 0.0, 1.0, (0.1, 0.1, 0.1))["omega_ref"], np.zeros(3))
    assert told(of, 8, 0.0, 1.0, (0.1, 0.1, 0.1))["share"] == 1.0
    # what fits no pose tells as little
    for sample in (9, 10, 11):
        blind = told(of, sample, 0.0, 1.0, (0.1, 0.1, 0.1), valid=0.0)
    assert blind["share"] == 0.0


@pytest.mark.parametrize("sample", [math.nan, math.inf, 1e300])
def test_a_message_without_a_number_is_refused(sample: float):
    of = tank()
    told(of, 1, 0.0, 0.0)
    with pytest.raises(ComponentFailed, match="tank got an encoder message without a number"):
        told(of, sample, 0.0, 0.0)
