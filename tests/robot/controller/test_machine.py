"""The machine of phases on a soft floor: what comes when, what ends it, and that references do not jump."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.conftest import examples
from tests.robot.controller.soft_floor import (
    APPROACH,
    CONTACT,
    FLOOR,
    FORCE_GAINS,
    LAW,
    PRESS,
    PUSH,
    ROLL,
    STIFFNESS,
    TAP,
    TOUCH,
    T_s,
    World,
    carried_out,
    phases_of,
)
from twin.robot.controller.program import PhaseKind as Kind
from twin.robot.controller.program import Press, Push, Roll, Tap

WITH_DRIVES = World(follows="velocity")
SHORT_OF_END = 1.5 * T_s
"""A phase is followed by the next at the call nearest to its end, which starts from the reference of the call before:
it stays short of its own end by what the reference does in this time (s)."""
RAMP_END = (SHORT_OF_END / APPROACH.ramp) ** 3 * APPROACH.ramp
"""How far a reference of 1 m/s goes at the end of its ramp in that time (m)."""
points = st.tuples(*[st.floats(-0.01, 0.01)] * 2)
forces = st.floats(1.0, 8.0)
short = st.floats(0.1, 0.5)
any_task = st.one_of(
    st.builds(Press.model_construct, point=points, force=forces, build_up=short, hold=short),
    st.builds(
        Tap.model_construct,
        point=points,
        force=forces,
        speed=st.floats(0.02, 0.1),
        lift=st.floats(0.003, 0.008),
        period=st.floats(0.2, 0.5),
        times=st.just(2),
    ),
    st.builds(
        Roll.model_construct,
        point=points,
        force=forces,
        build_up=short,
        radius=st.floats(0.001, 0.005),
        rate=st.floats(2.0, 4.0),
        turns=st.just(1.0),
    ),
    st.builds(Push.model_construct, point=points, force=forces, build_up=short, to=points, speed=st.floats(0.01, 0.05)),
)


def kinds(rows, task=1):
    return [kind for number, kind, _ in phases_of(rows) if number == task]


def call_of(rows, kind, nth=0, task=1):
    """Call at which the `nth` phase of that kind begins."""
    return [first for number, found, first in phases_of(rows) if (number, found) == (task, kind)][nth]


@examples(15)
@given(st.lists(any_task, min_size=1, max_size=3), st.floats(0.0, 0.2), st.booleans())
def test_no_sequence_of_tasks_makes_the_command_jump(tasks, noise, floor_goes):
    world = World(noise=noise, gone=(3.0, 3.6) if floor_goes else (0.0, 0.0))
    rows = carried_out(tasks, 8.0, world)
    fastest = max(APPROACH.speed, *(t.speed for t in tasks if isinstance(t, Tap | Push)), 0.0)
    fastest = max(fastest, *(2.0 * np.pi * t.rate * t.radius for t in tasks if isinstance(t, Roll)), 0.0)
    step = np.linalg.norm(np.diff(rows["p_cmd_B"], axis=0), axis=1)
    # what the force loop adds while it acts: its gains on what force and reference do; none where it starts or ends
    on = rows["triggered"] > 0.5
    e = (rows["F_z_ref"] - rows["F_z"]) * on
    both = on[1:] & on[:-1]
    loop = both * FORCE_GAINS.kp * np.abs(np.diff(e)) + on[1:] * FORCE_GAINS.ki * T_s * np.abs(e[1:])
    # rounding
    assert np.all(step <= fastest * T_s + loop + 1e-12)


def test_a_press_goes_through_the_phases_in_the_order_of_the_paper():
    rows = carried_out([PRESS], 8.0)
    assert kinds(rows) == [Kind.DESCEND, Kind.BUILD_UP, Kind.HOLD, Kind.RELEASE, Kind.RETRACT, Kind.DONE]
    # the durations of the task, to the call: sums of T_s may round up
    began = {kind: first for _, kind, first in phases_of(rows)}
    assert (began[Kind.HOLD] - began[Kind.BUILD_UP]) * T_s == pytest.approx(PRESS.build_up, abs=1e-9)
    assert (began[Kind.RELEASE] - began[Kind.HOLD]) * T_s == pytest.approx(PRESS.hold, abs=1e-9)
    assert (began[Kind.RETRACT] - began[Kind.RELEASE]) * T_s == pytest.approx(APPROACH.release, abs=1e-9)


def test_a_roll_circles_and_a_push_goes_to_its_end_while_pressing():
    rows = carried_out([ROLL, PUSH], 18.0)
    assert Kind.CIRCLE in kinds(rows, 1)
    start, end = call_of(rows, Kind.CIRCLE), call_of(rows, Kind.RELEASE)
    assert (end - start) * T_s == pytest.approx((ROLL.turns + 2.0) / ROLL.rate, abs=1e-9)
    spiral_end = 3.0 * (SHORT_OF_END * ROLL.rate) ** 2 * ROLL.radius
    np.testing.assert_allclose(rows["p_ref_B"][end, :2], ROLL.point, rtol=0, atol=spiral_end)
    start, end = call_of(rows, Kind.PUSH, task=2), call_of(rows, Kind.RELEASE, task=2)
    np.testing.assert_allclose(rows["p_ref_B"][start, :2], PUSH.point, rtol=0, atol=APPROACH.speed * RAMP_END)
    np.testing.assert_allclose(rows["p_ref_B"][end, :2], PUSH.to, rtol=0, atol=PUSH.speed * RAMP_END)
    # it still presses with the force of the task: the loop's own error
    np.testing.assert_allclose(rows["F_z"][end - 1], PUSH.force, rtol=0.01)


def test_the_next_task_travels_at_the_height_above_all_points():
    rows = carried_out([PRESS, PUSH], 9.0)
    travelling = (rows["task"] == 2) & (rows["phase"] == Kind.TRAVEL)
    assert travelling.any()
    atol = APPROACH.speed * RAMP_END
    np.testing.assert_allclose(rows["p_ref_B"][travelling, 2], APPROACH.height, rtol=0, atol=atol)


def test_descent_ends_at_the_first_call_that_feels_contact():
    rows = carried_out([PRESS], 3.0)
    began = call_of(rows, Kind.BUILD_UP)
    assert rows["F_z"][began] >= CONTACT > rows["F_z"][began - 1]


def test_nothing_felt_down_to_the_floor_leads_back_up():
    rows = carried_out([PRESS], 6.0, World(gone=(0.0, 10.0)))
    assert kinds(rows) == [Kind.DESCEND, Kind.RETRACT, Kind.DONE]
    lowest = rows["p_ref_B"][:, 2].min()
    assert APPROACH.floor <= lowest <= APPROACH.floor + APPROACH.descent * SHORT_OF_END
    assert rows["p_ref_B"][-1, 2] == pytest.approx(APPROACH.height, abs=APPROACH.speed * RAMP_END)
    assert not rows["triggered"].any()


@pytest.mark.parametrize("task", [PRESS, TAP], ids=["press", "tap"])
def test_after_a_task_without_contact_the_next_one_is_tried(task):
    rows = carried_out([task, PRESS], 12.0, World(gone=(0.0, 4.5)))
    assert kinds(rows, 1)[-1] == Kind.RETRACT
    assert Kind.HOLD in kinds(rows, 2)


def test_contact_may_be_lost_for_less_than_the_patience():
    rows = carried_out([PRESS], 8.0, World(gone=(2.5, 2.5 + TOUCH.patience - 0.01)))
    assert Kind.RELEASE in kinds(rows)


def test_contact_lost_for_longer_than_the_patience_ends_the_task_then_and_not_before():
    rows = carried_out([PRESS], 8.0, World(gone=(2.5, 5.0)))
    assert kinds(rows) == [Kind.DESCEND, Kind.BUILD_UP, Kind.HOLD, Kind.RETRACT, Kind.DONE]
    waited = call_of(rows, Kind.RETRACT) * T_s - 2.5
    # the first call without contact counts as a whole period, and so may the rounding of their sum
    assert TOUCH.patience - 1.5 * T_s <= waited <= TOUCH.patience + 0.5 * T_s


def test_letting_go_is_not_losing_contact():
    rows = carried_out([PRESS], 8.0, World(gone=(4.5, 8.0)))
    released = call_of(rows, Kind.RETRACT) - call_of(rows, Kind.RELEASE)
    assert released * T_s == pytest.approx(APPROACH.release, abs=1e-9)


def test_force_reference_starts_at_the_force_that_is_there_and_rises_steadily():
    rows = carried_out([PRESS], 8.0)
    building = rows["phase"] == Kind.BUILD_UP
    F_ref = rows["F_z_ref"][building]
    assert F_ref[0] == rows["F_z"][building][0]
    assert np.all(np.diff(F_ref) >= 0.0)
    # 3 x^2 - 2 x^3 is nowhere steeper than 3/2
    assert np.diff(F_ref).max() <= 1.5 * (PRESS.force - F_ref[0]) / PRESS.build_up * T_s * (1.0 + 1e-9)
    left = 3.0 * (SHORT_OF_END / PRESS.build_up) ** 2 * PRESS.force
    assert rows["F_z_ref"][call_of(rows, Kind.HOLD)] == pytest.approx(PRESS.force, abs=left)
    assert rows["F_z_ref"][call_of(rows, Kind.RELEASE) - 1] == pytest.approx(PRESS.force, abs=1e-8)


def test_force_reference_never_jumps_while_the_robot_presses():
    rows = carried_out([PRESS, ROLL, PUSH], 26.0)
    on = rows["triggered"] > 0.5
    change = np.abs(np.diff(rows["F_z_ref"]))[on[1:] & on[:-1]]
    # the steepest is the release: 3/2 of its mean
    assert change.max() <= 1.5 * (PRESS.force - CONTACT) / APPROACH.release * T_s * (1.0 + 1e-9)


def test_every_press_starts_with_an_empty_force_loop():
    rows = carried_out([PRESS, PRESS], 16.0)
    starts = np.flatnonzero(np.diff(rows["triggered"]) > 0.5) + 1
    assert len(starts) == 2
    np.testing.assert_array_equal(rows["dp_z"][starts], 0.0)


def test_taps_are_as_many_and_as_far_apart_as_the_task_says():
    rows = carried_out([TAP], 8.0, WITH_DRIVES)
    taps = [first for _, kind, first in phases_of(rows) if kind == Kind.TAP]
    assert len(taps) == TAP.times
    # to the call
    np.testing.assert_array_equal(np.diff(taps), round(TAP.period / T_s))
    assert kinds(rows)[:5] == [Kind.DESCEND, Kind.PROBE, Kind.RETRACT, Kind.TAP, Kind.RISE]
    assert kinds(rows)[-3:] == [Kind.WAIT, Kind.RETRACT, Kind.DONE]


def test_a_series_of_taps_that_was_cut_short_takes_nothing_from_the_next():
    whole = carried_out([TAP, TAP], 14.0, WITH_DRIVES)
    third = call_of(whole, Kind.TAP, 2) * T_s
    rows = carried_out([TAP, TAP], 14.0, World("velocity", stuck=(third, third + 1.5)))
    assert kinds(rows, 1).count(Kind.TAP) == 3
    taps = [number for number, kind, _ in phases_of(rows) if kind == Kind.TAP]
    assert taps.count(2) == TAP.times


def turn_of(rows, nth):
    """Height at which a tap turns: z goes down a straight line before it and up one after it, which meet there."""
    rise = call_of(rows, Kind.RISE, nth)
    down = rows["z"][rise] + TAP.speed * rows["t"][rise]
    up = rows["z"][rise + 2] - TAP.speed * rows["t"][rise + 2]
    return (down + up) / 2.0


def test_a_tap_turns_between_two_calls_right_at_the_depth_of_the_force():
    rows = carried_out([TAP], 8.0, WITH_DRIVES)
    depth = rows["z"][call_of(rows, Kind.RETRACT)]
    for nth in range(TAP.times):
        # rounding; a turn at a call would be off by up to T_s times the speed, 2e-4 m
        assert turn_of(rows, nth) == pytest.approx(depth, abs=1e-12)


def test_while_a_tap_turns_between_two_calls_its_command_is_held():
    rows = carried_out([TAP], 8.0, WITH_DRIVES)
    for nth in range(TAP.times):
        rise = call_of(rows, Kind.RISE, nth)
        assert rows["p_ref_B"][rise].tolist() == rows["p_ref_B"][rise - 1].tolist()


@pytest.mark.parametrize("by", [-0.13e-3, 0.05e-3, 0.31e-3])
def test_taps_turn_as_much_higher_as_the_surface_is(by):
    """No multiple of the 0.2 mm that a tap goes down from call to call."""
    # so high that it is at its speed where it touches
    tap = TAP.model_copy(update={"lift": 0.012, "period": 0.6})
    still = carried_out([tap], 8.0, WITH_DRIVES)
    after = call_of(still, Kind.WAIT, 1)
    moved = carried_out([tap], 8.0, WITH_DRIVES._replace(lifted=(after * T_s, by)))
    # rounding
    assert turn_of(moved, 3) - turn_of(still, 3) == pytest.approx(by, abs=1e-9)


def test_a_tap_rises_as_far_above_the_depth_as_the_task_says():
    rows = carried_out([TAP], 8.0, WITH_DRIVES)
    depth = rows["z"][call_of(rows, Kind.RETRACT)]
    top = rows["p_ref_B"][call_of(rows, Kind.WAIT), 2]
    assert top == pytest.approx(depth + TAP.lift, abs=TAP.speed * RAMP_END)
    # a call's worth of gentle descent deeper than where the force was reached exactly
    assert depth == pytest.approx(FLOOR - TAP.force / STIFFNESS, abs=APPROACH.descent * T_s)


@pytest.mark.parametrize("learning", [0.0, 0.3, 1.0])
def test_each_tap_corrects_its_share_of_the_depth_error_of_the_one_before(learning):
    late = 5
    rows = carried_out([TAP], 8.0, World("velocity", late), touch=TOUCH.model_copy(update={"learning": learning}))
    # late calls' worth of going on, of which the probe has its own
    depth = rows["z"][call_of(rows, Kind.RETRACT)]
    lowest = []
    for nth in range(TAP.times):
        tap = call_of(rows, Kind.TAP, nth)
        lowest.append(rows["z"][tap : tap + round(TAP.period / T_s)].min())
    error = depth - np.array(lowest)
    one_call = T_s * TAP.speed
    assert error[0] == pytest.approx(late * one_call, abs=one_call)
    # what z did between two calls is not seen
    np.testing.assert_allclose(error[1:], (1.0 - learning) * error[:-1], rtol=0, atol=one_call)
    assert learning < 1.0 or np.all(np.abs(error[1:]) < one_call)


def test_the_correction_stays_within_its_limit_and_the_reference_on_its_way():
    rows = carried_out([PRESS], 8.0)
    assert np.abs(rows["dp_z"]).max() <= LAW.dp_z_max
    np.testing.assert_array_equal(rows["p_cmd_B"][:, 2], rows["p_ref_B"][:, 2] + rows["dp_z"])
