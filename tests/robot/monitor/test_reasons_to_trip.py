"""Each check trips on its own violation, with its own reason, when it is due and not before."""

import numpy as np
import pytest

from tests.robot.monitor.motions import (
    BELIEF,
    COUNT_L,
    COUNT_M,
    DT,
    LIMITS,
    OMEGA_REF,
    SAMPLE,
    angles,
    inputs,
    latched,
    ramp,
    standing,
    told,
    watched,
)
from twin.robot.monitor.limits import Limits
from twin.robot.monitor.reasons import Reason

FAULT = 100
"""Row in which the fault first shows."""

MOTOR_COUNT = 2.0 * np.pi / BELIEF.motor_counts


def trip_row(u, reason: Reason, limits: Limits = LIMITS, joint: int | None = None, cut: bool = False) -> int:
    """Row of the trip, after checks that it is the only thing that ever happened.

    Args:
        cut: whether a motor is so far off its commands that the power is cut at once.
    """
    seen = watched(u, limits)
    trip = latched(seen.trip)
    assert trip.reason is reason
    assert joint is None or trip.joint == joint
    row = int(np.argmax(seen.outputs["tripped"]))
    assert trip.tick == row
    # the drives get the retraction, or no power, in the very evaluation that trips, the commands until then
    np.testing.assert_array_equal(seen.outputs["omega_ref"][:row], u[:row, OMEGA_REF])
    np.testing.assert_array_equal(seen.outputs["omega_ref"][row], 0.0 if cut else -LIMITS.retract_speed)
    assert seen.outputs["power"][row] == (not cut)
    np.testing.assert_array_equal(seen.outputs["reason"], np.where(np.arange(len(u)) < row, 0, reason))
    assert np.all(seen.outputs["utilisation"][:row] < 1.0)
    assert seen.outputs["utilisation"][row] >= 1.0 - 1e-9
    return row


@pytest.mark.parametrize("column", [*range(7)])
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e300])
def test_an_invalid_message_trips_at_once(column, value):
    u = standing(FAULT + 5)
    u[FAULT:, column] = value
    assert trip_row(u, Reason.INVALID_SAMPLE) == FAULT


def test_a_number_of_a_message_has_31_bits():
    u = standing(FAULT + 5)
    u[FAULT:, SAMPLE] = 2.0**31
    assert trip_row(u, Reason.INVALID_SAMPLE) == FAULT
    u[FAULT:, SAMPLE] = 2.0**31 - 1.0
    assert trip_row(u, Reason.STALE) == FAULT


def test_a_first_message_that_is_invalid_trips_at_once():
    u = standing(5)
    u[:, 0] = np.nan
    assert trip_row(u, Reason.INVALID_SAMPLE) == 0


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e300])
def test_an_invalid_command_trips_at_once_and_reaches_no_drive(value):
    u = standing(FAULT + 5)
    u[FAULT, 8] = value
    assert trip_row(u, Reason.INVALID_COMMAND) == FAULT


def test_messages_that_stop_trip_after_the_stale_time():
    u = standing(FAULT + 20)
    u[FAULT:, SAMPLE] = u[FAULT - 1, SAMPLE]
    # the message in row FAULT is one sample late already
    assert trip_row(u, Reason.STALE) == FAULT + round(LIMITS.stale_time / DT) - 1


def test_messages_at_half_their_rate_trip():
    u = standing(FAULT + 30)
    u[FAULT:, SAMPLE] = FAULT + np.arange(30) // 2
    # one sample is lost in two
    assert trip_row(u, Reason.STALE) == FAULT + 2 * round(LIMITS.stale_time / DT) - 1


def test_a_counter_that_starts_anew_trips_at_once():
    u = standing(FAULT + 5)
    u[FAULT:, SAMPLE] = np.arange(5)
    assert trip_row(u, Reason.STALE) == FAULT


def test_a_lost_message_is_no_reason():
    u = inputs(ramp(200, (0.0, -0.01, -0.09), (0.01, 0.01, -0.11)))
    for lost in (30, 31, 120):
        u[lost, :7] = u[lost - 1, :7]
    assert watched(u).trip is None


@pytest.mark.parametrize(("columns", "scale"), [(COUNT_M, 1.0), (COUNT_L, BELIEF.N * 0.25)])
@pytest.mark.parametrize("joint", [1, 2, 3])
def test_a_glitch_of_one_sample_trips_at_once_if_nothing_can_move_so_fast(columns, scale, joint):
    u = standing(FAULT + 5)
    most = int(LIMITS.jump_limit * DT / (scale * MOTOR_COUNT))
    u[FAULT, columns.start + joint - 1] += most
    assert watched(u).trip is None
    u[FAULT, columns.start + joint - 1] += 1
    assert trip_row(u, Reason.JUMP, joint=joint) == FAULT


@pytest.mark.parametrize("columns", [COUNT_M, COUNT_L])
def test_a_sign_that_flips_and_channels_that_swap_trip_at_once(columns):
    u = standing(FAULT + 5)
    flipped, swapped = u.copy(), u.copy()
    flipped[FAULT:, columns] *= -1.0
    swapped[FAULT:, columns] = u[FAULT:, columns][:, [1, 0, 2]]
    assert trip_row(flipped, Reason.JUMP) == FAULT
    assert trip_row(swapped, Reason.JUMP) == FAULT


@pytest.mark.parametrize("columns", [COUNT_M, COUNT_L])
def test_channels_that_were_always_swapped_trip_where_the_joints_differ(columns):
    u = standing(5)
    u[:, columns] = u[:, columns][:, [1, 0, 2]]
    assert trip_row(u, Reason.DEFLECTION) == 0


def test_joint_angles_without_a_pose_trip_at_once():
    # one leg folded inward puts the three knees on a line, and no point is as far from them all
    theta_l = np.tile([3.1, 0.0, 0.0], (5, 1))
    assert trip_row(told(BELIEF.N * theta_l, theta_l), Reason.NO_POSE) == 0


def test_a_deflection_at_its_limit_trips_at_once():
    theta_m, theta_l = angles(np.tile((0.0, 0.0, -0.1), (500, 1)), np.zeros((500, 3)))
    theta_m[:, 1] = BELIEF.N * theta_l[:, 1] + np.linspace(0.0, 0.4, 500)
    # the joint encoder really stands still here
    u, limits = told(theta_m, theta_l), LIMITS._replace(frozen_travel=1.0)
    deflection = MOTOR_COUNT * u[:, 1] - BELIEF.N * 0.25 * MOTOR_COUNT * u[:, 4]
    assert trip_row(u, Reason.DEFLECTION, limits, joint=2) == np.argmax(deflection >= LIMITS.deflection_limit)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_motor_encoder_that_stands_still_against_its_command_trips_after_the_frozen_time(sign):
    u = standing(FAULT + 100)
    u[FAULT:, 7] = sign * 1.01 * LIMITS.frozen_demand
    # a command given in row k can show in row k + 1
    assert trip_row(u, Reason.FROZEN_MOTOR, joint=1) == FAULT + round(LIMITS.frozen_time / DT)
    u[FAULT:, 7] = sign * 0.99 * LIMITS.frozen_demand
    assert watched(u).trip is None


@pytest.mark.parametrize("size", [1.1, 2.0])
def test_a_motor_that_is_commanded_to_and_fro_need_not_move(size):
    u = standing(FAULT + 400)
    u[FAULT:, 7] = np.where(np.arange(400) // 40 % 2, 1.0, -1.0) * size * LIMITS.frozen_demand
    assert watched(u).trip is None


def test_a_joint_encoder_that_stands_still_trips_after_the_motor_travelled():
    u = inputs(ramp(1500, (0.0, 0.0, -0.09), (0.0, 0.0, -0.12)))
    u[FAULT:, 5] = u[FAULT, 5]
    travel = MOTOR_COUNT * (u[:, 2] - u[FAULT, 2])
    found = trip_row(u, Reason.FROZEN_JOINT, joint=3)
    # the joint encoder had last moved up to two of its counts, one of the motor's, before
    assert abs(found - np.argmax(travel >= LIMITS.frozen_travel)) <= 8


def low_passed(F):
    """`F` (n,) behind the monitor's low-pass, which starts settled."""
    share, filtered = 1.0 - np.exp(-2.0 * np.pi * LIMITS.filter * DT), [F[0]]
    for value in F[1:]:
        filtered.append(filtered[-1] + share * (value - filtered[-1]))
    return np.array(filtered)


def pressing(n, F_z, K=5000.0):
    """Inputs from a robot that presses on a surface of stiffness `K` (N/m) with `F_z` (n,)."""
    p_B = np.zeros((n, 3))
    p_B[:, 2] = -0.1 - F_z / K
    return inputs(p_B, np.stack([0.0 * F_z, 0.0 * F_z, -F_z], axis=1))


def test_a_force_at_its_limit_trips():
    F_z = np.linspace(0.0, 20.0, 500)
    # a count on each encoder is worth 0.25 N, 0.1 N low-passed; the ramp makes 0.04 N per row
    assert abs(trip_row(pressing(500, F_z), Reason.FORCE) - np.argmax(low_passed(F_z) >= 15.0)) <= 3


def test_a_pull_trips_like_a_push():
    F_z = np.linspace(0.0, -20.0, 500)
    assert trip_row(pressing(500, F_z), Reason.FORCE) > 0


@pytest.mark.parametrize(("rate", "trips"), [(240.0, False), (400.0, True)])
def test_a_force_that_grows_too_fast_trips(rate, trips):
    F_z = np.clip(rate * DT * (np.arange(150) - FAULT), 0.0, 12.0)
    u = pressing(150, F_z)
    if not trips:
        assert watched(u).trip is None
        return
    # share of the slope that the low-pass shows after n rows: 1 - exp(-2 pi f n DT), 3/4 of it after six
    assert FAULT + 4 <= trip_row(u, Reason.FORCE_RATE) <= FAULT + 8


def test_a_force_that_falls_fast_is_no_reason():
    F_z = np.clip(12.0 - 1000.0 * DT * (np.arange(150) - FAULT), 0.0, 12.0)
    assert watched(pressing(150, F_z)).trip is None


def test_penetration_counts_from_where_the_contact_began():
    n = 1200
    p_B = ramp(n, (0.0, 0.0, -0.08), (0.0, 0.0, -0.115))
    F_z = np.where(p_B[:, 2] < -0.085, 3.0, 0.0)
    u = inputs(p_B, np.stack([0.0 * F_z, 0.0 * F_z, -F_z], axis=1))
    limits = LIMITS._replace(force_rate_limit=1e6)
    touched = np.argmax(low_passed(F_z) >= LIMITS.contact_force)
    due = np.argmax(p_B[touched, 2] - p_B[:, 2] >= LIMITS.penetration_limit)
    # 0.03 mm per row; a joint count is worth 0.03 mm
    assert abs(trip_row(u, Reason.PENETRATION, limits) - due) <= 2


@pytest.mark.parametrize(("speed", "trips"), [(0.23, False), (0.29, True)])
def test_a_platform_that_moves_too_fast_trips(speed, trips):
    p_B = np.tile((0.0, 0.0, -0.085), (150, 1))
    p_B[:, 2] -= np.clip(speed * DT * (np.arange(150) - FAULT), 0.0, 0.04)
    u = inputs(p_B)
    if not trips:
        assert watched(u).trip is None
        return
    # 86 % of the speed shows after 2.0 time constants of 8 ms: eight rows
    assert FAULT + 6 <= trip_row(u, Reason.SPEED) <= FAULT + 10


@pytest.mark.parametrize(
    ("end", "reason"),
    [
        ((0.045, 0.0, -0.1), Reason.RADIUS),
        ((-0.03, -0.033, -0.1), Reason.RADIUS),
        ((0.0, 0.0, -0.14), Reason.TOO_LOW),
        ((0.0, 0.0, -0.07), Reason.TOO_HIGH),
    ],
)
def test_a_platform_that_leaves_the_workspace_trips_at_its_edge(end, reason):
    p_B = ramp(1000, (0.0, 0.0, -0.1), end)
    outside = np.hypot(p_B[:, 0], p_B[:, 1]) >= LIMITS.workspace_radius
    outside |= (p_B[:, 2] <= LIMITS.z_min) | (p_B[:, 2] >= LIMITS.z_max)
    # 0.03 to 0.05 mm per row; a count on each joint is worth 0.07 mm
    assert abs(trip_row(inputs(p_B), reason) - np.argmax(outside)) <= 2


def test_a_contact_without_a_pause_trips_and_a_pause_starts_it_anew():
    limits = LIMITS._replace(contact_time_limit=0.2)
    F_z = np.full(150, 3.0)
    assert trip_row(pressing(150, F_z), Reason.CONTACT_TIME, limits) == 99
    # released and loaded again within 20 ms each
    F_z[60:90] = 3.0 * np.clip(np.abs(np.arange(30) - 14.5) / 5.0 - 1.9, 0.0, 1.0)
    assert watched(pressing(150, F_z), limits).trip is None


def test_a_command_at_its_limit_trips_after_the_saturation_time():
    limits = LIMITS._replace(frozen_time=9.0, follow_time=9.0)
    u = standing(FAULT + 300)
    u[FAULT:, 8] = -LIMITS.command_limit
    # the motor stands still all the time
    row = trip_row(u, Reason.SATURATION, limits, joint=2, cut=True)
    assert row == FAULT + round(LIMITS.saturation_time / DT) - 1
    u[FAULT:, 8] = -0.99 * LIMITS.command_limit
    assert watched(u, limits).trip is None


@pytest.mark.parametrize(("command", "speed"), [(3.0, 0.3), (0.0, 2.5), (2.0, -1.0)])
def test_a_motor_that_does_not_follow_trips_after_the_follow_time(command, speed):
    theta_m, theta_l = angles(np.tile((0.0, 0.0, -0.1), (FAULT + 80, 1)), np.zeros((FAULT + 80, 3)))
    turned = speed * DT * np.clip(np.arange(FAULT + 80) - FAULT, 0, None)
    theta_m[:, 0] += turned
    theta_l[:, 0] += turned / BELIEF.N
    u = told(theta_m, theta_l)
    u[:, OMEGA_REF] = 0.0
    u[FAULT:, 7] = command
    late = trip_row(u, Reason.FOLLOW, joint=1, cut=command == 0.0) - FAULT - round(LIMITS.follow_time / DT)
    # the low-pass shows the bound's share of the difference after at most 0.92 of its 8 ms: four rows
    assert 0 <= late <= 5


def test_a_drive_as_slow_as_it_may_be_follows():
    # first order, T_m = 40 ms, twice that of the shipped drive, at the largest step a controller can make
    step = 8.0 * (np.arange(400) >= FAULT) * (np.arange(400) < FAULT + 60)
    speed = np.zeros(400)
    for k in range(1, 400):
        speed[k] = speed[k - 1] + (1.0 - np.exp(-DT / 0.04)) * (step[k - 1] - speed[k - 1])
    theta_m = 0.2 + np.tile(np.concatenate([[0.0], np.cumsum(speed)[:-1] * DT])[:, None], (1, 3))
    u = told(theta_m, theta_m / BELIEF.N)
    u[:, OMEGA_REF] = step[:, None]
    loose = LIMITS._replace(speed_limit=1e3, z_min=-1.0, z_max=1e-9, penetration_limit=1.0)
    assert watched(u, loose).trip is None


DROOP = 0.6
"""rad/s per N m, as the default drive has it."""
FEELING = LIMITS._replace(drive_droop=DROOP, drive_lag=0.02)


def hidden(n: int, shown: float, felt: float, way: float = -1.0):
    """Inputs (n, 10): drives lose speed to a press of `felt` (N) from FAULT on, encoders show `shown`.

    Args:
        way: of the force in z; -1: a press.
    """
    u = standing(n, F_z=shown)
    for row, force in ((slice(0, FAULT), shown), (slice(FAULT, n), felt)):
        theta_m, theta_l = angles(np.array([(0.01, -0.015, -0.1)]), np.array([(0.0, 0.0, way * force)]))
        deflected = theta_m - BELIEF.N * theta_l
        # P12 at rest: omega_m = omega_ref - droop tau_load = 0
        u[row, OMEGA_REF] = DROOP * BELIEF.k_s * (deflected - np.sign(deflected) * BELIEF.backlash)
    return u


def test_a_force_that_the_motors_feel_and_the_encoders_hide_trips():
    """10 N more: 8 N of them are through a low-pass of 250 ms after 402 ms, and last 500 ms."""
    due = FAULT + round((0.25 * np.log(10.0 / (10.0 - FEELING.hidden_force_limit)) + FEELING.hidden_time) / DT)
    # the drive's lag of 20 ms and the filter of 8 ms come before; a count of each encoder is worth 0.25 N
    assert due <= trip_row(hidden(FAULT + 600, 4.0, 14.0), Reason.HIDDEN_FORCE, FEELING) <= due + 30


@pytest.mark.parametrize(("shown", "felt", "way"), [(4.0, 11.0, -1.0), (4.0, 0.0, -1.0), (0.0, 12.0, 1.0)])
def test_a_hidden_force_below_its_limit_a_missing_one_and_a_pull_are_no_reason(shown, felt, way):
    """Drives that lose less speed than believed, or none, look like a force that is missing."""
    assert watched(hidden(FAULT + 600, shown, felt, way), FEELING).trip is None


def test_without_a_believed_droop_no_hidden_force_is_looked_for():
    assert watched(hidden(FAULT + 600, 4.0, 14.0), LIMITS).trip is None


def test_drives_without_load_that_are_slower_than_believed_hide_no_force():
    """A lag of 40 ms for the believed 20, and strokes of a tap: to and fro at 3.5 rad/s, twice a second."""
    command, speed = 3.5 * np.sign(np.sin(4.0 * np.pi * DT * np.arange(1500))), np.zeros(1500)
    for k in range(1, 1500):
        speed[k] = speed[k - 1] + (1.0 - np.exp(-DT / 0.04)) * (command[k - 1] - speed[k - 1])
    theta_m = 0.2 + np.tile(np.concatenate([[0.0], np.cumsum(speed)[:-1] * DT])[:, None], (1, 3))
    u = told(theta_m, theta_m / BELIEF.N)
    u[:, OMEGA_REF] = command[:, None]
    loose = FEELING._replace(speed_limit=1e3, z_min=-1.0, z_max=1e-9, penetration_limit=1.0, follow_time=9.0)
    assert watched(u, loose).trip is None
