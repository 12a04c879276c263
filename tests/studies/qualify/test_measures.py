"""Measures of made-up curves whose answers are known."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from twin.studies.qualify.bench import Response
from twin.studies.qualify.definitions import COMMAND_TIME, TICK, Check, work_cycle
from twin.studies.qualify.motion import (
    MAX_LOAD,
    STALL_UNCERTAINTY,
    bandwidth,
    held_torque,
    ramped_torque,
    repetition_findings,
    stall_torque,
    step_findings,
)
from twin.studies.qualify.qualification import Qualification


def turning(omega_m: np.ndarray, tau_load: np.ndarray | None = None) -> Response:
    """What the bench would have recorded of a shaft at these speeds."""
    zero = np.zeros(len(omega_m))
    theta_m = np.concatenate([[0.0], np.cumsum(omega_m[:-1]) * TICK])
    load = zero if tau_load is None else tau_load
    return Response(TICK * np.arange(len(omega_m), dtype=float), zero, load, theta_m, omega_m, 0.0)


def measured(omega_m: np.ndarray) -> dict[str, float | None]:
    return {
        finding.name: finding.value for finding in step_findings(turning(omega_m)) if not isinstance(finding, Check)
    }


@given(st.floats(0.5, 100.0))
def test_the_bandwidth_of_a_first_order_gain_is_its_corner(corner: float):
    f = np.geomspace(0.25, 200.0, 60)
    # 1 %: a straight line over a sixth of an octave, and the gain at 0.25 Hz is not quite 1
    low = 1.0 / np.sqrt(1.0 + (0.25 / corner) ** 2)
    expected = corner * np.sqrt(2.0 / low**2 - 1.0)
    assert bandwidth(f, 1.0 / np.sqrt(1.0 + (f / corner) ** 2), 1.0).value == pytest.approx(expected, rel=0.01)


def test_a_drive_slower_than_the_slowest_sine_has_no_bandwidth_to_be_measured():
    f = np.geomspace(0.25, 200.0, 20)
    assert bandwidth(f, 0.5 / f * f[0], 1.0).value is None


@given(st.floats(0.07, 0.5))
def test_overshoot_is_that_of_the_peak(share: float):
    omega_m = work_cycle()[0].copy()
    omega_m[250:260] *= 1.0 + share
    # rounding of a fitted mean
    assert measured(omega_m)["overshoot"] == pytest.approx(100.0 * share, rel=1e-6)


def test_ripple_beyond_the_band_hides_settling_and_overshoot_but_not_the_rise():
    omega_m = work_cycle()[0] * (1.0 + 0.06 * np.sin(2.0 * np.pi * 10.0 * TICK * np.arange(len(work_cycle()[0]))))
    found = measured(omega_m)
    assert found["settling_time"] is None and found["overshoot"] is None
    assert found["rise_time"] == pytest.approx(0.0, abs=TICK)
    # 6 % of 0.5 rad/s; the mean over ten whole periods is exact but for the fit's ends
    assert found["ripple"] == pytest.approx(0.03, rel=0.01)


def test_ripple_within_the_band_is_no_overshoot():
    omega_m = work_cycle()[0] * (1.0 + 0.03 * np.sin(2.0 * np.pi * 10.0 * TICK * np.arange(len(work_cycle()[0]))))
    assert measured(omega_m)["overshoot"] == 0.0


@given(st.floats(0.05, 3.5))
def test_a_growing_load_finds_the_one_at_which_the_shaft_stops(limit: float):
    tau_load = 0.25 * TICK * np.arange(round((limit + 0.2) / 0.25 / TICK))
    # half of the averaging window of 0.05 s at 0.25 N m/s
    assert ramped_torque(turning(np.where(tau_load < limit, 0.5, 0.0), tau_load)) == pytest.approx(limit, abs=0.0065)


@given(st.floats(0.02, 3.9), st.floats(0.5, 3.0))
@example(3.875, 0.5)
@example(1.5, 2.720703125)
def test_held_loads_find_the_stall_torque_whatever_a_growing_one_said(limit: float, wrong: float):
    # half of what lies between a load that is carried and one that is not, of which the latter is larger by as much
    close = max(STALL_UNCERTAINTY * limit / (1.0 - 2.0 * STALL_UNCERTAINTY), 0.5 * 0.0125)
    assert held_torque(wrong * limit, lambda load: load < limit) == pytest.approx(limit, abs=1.001 * close)


def test_loads_that_are_all_carried_have_no_stall_torque():
    assert held_torque(1.0, lambda load: True) == MAX_LOAD


def test_a_shaft_that_never_stops_has_no_stall_torque(done: Callable[[str], Qualification]):
    tau_load = 0.25 * TICK * np.arange(16_000)
    assert stall_torque(done("ideal_velocity").plan, turning(np.full(16_000, 0.5), tau_load)).value is None


def test_a_difference_of_one_bit_is_no_repetition(done: Callable[[str], Qualification]):
    servo = done("velocity_servo")
    cycle = servo.curves.cycle
    assert cycle is not None
    theta_m = cycle.theta_m.copy()
    theta_m[3000] = np.nextafter(theta_m[3000], 1.0)
    repeats = repetition_findings(servo.plan, replace(cycle, theta_m=theta_m))[0]
    assert isinstance(repeats, Check)
    assert repeats.verdict == "FAIL" and "t = 3 s" in repeats.detail


def test_the_command_steps_where_the_step_is_looked_at():
    omega_ref, tau_load = work_cycle()
    first = round(COMMAND_TIME / TICK)
    assert omega_ref[first - 1] == 0.0 and omega_ref[first] == 0.5
    assert np.all(tau_load[: 2 * first] == 0.0) and tau_load[-1] == 0.1
