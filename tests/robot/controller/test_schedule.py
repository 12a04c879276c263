"""Gains over the stiffness: between the points, without bumps, no faster than told, and safe where nothing is known."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twin.robot.controller.pid import PID_RECORD, Gains, loop_record, proposal
from twin.robot.controller.schedule import (
    SCHEDULE_RECORD,
    SchedulePoint,
    follow_reference,
    gains_at,
    schedule_gains,
    schedule_table,
)
from twin.robot.controller.tissue import TISSUE_RECORD

T_s = 2e-3
POINTS = [SchedulePoint(300.0, 4e-3, 8e-2), SchedulePoint(800.0, 3e-3, 4e-2), SchedulePoint(2000.0, 1e-3, 1e-2)]
TABLE = schedule_table(POINTS)
SAFE = Gains(5e-4, 5e-3)


def parts(k=300.0, std=10.0, known=1, rate=2.0, follow=1.0):
    schedule, tissue = np.zeros(1, dtype=SCHEDULE_RECORD)[0], np.zeros(1, dtype=TISSUE_RECORD)[0]
    settings = {"tolerance": 0.3, "rate": rate, "follow": follow, "kp": SAFE.kp, "ki": SAFE.ki, "count": len(TABLE)}
    for name, value in settings.items():
        schedule[name] = value
    tissue["known"], tissue["k"], tissue["std"], tissue["pressing"] = known, k, std, 1
    return schedule, tissue, np.array([loop_record(SAFE)], dtype=PID_RECORD)[0]


def called(schedule, tissue, pid, calls):
    """(kp, ki) after each of so many calls."""
    told = []
    for _ in range(calls):
        schedule_gains(schedule, TABLE.ctypes.data, tissue, pid, T_s)
        told.append((float(pid["kp"]), float(pid["ki"])))
    return np.array(told)


@given(st.floats(1.0, 1e5), st.integers(0, 1))
def test_gains_lie_between_those_of_the_neighbours_and_fall_with_the_stiffness(k, segment):
    kp, ki, found = gains_at(TABLE, segment, k)
    assert (kp, ki) == gains_at(TABLE, 1 - segment, k)[:2]
    low, high = POINTS[found], POINTS[found + 1]
    # rounding
    assert high.kp * (1 - 1e-12) <= kp <= low.kp * (1 + 1e-12) and high.ki * (1 - 1e-12) <= ki <= low.ki * (1 + 1e-12)
    stiffer = gains_at(TABLE, 0, 1.1 * k)
    assert stiffer[0] <= kp * (1 + 1e-12) and stiffer[1] <= ki * (1 + 1e-12)


@pytest.mark.parametrize("point", POINTS)
def test_at_a_point_the_gains_are_its_own(point):
    assert gains_at(TABLE, 0, point.stiffness)[:2] == pytest.approx((point.kp, point.ki), rel=1e-12)


def test_half_way_one_over_the_gain_is_the_mean():
    # 1/kp of the neighbours: 250 and 333.3
    assert gains_at(TABLE, 0, 550.0)[0] == pytest.approx(2.0 / (1.0 / 4e-3 + 1.0 / 3e-3), rel=1e-12)


def test_gains_change_no_faster_than_the_rate_and_arrive():
    schedule, tissue, pid = parts(rate=2.0)
    told = called(schedule, tissue, pid, 400)
    # the table's share goes from 0 to 1 in half a second
    steps = np.diff(told[:, 0], prepend=SAFE.kp)
    assert steps.max() == pytest.approx((POINTS[0].kp - SAFE.kp) * 2.0 * T_s, rel=1e-6)
    assert told[-1] == pytest.approx(POINTS[0][1:], rel=1e-9) and told[200] != pytest.approx(POINTS[0][1:], rel=1e-3)
    tissue["k"] = 2000.0
    told = called(schedule, tissue, pid, 1000)
    # from 300 to 2000 N/m by 0.4 % a call
    there = int(np.argmax(np.isclose(told[:, 0], POINTS[-1].kp, rtol=1e-9)))
    assert there == pytest.approx(np.log(2000.0 / 300.0) / np.log(1.0 + 2.0 * T_s), abs=2)


def test_a_change_of_the_gains_does_not_move_the_output():
    schedule, tissue, pid = parts()
    error = 0.7
    for _ in range(300):
        before, pid["integral"] = proposal(pid, error, T_s)
        schedule_gains(schedule, TABLE.ctypes.data, tissue, pid, T_s)
        # the same error: all that is added is the integral of this call
        after, _ = proposal(pid, error, T_s)
        assert after - before == pytest.approx(float(pid["ki"]) * error * T_s, rel=1e-9, abs=1e-15)


@pytest.mark.parametrize("poor", [{"std": 150.0}, {"known": 0}])
def test_a_poor_estimate_leads_back_to_the_safe_set(poor):
    schedule, tissue, pid = parts()
    called(schedule, tissue, pid, 400)
    for name, value in poor.items():
        tissue[name] = value
    told = called(schedule, tissue, pid, 400)
    assert np.all(np.diff(told[:, 0]) <= 0.0) and tuple(told[-1]) == (SAFE.kp, SAFE.ki)
    # and not at once
    assert told[0, 0] > 0.9 * POINTS[0].kp


def test_an_estimate_that_does_not_fit_the_force_leads_back_to_the_safe_set_in_the_same_call():
    schedule, tissue, pid = parts()
    called(schedule, tissue, pid, 400)
    tissue["std"] = 300.0
    pid["error"] = 0.7
    output = pid["kp"] * pid["error"] + pid["integral"]
    assert tuple(called(schedule, tissue, pid, 1)[0]) == (SAFE.kp, SAFE.ki)
    # and no reference is fed forward through it
    assert schedule["share"] == 0.0
    assert pid["kp"] * pid["error"] + pid["integral"] == pytest.approx(output, rel=1e-12)


def test_in_the_air_the_safe_set_waits():
    schedule, tissue, pid = parts()
    called(schedule, tissue, pid, 400)
    tissue["pressing"] = 0
    assert tuple(called(schedule, tissue, pid, 1)[0]) == (SAFE.kp, SAFE.ki)


@pytest.mark.parametrize("follow", [0.0, 0.5, 1.0])
def test_a_change_of_the_reference_is_fed_forward_by_what_the_tissue_gives_way(follow):
    schedule, tissue, pid = parts(k=800.0, follow=follow)
    called(schedule, tissue, pid, 400)
    spring, rise = 2000.0, 0.01
    follow_reference(schedule, spring, pid, 3.0, True, T_s)
    before = float(pid["integral"])
    v = follow_reference(schedule, spring, pid, 3.0 + rise, True, T_s)
    # down, for more force
    assert v * T_s == pytest.approx(-follow * rise * (1.0 / 800.0 + 1.0 / spring), abs=1e-15)
    assert pid["integral"] - before == pytest.approx(follow * rise / 800.0, abs=1e-15)


def test_a_reference_that_begins_is_no_change():
    schedule, tissue, pid = parts()
    called(schedule, tissue, pid, 400)
    assert follow_reference(schedule, 2000.0, pid, 5.0, False, T_s) == 0.0
    assert follow_reference(schedule, 2000.0, pid, 5.0, True, T_s) == 0.0
