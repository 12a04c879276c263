"""What the robot does after a trip, with the plant, its contact and first-order drives in the loop."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.laws.runs import PARAMETERS, ComponentStepper
from tests.robot.monitor.motions import BELIEF, DT, GEOMETRY, LIMITS, latched, standing, watched
from twin.robot.mechanism.kinematics import jacobian
from twin.robot.monitor.component import OBSERVATION_RECORD, SafetyMonitor, press_deflection
from twin.robot.monitor.limits import Limits
from twin.robot.monitor.reasons import Reason
from twin.robot.monitor.safe_action import (
    RETRACTION_RECORD,
    SINK_LIMIT,
    Retreat,
    enforce,
    is_too_far,
    is_too_fast,
    keeps_moving,
    presses_at_limit,
    retraction_speed,
    retreat,
)
from twin.robot.plant.component import Plant, rest_state
from twin.robot.plant.encoder import Encoder, Shaft

TICK = 1e-3
T_M = 0.02
"""Time constant of the drives (s), that of the shipped one."""

WAITING = LIMITS._replace(disobeyed=0)
"""The reaction that waits for `follow_time`."""
NEVER = 1e9
"""Lag (s) of a drive that stands still."""
FAULT = 50
PRESSES = [(x, y, -0.105) for x in (-0.02, 0.0, 0.02) for y in (-0.02, 0.0, 0.02)]
"""Where the robot presses on the scale of Fig. 4 with 5 N, over the range that the paper sweeps and as far sideways."""

Disturbance = Callable[[np.ndarray, int], None]


class Pressing:
    """A robot that rests on the scale under a monitor and is commanded to stay; ticks of 1 ms.

    Args:
        counts: changes the encoder message (7,) in place from tick `FAULT` on.
        motors: changes the motor speeds (3,), rad/s, in place from tick `FAULT` on.
        limits: of the monitor.
        lag: of the drives (s).
    """

    def __init__(
        self,
        p_B,
        counts: Disturbance | None = None,
        motors: Disturbance | None = None,
        ticks: int = 700,
        limits: Limits = LIMITS,
        lag: float = T_M,
    ):
        x, theta_m = rest_state(PARAMETERS, p_B)
        plant, encoder = (
            ComponentStepper(Plant(PARAMETERS, x, theta_m)),
            ComponentStepper(Encoder(Shaft(4096), Shaft(16384))),
        )
        self.monitor = SafetyMonitor(BELIEF, limits, sample_interval=2)
        watching = ComponentStepper(self.monitor)
        state = plant.component.initial_outputs
        omega, message, rows, truth = np.zeros(3), np.zeros(7), [], []
        for k in range(ticks):
            if k % 2 == 0:
                message = encoder(np.append(theta_m, state[6:9]))
            sent = message.copy()
            if counts is not None and k >= FAULT:
                counts(sent, k)
            rows.append(watching(np.append(sent, np.zeros(3)), k * TICK, TICK))
            truth.append(state.copy())
            powered = rows[-1][5] == 1.0
            omega = omega + (1.0 - math.exp(-TICK / lag)) * (rows[-1][:3] - omega) if powered else np.zeros(3)
            if motors is not None and k >= FAULT:
                motors(omega, k)
            theta_m = theta_m + TICK * omega
            state = plant(theta_m, k * TICK, TICK)
        self.outputs, self.truth = np.array(rows), np.array(truth)

    @property
    def raised(self) -> float:
        """How far the platform is above where it pressed (m), at the end."""
        return float(self.truth[-1, 2] - self.truth[0, 2])

    @property
    def F_z(self) -> np.ndarray:
        """True pressing force, N, (ticks,)."""
        return -self.truth[:, 20]


def lost(message, k):
    message[:] = np.nan


def stopped(message, k):
    message[6] = FAULT // 2


def dead_motor_encoder(message, k):
    message[1] = 4095.0


def dead_joint_encoder(message, k):
    message[4] = -1.0


def runaway(omega, k):
    omega[2] = 4.0


def jam(omega, k):
    omega[:] = 0.0


@pytest.mark.parametrize("p_B", PRESSES)
def test_without_a_single_encoder_the_retraction_ends_the_contact(p_B):
    run = Pressing(p_B, counts=lost)
    assert run.F_z[FAULT] == pytest.approx(5.0, abs=0.01)
    assert run.F_z[-1] == 0.0
    # the kinematics of the motors, which lag until they lose their power, less the springs that unwind, 5 N over
    # 2137 N/m at home; platform still swinging
    turned = LIMITS.retract - T_M * LIMITS.retract_speed
    expected = retreat(GEOMETRY, BELIEF.N, p_B, turned).raised - 5.0 / 2137.0
    assert run.raised == pytest.approx(expected, abs=3e-4)
    # 70 mm/s for 4 mm of contact and 2.3 mm of springs, behind the drives' 20 ms: the numbers of docs/safety.md
    released = np.argmax((run.F_z == 0.0) & (np.arange(700) > FAULT)) - FAULT
    assert 100 < released < 120
    assert run.F_z.max() < 5.01


@pytest.mark.parametrize("fault", [lost, stopped, dead_motor_encoder, dead_joint_encoder])
def test_encoders_that_fail_do_not_stop_the_retraction(fault):
    run = Pressing(PRESSES[0], counts=fault)
    trip, off = latched(run.monitor.trip), run.monitor.power_off_tick
    # a retraction that nobody sees ends without power, once it should have been done
    done = LIMITS.retract / LIMITS.retract_speed
    assert (off is None) == (fault not in (lost, stopped))
    assert off is None or 0.0 <= TICK * (off - trip.tick) - done < 0.002
    # 17.7 mm from this corner, less 2.3 mm of the springs and 1.2 mm of the drives' lag
    assert run.raised > 0.0135


@pytest.mark.parametrize("ticks", [1, 7, 300, 999])
def test_a_retraction_of_whole_ticks_takes_just_as_many(ticks):
    limits = LIMITS._replace(retract=ticks * 1e-3 * LIMITS.retract_speed)
    retraction = np.rec.array(np.zeros(1, RETRACTION_RECORD))[0]
    retraction.power = 1
    # the time since the trip is a multiple of the tick, give or take its last bits
    turning = [retraction_speed(limits, retraction, k * 1e-3) != 0.0 for k in range(ticks + 2)]
    assert turning == [True] * ticks + [False] * 2


def test_the_robot_holds_where_the_retraction_ends():
    run = Pressing(PRESSES[0], counts=dead_joint_encoder)
    tripped = latched(run.monitor.trip).tick
    turning = np.arange(len(run.outputs))[run.outputs[:, 0] != 0.0]
    assert turning[0] == tripped
    # 30 deg at 2 rad/s take 261.8 ms: the command of the last tick begins within them
    assert turning[-1] - turning[0] == math.floor(1e3 * LIMITS.retract / LIMITS.retract_speed)
    np.testing.assert_array_equal(run.outputs[turning, :3], -LIMITS.retract_speed)
    # the springs still let it swing; its damping is light
    assert np.abs(run.truth[-1, 3:6]).max() < 5e-3


@pytest.mark.parametrize(
    ("motors", "limits", "after"),
    # the two drives with sound encoders are known to be late long before the follow time
    [(runaway, WAITING, LIMITS.follow_time), (jam, WAITING, LIMITS.follow_time), (jam, LIMITS, 0.02)],
)
def test_motors_that_do_not_retract_lose_their_power(motors, limits, after):
    run = Pressing(PRESSES[4], counts=lost_for_one_sample if motors is jam else None, motors=motors, limits=limits)
    trip, off = latched(run.monitor.trip), run.monitor.power_off_tick
    assert off is not None
    # what the low-passes of 8 ms and the drive's 20 ms take to show the difference
    assert 0 <= TICK * (off - trip.tick) - after <= 0.012
    power = np.arange(len(run.outputs)) < off
    np.testing.assert_array_equal(run.outputs[:, 5], power)
    np.testing.assert_array_equal(run.outputs[off:, :3], 0.0)


def lost_for_one_sample(message, k):
    if k < FAULT + 2:
        message[0] = np.nan


def test_a_runaway_is_a_motor_that_does_not_follow_and_loses_its_power_at_once():
    run = Pressing(PRESSES[4], motors=runaway)
    trip = latched(run.monitor.trip)
    # 4 rad/s of one motor press with 10.3 N when the follow time is over; here it runs on without power
    assert trip.reason is Reason.FOLLOW
    assert run.monitor.power_off_tick == trip.tick
    assert run.F_z[: trip.tick].max() < 10.5


def lost_for_a_while(message, k):
    if k < FAULT + 20:
        message[6] = FAULT // 2


class Creep:
    """All motors turn down at `speed` (rad/s), whatever is commanded, from `since` (ticks) on until they lose power."""

    def __init__(self, speed: float, since: int = 500):
        self.speed, self.since = speed, since

    def __call__(self, omega, k):
        if k >= self.since and np.any(omega != 0.0):
            omega[:] = self.speed


@pytest.mark.parametrize("speed", [0.2, 0.3, 0.4])
def test_no_motor_goes_down_past_its_angle_at_the_trip_by_more_than_three_degrees(speed):
    ticks = 700 + round((LIMITS.retract + 0.5) / speed / TICK)
    run = Pressing(PRESSES[4], counts=lost_for_a_while, motors=Creep(speed), ticks=ticks)
    trip, off = latched(run.monitor.trip), run.monitor.power_off_tick
    assert trip.reason is Reason.STALE and off is not None
    # the motor's angle is that of its count: a hundredth of what is left of the 5 N, and 3.4 N of 3 degrees
    assert run.F_z[trip.tick :].max() < 5.0 + 4.0
    old = Pressing(PRESSES[4], counts=lost_for_a_while, motors=Creep(speed), ticks=ticks, limits=WAITING)
    assert old.monitor.power_off_tick is None and old.F_z.max() > 12.0


@pytest.mark.parametrize("speed", [25.0, 30.0, 40.0])
def test_motors_that_jump_on_in_the_next_sample_run_away_and_lose_their_power_then(speed):
    def race(omega, k):
        omega[:] = speed if np.any(omega != 0.0) or k == FAULT else 0.0

    run = Pressing(PRESSES[4], motors=race)
    trip, off = latched(run.monitor.trip), run.monitor.power_off_tick
    assert trip.reason in (Reason.JUMP, Reason.FORCE_RATE) and off is not None
    assert off - trip.tick <= 2
    # two samples of 2 ms and the last tick with power: three degrees each at 25 rad/s, 1.1 N per degree
    assert run.F_z.max() < 5.0 + 5.0 * TICK * math.degrees(speed) * 1.2


@pytest.mark.parametrize("size", [100.0, -100.0, 1000.0])
@pytest.mark.parametrize("back", [True, False])
def test_an_encoder_that_jumps_once_or_there_and_back_takes_no_power(size: float, back: bool):
    def glitch(message, k):
        message[:3] += size * (k < FAULT + 2 or not back)

    run = Pressing(PRESSES[4], counts=glitch)
    assert latched(run.monitor.trip).reason is Reason.JUMP
    assert run.monitor.power_off_tick is None and run.F_z[-1] == 0.0


@pytest.mark.parametrize(("retracting", "races_down"), [(True, False), (False, True)])
def test_a_joint_whose_motor_encoder_is_doubted_may_swing_down_only_while_it_retracts(retracting, races_down):
    seen, retraction = (np.rec.array(np.zeros(1, kind))[0] for kind in (OBSERVATION_RECORD, RETRACTION_RECORD))
    retraction.doubt_m[0], seen.omega_l[0] = 1, LIMITS.retract_speed + 1.1 * LIMITS.follow_limit
    assert is_too_fast(LIMITS, seen, retraction, 0, retracting) == races_down


def is_far(**values: float) -> bool:
    """Return whether drive 1 is too far with these `values` of the retraction."""
    retraction = np.rec.array(np.zeros(1, RETRACTION_RECORD))[0]
    for name, value in values.items():
        retraction[name][0] = value
    return bool(is_too_far(LIMITS, retraction, 0))


def test_an_angle_below_that_of_the_trip_is_that_of_the_motor_or_else_of_the_joint():
    deep = SINK_LIMIT + 1e-3
    assert is_far(travel_m=deep) and not is_far(travel_m=SINK_LIMIT - 1e-3)
    # a drive that turned down at the trip travels on
    assert not is_far(travel_m=deep, most=2.0) and is_far(travel_m=20.0 * deep, most=2.0)
    # the joint shows it if the motor's encoder is doubted or has not moved; it swings up
    assert is_far(travel_l=deep) and is_far(travel_l=deep, travel_m=-0.1, doubt_m=1)
    assert not is_far(travel_l=deep, travel_m=-0.1) and not is_far(travel_l=-1.0)
    assert not is_far(travel_l=deep, doubt_m=1, doubt_l=1)
    assert is_far(travel_m=-LIMITS.retract - deep) and not is_far(travel_m=-LIMITS.retract)


@pytest.mark.parametrize(
    ("force", "depth", "doubt_m", "doubt_l", "presses"),
    [
        (15.0, 0.0, 0, 0, True),
        (14.9, 0.0249, 0, 0, False),
        (0.0, 0.025, 0, 0, True),
        # a motor encoder gives no force, but the joints' give the depth
        (99.0, 0.0, 1, 0, False),
        (0.0, 0.025, 1, 0, True),
        (99.0, 1.0, 0, 1, False),
    ],
)  # fmt: skip
def test_force_and_depth_after_the_retraction_cut_all_power_if_their_encoders_are_not_doubted(
    force: float, depth: float, doubt_m: int, doubt_l: int, presses: bool
):
    seen, retraction = (np.rec.array(np.zeros(1, kind))[0] for kind in (OBSERVATION_RECORD, RETRACTION_RECORD))
    seen.force, seen.depth, retraction.power, retraction.power_off_tick = force, depth, 1, -1
    retraction.doubt_m[1], retraction.doubt_l[2] = doubt_m, doubt_l
    assert bool(presses_at_limit(LIMITS, seen, retraction)) is presses
    # not before the slowest drive that obeys has stopped: it may still unload the springs
    enforce(LIMITS, seen, retraction, True, 400, 0.35, 0.0, False)
    assert retraction.power == 1
    enforce(LIMITS, seen, retraction, True, 900, 0.8, 0.0, False)
    assert bool(retraction.power == 0) is presses


def test_a_motor_encoder_that_is_fast_in_one_direction_for_two_samples_keeps_moving():
    seen, fast = np.rec.array(np.zeros(1, OBSERVATION_RECORD))[0], LIMITS.jump_limit

    def moves(last: float, rate: float) -> bool:
        seen.last_m[0], seen.rate_m[0] = last, rate
        return bool(keeps_moving(LIMITS, seen, 0))

    assert moves(fast, fast) and moves(-fast, -fast) and moves(0.6 * fast, fast)
    assert not moves(fast, -fast) and not moves(0.4 * fast, fast) and not moves(fast, 0.4 * fast)


@pytest.mark.parametrize("counts", [lost_for_a_while, dead_joint_encoder, dead_motor_encoder])
@pytest.mark.parametrize("speed", [8.0, 12.0])
def test_a_motor_that_races_after_the_retraction_loses_its_power_before_it_is_back(counts, speed):
    def race(omega, k):
        if k >= 500 and (k == 500 or np.any(omega != 0.0)):
            omega[:] = speed

    run = Pressing(PRESSES[4], counts=counts, motors=race)
    off = run.monitor.power_off_tick
    assert off is not None and off - 500 <= 8
    assert run.F_z[500:].max() == 0.0
    old = Pressing(PRESSES[4], counts=counts, motors=race, limits=WAITING, ticks=620)
    assert old.F_z[500:].max() > 5.0


def test_a_motor_that_races_up_during_the_retraction_loses_its_power_at_once():
    run = Pressing(PRESSES[4], counts=lost_for_a_while, motors=Creep(-6.0, since=100), ticks=300)
    off = run.monitor.power_off_tick
    # its low-passed speed is known after 10 ms; the limit of its angle takes 80 ms
    assert off is not None and 0 <= off - 100 <= 20


@pytest.mark.parametrize("speed", [8.0, 12.0])
def test_a_drive_without_its_motor_encoder_that_races_after_the_retraction_is_known_by_its_joint(speed):
    def race(omega, k):
        if k >= 500 and (k == 500 or omega[1] != 0.0):
            omega[1] = speed

    run = Pressing(PRESSES[4], counts=dead_motor_encoder, motors=race, ticks=620)
    trip, off = latched(run.monitor.trip), run.monitor.power_off_tick
    assert trip.joint == 2 and off is not None
    # the limit of its angle takes the retraction and 3 degrees
    assert TICK * (off - 500) < 0.8 * (LIMITS.retract + math.radians(3.0)) / speed


def test_motors_that_creep_up_lose_their_power_three_degrees_above_the_end_of_the_retraction():
    run = Pressing(PRESSES[4], counts=lost_for_a_while, motors=Creep(-0.3), ticks=1000)
    off = run.monitor.power_off_tick
    assert off is not None
    turned = abs(0.3 * TICK * (off - 500))
    assert turned == pytest.approx(math.radians(3.0), abs=0.02)
    assert Pressing(PRESSES[4], counts=lost_for_a_while, ticks=1000).monitor.power_off_tick is None


@pytest.mark.parametrize("broken", [dead_motor_encoder, dead_joint_encoder])
def test_an_encoder_that_is_doubted_leaves_the_other_drives_their_rules(broken):
    run = Pressing(PRESSES[4], counts=broken, motors=runaway)
    trip, off = latched(run.monitor.trip), run.monitor.power_off_tick
    # drive 3 runs away; the encoder is that of joint 2
    assert trip.reason is Reason.JUMP and trip.joint == 2
    # by its own motor's encoder; the joint's takes 24 ms
    assert off is not None and TICK * (off - trip.tick) < 0.01
    assert run.F_z[:off].max() < 6.0


@pytest.mark.parametrize("broken", [dead_motor_encoder, dead_joint_encoder])
def test_a_drive_is_judged_by_the_encoder_that_is_left(broken):
    run = Pressing(PRESSES[4], counts=broken, motors=lambda omega, k: omega.__setitem__(1, 4.0))
    trip, off = latched(run.monitor.trip), run.monitor.power_off_tick
    assert off is not None and TICK * (off - trip.tick) < 0.08
    assert run.F_z[:off].max() < 7.0


def test_an_unusable_count_leaves_the_sound_encoders_of_its_message():
    def no_number(message, k):
        message[1] = np.nan

    sound = Pressing(PRESSES[4], counts=no_number)
    assert latched(sound.monitor.trip).reason is Reason.INVALID_SAMPLE
    assert sound.monitor.power_off_tick is None and sound.F_z[-1] == 0.0
    run = Pressing(PRESSES[4], counts=no_number, motors=runaway)
    assert run.monitor.power_off_tick is not None
    assert TICK * (run.monitor.power_off_tick - latched(run.monitor.trip).tick) < 0.03


def test_a_drive_without_a_sound_encoder_loses_its_power_when_the_retraction_is_over():
    def none_left(message, k):
        message[[1, 4]] = np.nan

    run = Pressing(PRESSES[4], counts=none_left)
    trip, off = latched(run.monitor.trip), run.monitor.power_off_tick
    assert off is not None
    assert TICK * (off - trip.tick) == pytest.approx(LIMITS.retract / LIMITS.retract_speed, abs=0.002)


@pytest.mark.parametrize("lag", [0.002, 0.02, 0.04, 0.1])
def test_a_drive_of_a_lag_up_to_the_stated_one_keeps_its_power(lag):
    assert lag <= LIMITS.obey_lag
    # it presses with 5 N, and that trips
    run = Pressing(PRESSES[4], limits=LIMITS._replace(force_limit=4.0), lag=lag)
    assert latched(run.monitor.trip).reason is Reason.FORCE
    assert run.monitor.power_off_tick is None
    assert run.F_z[-1] == 0.0


def test_a_drive_that_stands_still_is_known_long_before_the_follow_time():
    run = Pressing(PRESSES[4], limits=LIMITS._replace(force_limit=4.0), lag=NEVER)
    trip, off = latched(run.monitor.trip), run.monitor.power_off_tick
    assert trip.reason is Reason.FORCE and off is not None
    # after obey_delay the slowest drive that obeys is at -0.375 rad/s, its slack, 21 ms later
    assert 0.02 < TICK * (off - trip.tick) < 0.05


def test_with_the_old_reaction_that_takes_the_follow_time():
    run = Pressing(PRESSES[4], limits=WAITING._replace(force_limit=4.0), lag=NEVER)
    trip, off = latched(run.monitor.trip), run.monitor.power_off_tick
    assert off is not None and TICK * (off - trip.tick) >= LIMITS.follow_time


@given(
    st.floats(0.0, LIMITS.workspace_radius),
    st.floats(0.0, 2.0 * math.pi),
    st.floats(LIMITS.z_min, LIMITS.z_max),
)
def test_the_retraction_raises_the_platform_from_every_pose_of_the_workspace(radius, direction, z):
    p_B = (radius * math.cos(direction), radius * math.sin(direction), z)
    found = retreat(GEOMETRY, BELIEF.N, p_B, LIMITS.retract)
    assert found.slowest > 0.015
    assert found.raised > 0.0105
    assert found.sideways < 0.0105


@pytest.mark.parametrize(
    ("p_B", "raised", "sideways"),
    [
        ((0.0, 0.0, -0.105), 18.48, 0.0),
        ((0.02, 0.02, -0.105), 17.78, 5.27),
        ((0.02, -0.02, -0.105), 17.71, 5.56),
        ((0.02, 0.02, -0.085), 13.98, 6.12),
        ((0.0, 0.04, -0.075), 10.64, 8.99),
    ],
)
def test_the_retraction_raises_as_far_as_the_documentation_says(p_B, raised, sideways):
    found = retreat(GEOMETRY, BELIEF.N, p_B, LIMITS.retract)
    assert isinstance(found, Retreat)
    # two printed decimals
    assert (1e3 * found.raised, 1e3 * found.sideways) == pytest.approx((raised, sideways), abs=0.005)


def workspace() -> list[tuple[float, float, float]]:
    """Poses of a grid over the workspace (m)."""
    grid = np.linspace(-1.0, 1.0, 9)
    heights = np.linspace(LIMITS.z_min, LIMITS.z_max, 13)
    radius = LIMITS.workspace_radius
    return [
        (radius * float(x), radius * float(y), float(z))
        for x in grid for y in grid if math.hypot(x, y) <= 1.0 for z in heights
    ]  # fmt: skip


def test_the_force_limit_deflects_no_spring_as_far_as_its_limit():
    """docs/safety.md: 15 N deflect a spring by at most 17.3 deg."""
    worst = max(press_deflection(BELIEF, p_B, LIMITS.force_limit) for p_B in workspace())
    assert math.degrees(worst) == pytest.approx(17.3, abs=0.05) and worst < LIMITS.deflection_limit


def test_joint_encoders_that_drift_look_like_a_body_that_sinks_slower_than_breath():
    """docs/safety.md: 2 deg/s of all joints are 1.6 to 2.7 mm/s."""
    rates = [-math.radians(2.0) * float(np.linalg.inv(jacobian(GEOMETRY, p_B))[2].sum()) for p_B in workspace()]
    assert (1e3 * min(rates), 1e3 * max(rates)) == pytest.approx((1.6, 2.7), abs=0.05)


def test_a_trip_stays_whatever_comes_after():
    u = standing(600)
    u[100, 0] += 500.0
    seen = watched(u)
    assert latched(seen.trip)[:2] == (100, Reason.JUMP)
    np.testing.assert_array_equal(seen.outputs["tripped"], np.arange(600) >= 100)
    np.testing.assert_array_equal(seen.outputs["omega_ref"][100 + round(0.262 / DT) :], 0.0)
