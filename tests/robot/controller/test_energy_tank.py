"""The tank by itself: what it counts, what it lets pass."""

import math

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from twin.kernel.errors import ComponentFailed
from twin.robot.controller.energy_tank import (
    COASTING_SHARE,
    JOINT_PLAY,
    RETURN_GAIN,
    Tank,
    TankValve,
    _joint_travel,
    passed_share,
)
from twin.studies.converge.monolith import ComponentStepper

SETTINGS = Tank(0.1, horizon=0.1, touch=0.6, release=math.inf, bias=0.0, late=3e-3, k_s=1.0, N=2.0, eta=1.0)
J = np.diag([10.0, 10.0, -10.0])
"""rad/m: a robot whose joints are its axes, and whose third motor lowers it; 400 N/m each."""
PERIOD = 2e-3


def tank(**settings) -> ComponentStepper:
    return ComponentStepper(TankValve(SETTINGS._replace(**settings)))


def told(
    of: ComponentStepper, sample: float, z: float, F_z: float, omega=(0.0, 0.0, 0.0), valid=1.0
) -> dict[str, np.ndarray]:
    """One call with the head at height `z` (m), pressing down with `F_z` (N)."""
    ports = {
        "omega_ref": np.array(omega), "p_B": np.array([0.0, 0.0, z]), "J": J.ravel(),
        "F_ee_B": np.array([0.0, 0.0, -F_z]), "valid": np.array([valid]), "sample": np.array([float(sample)]),
    }  # fmt: skip
    return of.outputs_by_port(ports, h=PERIOD)


shares, watts, slopes = st.floats(0.0, 0.5), st.floats(-5.0, 5.0), st.floats(1e-3, 500.0)


@given(shares, watts, slopes)
@example(0.001, 4.601133696618957, 0.001)
def test_what_passes_uses_no_more_than_is_left_within_the_horizon(left: float, P: float, Q: float):
    T = 0.1
    s = passed_share(left, T, P, Q)
    assert 0.0 <= s <= 1.0
    # rounding of sums of a few joules, and of the root less P, which lie close together where Q is small
    rounding = 1e-12 + 4e-16 * P * P / Q
    assert s * P * T + 0.5 * s * s * Q * T * T <= left + rounding
    more = min(1.0, 1.001 * s + 1e-6)
    if more > s:
        assert more * P * T + 0.5 * more * more * Q * T * T >= left - rounding


@given(st.floats(-0.5, -1e-9), watts, slopes)
def test_an_empty_tank_lets_the_robot_give_way_only(left: float, P: float, Q: float):
    s = passed_share(left, 0.1, P, Q)
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


def test_the_lightest_force_counts_as_any_other():
    of = tank()
    told(of, 1, 0.0, 0.05)
    found = told(of, 2, -0.02, 0.05)
    assert found["given"] == pytest.approx(0.001) and found["level"] == pytest.approx(0.099)


def test_after_a_while_without_touch_it_is_full_again():
    of = tank(release=0.01)
    told(of, 1, 0.0, 4.0)
    assert told(of, 2, -0.01, 4.0)["level"] == pytest.approx(0.06)
    untouched = [told(of, sample, -0.01, 0.5)["level"][0] for sample in range(3, 9)]
    # five periods are 10 ms, but for rounding
    assert untouched[3] == pytest.approx(0.06) and untouched[5] == 0.1
    never = tank()
    told(never, 1, 0.0, 4.0), told(never, 2, -0.01, 4.0)
    assert told(never, 5000, -0.01, 0.0)["level"] == pytest.approx(0.06)


@pytest.mark.parametrize(("F_z", "charged"), [(4.0, True), (0.5, False)])
def test_what_the_torque_may_be_off_by_is_charged_along_the_way_while_something_is_touched(F_z: float, charged: bool):
    of = tank(bias=0.01)
    told(of, 1, 0.0, F_z)
    down = told(of, 2, -0.004, F_z)
    # 4 mm turn the third joint by 40 mrad, of which the play is no way
    unsure = 0.01 * (0.04 - JOINT_PLAY) if charged else 0.0
    assert down["level"] == pytest.approx(0.1 - 0.004 * F_z - unsure, rel=1e-12)
    # on the way back the play is passed through twice
    up = told(of, 3, 0.0, F_z)
    unsure += 0.01 * (0.04 - 2.0 * JOINT_PLAY) if charged else 0.0
    assert up["given"] == pytest.approx(0.0, abs=1e-15)
    assert up["level"] == pytest.approx(0.1 - unsure, rel=1e-12)


def test_rounding_to_and_fro_is_no_way():
    of = tank(bias=0.01)
    for sample in range(1, 200):
        found = told(of, sample, 0.9e-4 * (sample % 2), 4.0)
    assert found["level"] == pytest.approx(0.1 - 4.0 * 0.9e-4 * (sample % 2 - 1), abs=4e-4)
    assert found["level"] >= 0.1 - 4.0 * 0.9e-4 - 1e-12


def test_the_way_is_that_of_all_three_joints_with_every_move_of_the_head_less_their_play():
    # each joint turns by another amount with each axis
    jacobian, moved = np.array([[1.0, 2.0, 4.0], [-8.0, 16.0, 32.0], [64.0, -3.0, 5.0]]), np.array([0.01, 0.03, 0.07])
    turned = np.zeros(3)
    way = _joint_travel(turned, jacobian.ravel(), moved, np.zeros(3))
    # rounding of sums below 4
    assert way == pytest.approx(np.sum(np.abs(jacobian @ moved) - JOINT_PLAY), rel=1e-12)
    assert turned.tolist() == [JOINT_PLAY] * 3


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


@pytest.mark.parametrize(("F_z", "omega", "at_least"), [
    (0.0, (-8.0, -8.0, -8.0), -8.0), (4.0, (-8.0, -3.0, -8.0), -3.0),  # all go up, at least as fast as the slowest
    (0.0, (-8.0, -8.0, 0.1), 0.0), (-1.0, (-8.0, -8.0, -8.0), 0.0),  # one goes down; something holds it from above
])  # fmt: skip
def test_all_motors_go_up_as_fast_as_all_are_told_to_unless_the_robot_pulls(
    F_z: float, omega: tuple[float, ...], at_least: float
):
    found = told(tank(size=0.03), 1, 0.0, F_z, omega)
    if at_least:
        assert np.max(found["omega_ref"]) == at_least and np.all(found["omega_ref"] >= np.array(omega))
    else:
        assert np.min(found["omega_ref"]) > -8.0
    kept = np.minimum(np.abs(found["omega_ref"]), np.abs(omega)).sum() / np.abs(omega).sum()
    assert found["share"] == pytest.approx(kept, rel=1e-12)


@pytest.mark.parametrize("omega", [0.4, -0.4, 6.0])
def test_what_the_motors_still_do_is_taken_off_before(omega: float):
    F_z, size, T, on = 1.0, 0.004, SETTINGS.horizon, COASTING_SHARE * SETTINGS.horizon
    of, going = tank(size=size), 0.0
    for sample in range(1, 100):
        going += PERIOD / (on + PERIOD) * (told(of, sample, 0.0, F_z, (0.0, 0.0, omega))["omega_ref"][2] - going)
    # 1 N on 10 rad/m is 0.1 N m, in the springs 1.25 mJ; what goes on is P t + Q t^2/2, if it takes anything
    tau, N, k = 0.1, SETTINGS.N, SETTINGS.k_s
    coasting = max(tau * going / N * on + 0.5 * k * going**2 * on**2, 0.0)
    then = told(of, 100, 0.0, F_z, (0.0, 0.0, 0.7))
    assert then["share"] == pytest.approx(
        passed_share(size - 0.5 * F_z**2 / 400.0 - coasting, T, 0.7 * tau / N, 0.49 * k)
    )
    assert 0.0 < then["share"] < 1.0
    assert (coasting > 0.0) == (omega > 0.0)


MOST = 1.0 / (SETTINGS.k_s * SETTINGS.N * SETTINGS.eta * SETTINGS.horizon)


def overdrawn(by: float, F_z: float = 4.0, **settings) -> ComponentStepper:
    """A tank out of which `by` (J) more is gone than there was, springs included; the head is at 0 again by call 5."""
    of = tank(size=0.015 * F_z + 0.5 * F_z**2 / 400.0 - by, **settings)
    # from above, pressed down and, without force, up again: half of it comes back
    for sample, (z, F) in enumerate([(0.05, 0.0), (0.0, 0.0), (0.0, F_z), (-0.03, F_z), (0.0, 0.0)], start=1):
        told(of, sample, z, F)
    return of


def test_overdrawn_it_gives_way_even_if_it_is_not_told_to():
    # 4 N are 0.4 N m; what is gone comes back within the horizon
    found = told(overdrawn(4e-4), 6, 0.0, 4.0)
    assert found["omega_ref"] == pytest.approx([0.0, 0.0, -4e-4 * SETTINGS.N / (SETTINGS.horizon * 0.4)])
    # a command that takes more does not change that
    held = told(overdrawn(1e-3), 6, 0.0, 4.0, (0.0, 0.0, 4.0))
    assert held["omega_ref"] == pytest.approx([0.0, 0.0, -1e-3 * SETTINGS.N / (SETTINGS.horizon * 0.4)])
    # far overdrawn no faster than motor and spring are stable
    assert told(overdrawn(0.04), 6, 0.0, 4.0)["omega_ref"] == pytest.approx([0.0, 0.0, -RETURN_GAIN * MOST * 0.4])
    # of what may be an error nobody gives way
    unsure = told(overdrawn(0.03, bias=0.1), 6, 0.0, 4.0)
    assert unsure["omega_ref"] == pytest.approx([0.0, 0.0, -RETURN_GAIN * MOST * 0.3])
    # 0.03 J of it are charged for 0.3 rad on the way down
    little = told(overdrawn(4e-4 - 0.03, bias=0.1), 6, 0.0, 4.0)
    assert little["omega_ref"] == pytest.approx([0.0, 0.0, -4e-4 * SETTINGS.N / (SETTINGS.horizon * 0.3)])
    assert np.array_equal(told(overdrawn(0.03, bias=0.5), 6, 0.0, 4.0)["omega_ref"], np.zeros(3))


def test_overdrawn_a_motor_that_is_told_to_give_way_does_so_in_proportion_to_its_torque_and_no_other_moves():
    found = told(overdrawn(0.04), 6, 0.0, 4.0, (1.0, -2.0, -8.0))
    assert found["omega_ref"] == pytest.approx([0.0, 0.0, -MOST * 0.4])
    assert found["share"] == pytest.approx(MOST * 0.4 / 11.0)
    slow = told(overdrawn(0.04), 6, 0.0, 4.0, (1.0, -2.0, -1.5))
    assert slow["omega_ref"] == pytest.approx([0.0, 0.0, -1.5])
    assert slow["share"] == pytest.approx(1.5 / 4.5)
    assert told(overdrawn(0.04), 6, 0.0, 4.0, (1.0, 2.0, 8.0))["share"] == 0.0


def test_overdrawn_it_does_not_let_itself_down_again():
    of = overdrawn(0.065)
    assert told(of, 6, 0.010, 0.0)["omega_ref"][2] == 0.0
    # 1 mm below where it has been, on 10 rad/m
    found = told(of, 7, 0.009, 0.0)
    assert found["omega_ref"] == pytest.approx([0.0, 0.0, -SETTINGS.N * 10.0 * RETURN_GAIN / SETTINGS.horizon * 0.001])
    enough = tank()
    told(enough, 1, 0.0, 0.0)
    assert np.array_equal(told(enough, 2, -0.001, 0.0)["omega_ref"], np.zeros(3))


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
