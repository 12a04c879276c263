import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.laws.runs import FORCE, POSITION, ComponentStepper, shipped
from tests.robot.plant.states import positions
from twin.robot.assembly.build import belief, controller
from twin.robot.controller.controller import (
    Controller,
    Law,
    WayPointReference,
    reference_position,
    unwind_integral,
)
from twin.robot.controller.pid import PID_RECORD, Gains, loop_record, proposal
from twin.robot.mechanism.geometry import Geometry
from twin.robot.mechanism.kinematics import jacobian

T_s = 2e-3
GEOMETRY = Geometry(*belief(shipped())[:4])
POINT = (0.0, 0.0, -0.105)
J_HOME = jacobian(GEOMETRY, POINT).ravel()
LAW = Law(N=2.0, omega_max=8.0, F_z_ref=5.0, trigger_force=0.6, trigger_time=math.inf, dp_z_max=0.015, corner=0.0)
KP, FORCE_GAINS = 1.5, Gains(2e-3, 5e-4)


def law_of(law=LAW, position=KP, force=FORCE_GAINS):
    return ComponentStepper(Controller(law, Gains(position), force, [0.0], [POINT]))


def estimates(F_z, p_B=POINT, J=J_HOME):
    return np.concatenate([p_B, J, [0.0, 0.0, -F_z]])


def pressed(law, forces):
    """Outputs by port over ticks with the estimated pressing force `forces` (N), the platform at home."""
    ticks = [law.named(estimates(F_z), k * T_s, T_s) for k, F_z in enumerate(forces)]
    return {name: np.array([tick[name] for tick in ticks]).squeeze() for name in ticks[0]}


@given(positions())
def test_position_loop_turns_the_cartesian_error_into_motor_speeds(p_B):
    J = jacobian(GEOMETRY, p_B)
    found = law_of().named(estimates(0.0, p_B, J.ravel()))["omega_ref"]
    # rounding of speeds below 8 rad/s
    np.testing.assert_allclose(found, 2.0 * J @ (KP * (POINT - p_B)), rtol=0, atol=1e-13)


@given(positions(), st.floats(0.0, 100.0))
def test_commanded_speeds_and_correction_stay_within_their_limits(p_B, F_z):
    law = law_of(position=1000.0, force=Gains(1.0, 1.0, 0.1))
    for k in range(5):
        found = law.named(estimates(F_z, p_B, jacobian(GEOMETRY, p_B).ravel()), k * T_s, T_s)
        assert np.abs(found["omega_ref"]).max() <= LAW.omega_max
        assert abs(found["dp_z"][0]) <= LAW.dp_z_max


def test_position_integral_stops_while_a_speed_is_limited():
    law = ComponentStepper(Controller(LAW._replace(omega_max=0.1), Gains(1.5, 50.0), FORCE_GAINS, [0.0], [POINT]))
    away = np.add(POINT, [0.0, 0.0, 0.01])
    for k in range(1000):
        law.outputs_by_port(estimates(0.0, away), k * T_s, T_s)
    # without an error only the integral is left, and it took up nothing
    np.testing.assert_array_equal(law.outputs_by_port(estimates(0.0), 2.0, T_s)["omega_ref"], 0.0)


def test_a_pull_triggers_nothing_however_hard():
    # the paper: 'not triggered since the pressing force is smaller than the set triggered threshold of 0.6N'
    found = pressed(law_of(), [0.0, -0.59, -0.61, -50.0, 0.59])
    assert not found["triggered"].any() and not found["dp_z"].any()


def test_law_acts_in_the_very_tick_in_which_the_force_triggers_it():
    found = pressed(law_of(), [0.0, 0.59, 0.61, 0.0])
    np.testing.assert_array_equal(found["triggered"], [0, 0, 1, 1])
    np.testing.assert_array_equal(found["dp_z"][:2], 0.0)
    e = LAW.F_z_ref - 0.61
    # the integral includes the newest sample; rounding
    expected = -(FORCE_GAINS.kp * e + FORCE_GAINS.ki * e * T_s)
    assert found["dp_z"][2] == pytest.approx(expected, rel=1e-12)
    assert found["p_cmd_B"][2] == pytest.approx(np.add(POINT, [0.0, 0.0, expected]), rel=1e-12)


TOO_DEEP, RATE = -1e-3, 2.0 * FORCE_GAINS.ki / FORCE_GAINS.kp
"""How far below the platform the position loop was told to go (m); how fast the integral gives in (1/s)."""


def passed(gains=FORCE_GAINS, z=TOO_DEEP, share=0.0, error=1.0):
    """What the force loop's integral (m) is moved by where `share` of a command got through."""
    pid = np.array([loop_record(gains)], dtype=PID_RECORD)[0]
    proposal(pid, error, T_s)
    unwind_integral(pid, z, share, T_s)
    return pid["integral"]


@pytest.mark.parametrize(("gains", "share", "expected"), [
    (FORCE_GAINS, 0.0, RATE * T_s * TOO_DEEP), (FORCE_GAINS, 0.75, 0.25 * RATE * T_s * TOO_DEEP),
    (FORCE_GAINS, 1.0, 0.0), (Gains(0.0, 5e-4), 0.0, TOO_DEEP), (Gains(2e-3, 0.0), 0.0, 0.0),
])  # fmt: skip
def test_the_integral_goes_back_to_where_what_got_through_leads_in_half_of_its_own_time(gains, share, expected):
    assert passed(gains, share=share) == pytest.approx(expected, rel=1e-12)


def test_a_way_back_is_not_held_back_and_a_loop_at_rest_stays_so():
    assert passed(z=-TOO_DEEP) == 0.0
    resting = np.array([loop_record(FORCE_GAINS)], dtype=PID_RECORD)[0]
    unwind_integral(resting, TOO_DEEP, 0.0, T_s)
    assert resting["integral"] == 0.0


def behind_a_tank(share, ticks):
    """Correction (m) after `ticks` of 2 N too little, the platform held at home, `share` of each command passed on."""
    law = Controller(LAW._replace(trigger_time=0.0), Gains(KP), FORCE_GAINS, [0.0], [POINT], tank=True)
    stepped = ComponentStepper(law)
    for k in range(ticks):
        found = stepped.outputs_by_port(np.append(estimates(LAW.F_z_ref - 2.0), share), k * T_s, T_s)
    return found["dp_z"][0]


def test_behind_a_tank_that_lets_nothing_pass_the_law_asks_for_half_of_what_its_gain_makes_of_the_force():
    # ki of the error comes in, and as much of the depth goes out where that is half of kp times the error
    assert behind_a_tank(0.0, 20000) == pytest.approx(-0.5 * FORCE_GAINS.kp * 2.0, rel=1e-2)
    assert behind_a_tank(1.0, 2000) == pytest.approx(-(FORCE_GAINS.kp + FORCE_GAINS.ki * 2000 * T_s) * 2.0, rel=1e-9)


def test_trigger_stays_when_the_force_goes():
    found = pressed(law_of(), [0.0, 1.0, *np.zeros(50)])
    assert found["triggered"][1:].all()


def test_force_at_the_threshold_does_not_trigger():
    assert not pressed(law_of(), [0.6])["triggered"].any()


def test_schedule_triggers_at_its_tick_whatever_the_force():
    law = law_of(LAW._replace(trigger_force=math.inf, trigger_time=5 * T_s))
    found = pressed(law, np.full(10, 100.0))
    np.testing.assert_array_equal(found["triggered"], [0] * 5 + [1] * 5)


def test_position_mode_is_never_triggered():
    overrides = ("controller.force.trigger_time_s=0.0", "controller.force.trigger_N=0.0")
    found = pressed(ComponentStepper(controller(shipped(POSITION, *overrides))), np.full(100, 50.0))
    assert not found["triggered"].any()
    np.testing.assert_array_equal(found["dp_z"], 0.0)


def test_force_mode_is_triggered_by_the_threshold_of_the_file():
    found = pressed(ComponentStepper(controller(shipped(FORCE, "controller.force.filter_Hz=0"))), [0.5, 0.7])
    np.testing.assert_array_equal(found["triggered"], [0, 1])


def test_force_filter_answers_a_step_as_a_first_order_lag():
    found = pressed(law_of(LAW._replace(corner=10.0, trigger_force=math.inf)), np.full(60, 4.0))
    # the exact lag, the step having lasted one period at the first sample; rounding
    expected = 4.0 * (1.0 - np.exp(-2.0 * np.pi * 10.0 * T_s * np.arange(1, 61)))
    np.testing.assert_allclose(found["F_z"], expected, rtol=1e-12)


def test_correction_is_the_negative_pid_of_the_force_error():
    forces = np.concatenate([[0.7], 5.0 + np.sin(np.arange(40.0))])
    found = pressed(law_of(force=Gains(2e-3, 5e-3, 1e-6)), forces)
    e = LAW.F_z_ref - forces
    rate = np.concatenate([[0.0], np.diff(e)]) / T_s
    # rounding of millimetres
    expected = -(2e-3 * e + 5e-3 * T_s * np.cumsum(e) + 1e-6 * rate)
    np.testing.assert_allclose(found["dp_z"], expected, rtol=0, atol=1e-15)


def test_force_integral_does_not_wind_up_at_the_limit():
    law = law_of(force=Gains(5e-3, 0.05))
    held = pressed(law, np.concatenate([[0.7], np.full(5000, -1.0)]))
    np.testing.assert_array_equal(held["dp_z"][1:], -LAW.dp_z_max)
    # what the integral holds after ten seconds at the limit, seen at zero error: nothing
    released = pressed(law, [LAW.F_z_ref])
    assert released["dp_z"] == pytest.approx(0.0, abs=1e-15)


def test_reference_is_handed_on_with_and_without_correction():
    found = pressed(law_of(), [0.0, 1.0])
    np.testing.assert_array_equal(found["p_ref_B"], [POINT, POINT])
    np.testing.assert_array_equal(found["p_cmd_B"][0], POINT)
    # rounding
    assert found["p_cmd_B"][1, 2] - found["p_ref_B"][1, 2] == pytest.approx(found["dp_z"][1], rel=1e-12)
    np.testing.assert_array_equal(found["F_z_ref"], LAW.F_z_ref)


coordinates = st.floats(-0.2, 0.2)


@st.composite
def trajectories(draw):
    n = draw(st.integers(1, 6))
    gaps = [draw(st.floats(0.01, 5.0)) for _ in range(n)]
    points = [[draw(coordinates) for _ in range(3)] for _ in range(n)]
    return np.cumsum(gaps), np.array(points)


@given(trajectories(), st.lists(st.floats(0.0, 40.0), min_size=1, max_size=20))
def test_reference_is_the_straight_line_between_way_points(trajectory, times):
    t, p = trajectory
    segment = 0
    for now in sorted(times):
        x, y, z, segment = reference_position(t, p, segment, now)
        # rounding
        expected = [np.interp(now, t, p[:, i]) for i in range(3)]
        np.testing.assert_allclose((x, y, z), expected, rtol=0, atol=1e-15)


@given(trajectories(), st.floats(0.0, 40.0))
def test_searching_from_the_start_finds_the_same_point(trajectory, now):
    t, p = trajectory
    found = reference_position(t, p, 0, now)
    assert reference_position(t, p, found[3], now) == found


def test_before_its_first_way_point_the_reference_waits_there():
    reference = ComponentStepper(WayPointReference([1.0, 2.0], [[0.0, 0.0, -0.1], [0.0, 0.02, -0.11]]))
    found = [reference.outputs_by_port(np.zeros(0), t, T_s)["p_ref_B"][1] for t in (0.0, 0.5, 1.0, 1.5, 2.5)]
    assert found == pytest.approx([0.0, 0.0, 0.0, 0.01, 0.02])


@given(trajectories())
def test_reference_goes_through_its_way_points_and_stays_at_the_last(trajectory):
    t, p = trajectory
    for time, point in zip(t, p, strict=True):
        assert reference_position(t, p, 0, time)[:3] == tuple(point)
    assert reference_position(t, p, 0, t[-1] + 100.0)[:3] == tuple(p[-1])
    assert reference_position(t, p, 0, 0.0)[:3] == tuple(p[0])
