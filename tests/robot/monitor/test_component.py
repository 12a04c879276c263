"""The monitor at work on a sound robot: it changes no command, never trips, and says what is true."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.conftest import examples
from tests.laws.runs import ComponentStepper
from tests.robot.monitor.motions import BELIEF, DT, LIMITS, OMEGA_REF, SAMPLE, inputs, latched, ramp, standing, watched
from twin.kernel.cosim.port import width
from twin.robot.monitor.component import MONITOR_INPUTS, MONITOR_OUTPUTS, SafetyMonitor
from twin.robot.monitor.reasons import Reason


def swinging(share, frequency, stiffness):
    """Position and force (n, 3) of a massage: swings about a place while it presses in time with it, 1 s.

    Speed stays below 215 of 250 mm/s, force below 11 of 15 N, its growth below 185 of 300 N/s, depth below 21 of 25 mm.
    """
    t = np.arange(500) * DT
    omega = 2.0 * math.pi * frequency
    reach = np.minimum([0.02, 0.02, 0.005], 0.11 / omega)
    phase = share[:3] * math.pi
    p_B = np.array([0.0, 0.0, -0.1]) + reach * share[3:6] * np.sin(omega * t[:, None] + phase)
    F_z = 5.5 + min(5.0, 180.0 / omega, 0.1 * stiffness / omega) * share[6] * np.sin(omega * t)
    p_B[:, 2] -= F_z / stiffness
    # rubbing, 0.2 of the pressing force
    F_ee_B = np.stack([0.2 * share[7] * F_z, -0.1 * F_z, -F_z], axis=1)
    return p_B, F_ee_B


SHARES = st.tuples(*[st.floats(-1.0, 1.0)] * 8).map(np.array)


@examples(60)
@given(SHARES, st.floats(0.1, 5.0), st.floats(1000.0, 1e5))
def test_quantised_smooth_motion_within_the_limits_never_trips(share, frequency, stiffness):
    u = inputs(*swinging(share, frequency, stiffness))
    seen = watched(u)
    assert seen.trip is None, seen.trip
    np.testing.assert_array_equal(seen.outputs["omega_ref"], u[:, OMEGA_REF])
    assert seen.outputs["utilisation"].max() < 1.0


@given(st.lists(st.floats(-7.9, 7.9), min_size=3, max_size=3))
def test_a_command_passes_bit_for_bit(omega_ref):
    u = standing(1)[0]
    u[OMEGA_REF] = omega_ref
    found = ComponentStepper(SafetyMonitor(BELIEF, LIMITS))(u, 0.0, DT)
    # bytes: a minus zero is another command than a zero
    assert found[:3].tobytes() == np.array(omega_ref).tobytes()


ANYTHING = st.floats(allow_nan=True, allow_infinity=True)


@given(st.lists(st.tuples(st.integers(0, 9), ANYTHING), min_size=1, max_size=30))
def test_no_input_whatsoever_makes_an_output_that_is_not_finite(changes):
    u = inputs(ramp(len(changes) + 30, (0.0, 0.0, -0.1), (0.01, 0.0, -0.1)))
    for row, (column, value) in enumerate(changes, start=2):
        u[row, column] = value
    seen = watched(u)
    for name, values in seen.outputs.items():
        assert np.isfinite(values).all(), name


def test_messages_may_have_been_counted_before_the_monitor_begins():
    u = standing(60)
    u[:, SAMPLE] += 1000.0
    seen = watched(u)
    assert seen.trip is None, seen.trip
    np.testing.assert_array_equal(seen.outputs["utilisation"], watched(standing(60)).outputs["utilisation"])


def test_it_says_what_is_true_of_a_robot_that_presses():
    n, K = 1500, 2000.0
    F_z = np.clip(np.linspace(-2.0, 12.0, n), 0.0, 8.0)
    p_B = np.zeros((n, 3))
    p_B[:, 2] = -0.1 - F_z / K
    out = watched(inputs(p_B, np.stack([0.0 * F_z, 0.0 * F_z, -F_z], axis=1))).outputs
    # half a count on each encoder is worth 0.12 N
    assert out["F_z"][-1] == pytest.approx(8.0, abs=0.13)
    touched = int(np.argmax(out["contact_time"] > 0.0))
    # 1 N is felt 8 ms late at 4.7 N/s, and to 0.12 N
    assert F_z[touched] == pytest.approx(LIMITS.contact_force, abs=0.2)
    # two positions, each to half a joint count on every leg: 0.035 mm
    assert out["depth"][-1] == pytest.approx(p_B[touched, 2] - p_B[-1, 2], abs=7e-5)
    assert out["contact_time"][-1] == pytest.approx((n - touched) * DT, abs=1e-9)
    np.testing.assert_array_equal(out["power"], 1.0)


@pytest.mark.parametrize(("lowest", "ends"), [(0.75, False), (0.2, True)])
def test_a_contact_ends_at_half_the_force_at_which_it_began(lowest, ends):
    # down to `lowest` and up again to 1.5 N, in a second
    F_z = 1.5 - (1.5 - lowest) * np.sin(np.linspace(0.0, np.pi, 500)) ** 2
    p_B = np.tile((0.0, 0.0, -0.1), (500, 1))
    p_B[:, 2] -= F_z / 2000.0
    out = watched(inputs(p_B, np.stack([0.0 * F_z, 0.0 * F_z, -F_z], axis=1))).outputs
    # half a count is worth 0.12 N, less than what is left to 0.5 N
    assert (out["contact_time"].min() == 0.0) == ends


def test_speed_is_that_of_the_platform():
    out = watched(inputs(ramp(500, (-0.01, -0.02, -0.09), (0.01, 0.02, -0.11)))).outputs
    # 49 mm/s; a count on each joint per sample is worth 35 mm/s, a fifth of it behind the low-pass, and seldom falls
    # on all joints at once
    assert out["speed"][100:-1].mean() == pytest.approx(math.sqrt(0.02**2 + 0.04**2 + 0.02**2) / (499 * DT), rel=0.05)


def test_the_dead_zone_is_no_force():
    u = standing(50)
    blind = watched(u, belief=BELIEF._replace(backlash=0.0)).outputs["F_z"][-1]
    # the springs that carry the robot stand at one side of a dead zone of 0.1 deg; half a count is worth 0.12 N
    assert watched(u).outputs["F_z"][-1] == pytest.approx(0.0, abs=0.13)
    assert abs(blind) > 0.1


def test_a_monitor_that_looks_more_often_than_messages_come_sees_the_same():
    u = inputs(*swinging(np.full(8, 0.7), 2.0, 2000.0))
    slow, fast = SafetyMonitor(BELIEF, LIMITS, sample_interval=2, period=2), SafetyMonitor(BELIEF, LIMITS, 2, 1)
    slow_step, fast_step = ComponentStepper(slow), ComponentStepper(fast)
    for k in range(2 * len(u)):
        found = fast_step(u[k // 2], 1e-3 * k, 1e-3)
        if k % 2 == 0:
            expected = slow_step(u[k // 2], 1e-3 * k, 2e-3)
            # utilisation differs: between two messages the counter is older
            np.testing.assert_allclose(found[:10], expected[:10], rtol=1e-12, atol=0)
    assert fast.trip is None


def test_the_memory_of_a_run_names_tick_reason_value_and_limit():
    u = standing(80)
    u[40, 2] += 100.0
    monitor = SafetyMonitor(BELIEF, LIMITS, sample_interval=2, period=2)
    sampled = ComponentStepper(monitor)
    assert monitor.trip is None
    for k, row in enumerate(u):
        sampled(row, 2e-3 * k, 2e-3)
    tick, reason, value, limit, joint = latched(monitor.trip)
    assert (tick, reason, joint) == (80, Reason.JUMP, 3)
    # 100 counts of 2 pi / 4096 in 2 ms
    assert value == pytest.approx(100 * 2 * math.pi / 4096 / 2e-3, rel=1e-12)
    assert limit == LIMITS.jump_limit


def test_two_monitors_share_no_memory():
    one, two = SafetyMonitor(BELIEF, LIMITS), SafetyMonitor(BELIEF, LIMITS)
    u = standing(1)[0]
    ComponentStepper(one)(np.where(np.arange(10) == 0, np.nan, u))
    assert one.trip is not None
    ComponentStepper(two)(u)
    assert two.trip is None


def test_ports_are_as_wide_as_the_step_expects():
    assert (width(MONITOR_INPUTS), width(MONITOR_OUTPUTS)) == (10, 11)
