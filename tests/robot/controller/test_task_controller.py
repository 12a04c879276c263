"""The controller of tasks: what it feeds forward, when its force loop acts, and that it keeps to its limits."""

import numpy as np
import pytest

from tests.laws.runs import ComponentStepper
from tests.robot.controller.soft_floor import (
    APPROACH,
    CONTACT,
    FLOOR,
    FORCE_GAINS,
    FORWARD,
    J_HOME,
    LAW,
    PRESS,
    PUSH,
    ROLL,
    STIFFNESS,
    TAP,
    TOUCH,
    UNDAMPED,
    T_s,
    World,
    carried_out,
    phases_of,
    task_controller,
)
from twin.robot.controller.compliance import REST_SPEED
from twin.robot.controller.pid import Gains, low_pass_share
from twin.robot.controller.program import PhaseKind as Kind
from twin.robot.controller.program import program
from twin.robot.controller.task_controller import TaskController

J = J_HOME.reshape(3, 3)


def during(rows, kind):
    return rows["phase"] == kind


def test_without_gains_the_motors_are_told_to_move_at_the_speed_of_the_reference():
    rows = carried_out([PRESS, PUSH], 16.0)
    # omega = N J v, row by row; rounding
    np.testing.assert_allclose(rows["omega_ref"], LAW.N * rows["v_ref_B"] @ J.T, rtol=0, atol=1e-13)


def test_position_error_and_feed_forward_add_up():
    rows = carried_out([PRESS], 8.0, position=12.0)
    before = np.vstack([rows["p_cmd_B"][:1], rows["p_cmd_B"][:-1]])
    expected = LAW.N * (rows["v_ref_B"] + 12.0 * (rows["p_cmd_B"] - before)) @ J.T
    # rounding
    np.testing.assert_allclose(rows["omega_ref"], expected, rtol=0, atol=1e-11)


def test_feed_forward_is_ahead_of_the_reference_by_the_lag_of_the_drives():
    lag = 10 * T_s
    on_time, ahead = carried_out([PUSH], 6.0), carried_out([PUSH], 6.0, forward=FORWARD._replace(lag=lag))
    pushing = np.flatnonzero(during(on_time, Kind.PUSH))[:-10]
    # rounding of times that differ by a sum
    np.testing.assert_allclose(ahead["omega_ref"][pushing], on_time["omega_ref"][pushing + 10], rtol=0, atol=1e-9)


@pytest.mark.parametrize("lag", [0.0, 0.02])
def test_deflection_on_a_circle_is_the_derivative_of_the_load(lag):
    forward = FORWARD._replace(mu=0.22, k_s=1.3, eta=0.9, lag=lag)
    rows = carried_out([ROLL], 7.0, forward=forward)
    first = next(k for _, kind, k in phases_of(rows) if kind == Kind.CIRCLE)
    t = rows["t"] - rows["t"][first]
    full = during(rows, Kind.CIRCLE) & (t > 1.0) & (t < 2.5)
    omega = 2.0 * np.pi * ROLL.rate
    speed = omega * ROLL.radius
    angle = omega * (t[full] + lag)
    v = speed * np.stack([-np.sin(angle), np.cos(angle), 0.0 * angle], axis=1)
    # the friction mu F v/|v| turns with v, half a call later: it is a difference over one call
    angle = angle + 0.5 * omega * T_s
    dF = -omega * np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1)
    dF *= 0.22 * ROLL.force * speed / np.hypot(speed, REST_SPEED)
    deflection = np.linalg.solve(J.T, dF.T).T / (1.3 * LAW.N * 0.9)
    assert np.abs(deflection).max() > 0.1
    # the difference over a call is off by (omega T_s)^2/24, 7e-6 of it, and the force by what the loop leaves
    np.testing.assert_allclose(rows["omega_ref"][full], LAW.N * v @ J.T + deflection, rtol=0, atol=2e-5)


def test_nothing_is_wound_up_where_the_robot_does_not_press():
    rubbing, smooth = carried_out([TAP], 6.0, forward=FORWARD._replace(mu=0.5)), carried_out([TAP], 6.0)
    np.testing.assert_array_equal(rubbing["omega_ref"], smooth["omega_ref"])


def test_the_force_loop_is_off_in_the_air_and_leaves_nothing_behind():
    rows = carried_out([PRESS, PRESS], 16.0)
    off = rows["triggered"] < 0.5
    pressing = np.isin(rows["phase"], [Kind.BUILD_UP, Kind.HOLD, Kind.RELEASE])
    np.testing.assert_array_equal(off, ~pressing)
    np.testing.assert_array_equal(rows["dp_z"][off], 0.0)
    np.testing.assert_array_equal(rows["F_z_ref"][off], 0.0)
    # both presses are the same, but for where the reference starts: that one is a bit short of its height
    holding = [rows["F_z"][during(rows, Kind.HOLD) & (rows["task"] == task)] for task in (1, 2)]
    np.testing.assert_allclose(holding[0], holding[1], rtol=0, atol=0.02)


def test_the_soft_floor_is_pressed_with_the_force_of_the_task():
    rows = carried_out([PRESS], 8.0)
    held = rows["F_z"][during(rows, Kind.HOLD)]
    # the end of the build-up leaves the integral something to do
    assert held[-1] == pytest.approx(PRESS.force, rel=1e-3)


def test_commanded_speeds_stay_within_their_limit_whatever_is_fed_forward():
    rows = carried_out([TAP, ROLL], 12.0, law=LAW._replace(omega_max=0.5), forward=FORWARD._replace(mu=0.9))
    assert np.abs(rows["omega_ref"]).max() == 0.5


def test_force_is_low_passed_as_a_first_order_lag():
    corner = 20.0
    rows = carried_out([PRESS], 3.0, law=LAW._replace(corner=corner))
    raw = STIFFNESS * np.maximum(0.0, FLOOR - rows["z"])
    share = 1.0 - np.exp(-2.0 * np.pi * corner * T_s)
    filtered = np.zeros(len(raw))
    for k in range(1, len(raw)):
        filtered[k] = filtered[k - 1] + share * (raw[k] - filtered[k - 1])
    # rounding
    np.testing.assert_allclose(rows["F_z"], filtered, rtol=0, atol=1e-12)


def test_the_depth_of_the_force_is_known_though_the_filter_lags():
    rows = carried_out([TAP], 5.0, World("velocity"), law=LAW._replace(corner=5.0))
    top = rows["p_ref_B"][next(k for _, kind, k in phases_of(rows) if kind == Kind.TAP), 2]
    depth = FLOOR - TAP.force / STIFFNESS
    # a call's worth of gentle descent; without the correction it would be 0.3 mm deeper, 10 mm/s for 1/(2 pi 5 Hz)
    assert top - TAP.lift == pytest.approx(depth, abs=APPROACH.descent * T_s)


def test_a_second_press_begins_as_the_first_did_whatever_the_force_loop_did_before():
    """With a derivative gain, what is left of the first press would be a kick."""
    rows = carried_out([PRESS, PRESS], 20.0, force=FORCE_GAINS._replace(kd=2e-6, derivative_corner=5.0))
    first, second = (k for _, kind, k in phases_of(rows) if kind == Kind.BUILD_UP)
    # no low-pass, no derivative yet: rounding of the two ways down to the floor
    np.testing.assert_allclose(rows["dp_z"][second], rows["dp_z"][first], rtol=0, atol=1e-12)


def test_the_rate_of_the_force_is_low_passed_as_the_force_is():
    """A force that grows evenly from one call on: its rate rises to that as a first-order lag."""
    component, slope, n = task_controller([PRESS]), 40.0, 25
    controller, share = ComponentStepper(component), low_pass_share(LAW.corner, T_s)
    estimates = np.concatenate([*PRESS.point, APPROACH.height], axis=None)
    estimates = np.concatenate([estimates, J_HOME, np.zeros(6)])
    rate, F_z = 0.0, 0.0
    for k in range(n):
        estimates[14] = -slope * k * T_s
        controller(estimates, k * T_s, T_s)
        before, F_z = F_z, F_z + share * (slope * k * T_s - F_z)
        rate += share * ((F_z - before) / T_s - rate)
    # the same sums in the same order
    assert component.memory["F_rate"][0] == pytest.approx(rate, rel=1e-12)
    assert 0.5 * slope < rate < slope


@pytest.mark.parametrize(("off", "moved"), [((0.0, 0.0, 1e-3), True), ((1e-3, 1e-3, -1e-3), False)])
def test_what_a_tank_holds_back_moves_the_force_integral_by_the_error_in_z_alone(off, moved):
    def dp_z(share):
        """Of the call after one in which the platform was `off` its command (m), all of it passed on until then."""
        start = (*PRESS.point, APPROACH.height)
        phases = program(APPROACH, CONTACT, [PRESS])
        controller = ComponentStepper(
            TaskController(LAW, Gains(0.0), FORCE_GAINS, FORWARD, UNDAMPED, TOUCH, phases, start, tank=True)
        )
        p, pressed = np.array(start), 0
        for k in range(3000):
            F_z = STIFFNESS * max(0.0, FLOOR - p[2])
            at = p + off if pressed == 1 else p
            estimates = np.concatenate([at, J_HOME, [0.0, 0.0, -F_z], np.zeros(3), [share if pressed == 2 else 1.0]])
            outputs = controller(estimates, k * T_s, T_s).copy()
            if pressed == 2:
                return outputs[9]
            pressed += bool(outputs[10])
            p = outputs[6:9]
        raise AssertionError("it never pressed")

    # held back, the head is not pushed down as far
    assert dp_z(0.5) > dp_z(1.0) if moved else dp_z(0.5) == dp_z(1.0)
