import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.robot.faults.robot import K_S, START, TICK, Robot, Run, run
from twin.robot.experiment.fault import NO_END_TICK, Fault
from twin.robot.shaft import SHAFT_FRICTION, SHAFT_INERTIA, free_shaft

ONSET, END, LAST = 40, 80, 120
BOTH = pytest.mark.parametrize("three_axes", [False, True])
KINDS = ["drive_runaway", "drive_freewheel", "drive_dead", "joint_jam"]


def shaft(kind: str, drive: int, magnitude: float = 0.0, robot: Robot | None = None, end: int = END) -> np.ndarray:
    """theta_m of the joint as the plant has it, one per tick."""
    return run(Fault(kind, f"drive_{drive}", ONSET, end, magnitude), robot=robot)["plant.seen"][:, drive - 1]


@pytest.mark.slow
@BOTH
def test_a_runaway_turns_at_the_stated_speed_whatever_is_commanded(three_axes):
    speed = np.diff(shaft("drive_runaway", 2, -3.0, Robot(three_axes))) / TICK
    # differences of angles of about 1 rad over a tick
    np.testing.assert_allclose(speed[ONSET:END], -3.0, atol=1e-11)


@BOTH
def test_a_runaway_stops_when_the_power_goes(three_axes):
    speed = np.diff(shaft("drive_runaway", 2, -3.0, Robot(three_axes, power_off=60), NO_END_TICK)) / TICK
    np.testing.assert_allclose(speed[ONSET:60], -3.0, atol=1e-11)
    np.testing.assert_array_equal(speed[60:], 0.0)


@BOTH
@pytest.mark.parametrize("drive", [1, 2, 3])
def test_a_dead_drive_stays_where_it_is(drive, three_axes):
    theta_m = shaft("drive_dead", drive, robot=Robot(three_axes))
    np.testing.assert_array_equal(theta_m[ONSET : END + 1], theta_m[ONSET])


def test_a_jam_lets_the_shaft_turn_up_but_not_further_down_than_it_was():
    down, up = shaft("joint_jam", 1), run()["plant.seen"][:, 0]
    np.testing.assert_array_equal(down[ONSET : END + 1], down[ONSET])
    assert up[END] > up[ONSET]
    # drive 3 goes up until 39 ms, then down until 118 ms: jammed at 20 ms it stops where it was then
    jammed, free = run(Fault("joint_jam", "drive_3", 20))["plant.seen"][:, 2], run()["plant.seen"][:, 2]
    expected = np.where(np.arange(119) < 20, free[:119], np.minimum(free[:119], free[20]))
    # sums of increments of about 1e-3 rad
    np.testing.assert_allclose(jammed[:119], expected, rtol=0.0, atol=1e-14)
    assert jammed[118] == pytest.approx(free[20], abs=1e-14) and free[118] > free[20]
    # and turns back with the drive at once
    np.testing.assert_allclose(np.diff(jammed[118:]), np.diff(free[118:]), rtol=0.0, atol=1e-14)


@BOTH
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("drive", [1, 2, 3])
def test_afterwards_the_drive_is_followed_from_where_the_shaft_is(kind, drive, three_axes):
    robot = Robot(three_axes)
    faulty, clean = shaft(kind, drive, 5.0, robot), run(robot=robot)["plant.seen"][:, drive - 1]
    np.testing.assert_allclose(np.diff(faulty[END:]), np.diff(clean[END:]), atol=1e-14)


@BOTH
@pytest.mark.parametrize("kind", KINDS)
def test_other_drives_turn_as_before(kind, three_axes):
    robot = Robot(three_axes)
    faulty = run(Fault(kind, "drive_2", ONSET, END, 5.0), robot=robot)["plant.seen"]
    np.testing.assert_array_equal(faulty[:, [0, 2]], run(robot=robot)["plant.seen"][:, [0, 2]])


def test_a_free_shaft_begins_with_the_speed_it_had():
    speed = np.diff(shaft("drive_freewheel", 2)) / TICK
    tau_load = run()["plant.tau_load"][ONSET, 1]
    slowed = (speed[ONSET - 1] - TICK * tau_load / SHAFT_INERTIA) / (1.0 + TICK * SHAFT_FRICTION / SHAFT_INERTIA)
    assert speed[ONSET] == pytest.approx(slowed, abs=1e-11)


def test_a_positive_load_turns_a_free_shaft_backwards():
    done = run(Fault("drive_freewheel", "drive_3", 0))
    assert done["plant.tau_load"][0, 2] > 0.0
    assert done["fault_1.omega_m"][5, 0] < 0.0


def oscillation(done: Run) -> np.ndarray:
    """The free shaft on its spring of k_s = 1 N m/rad whose other end stands at 0, solved exactly from its start."""
    rate = SHAFT_FRICTION / (2.0 * SHAFT_INERTIA)
    omega = np.sqrt(K_S / SHAFT_INERTIA - rate**2)
    t = np.arange(len(done.rows)) * TICK
    return START[2] * np.exp(-rate * t) * (np.cos(omega * t) + rate / omega * np.sin(omega * t))


def test_a_free_shaft_swings_on_its_spring_as_the_equation_says():
    done = run(Fault("drive_freewheel", "drive_3", 0), last_tick=300)
    error = done["plant.seen"][:, 2] - oscillation(done)
    # first order in omega h = 0.1: half of it, 0.025 rad of 0.5, and the frequency's (omega h)^2/24 over 30 rad
    assert np.abs(error).max() <= START[2] * (0.5 * 0.1 + 0.1**2 / 24 * 30)


def test_a_free_shaft_on_its_spring_loses_energy_and_never_gains_any():
    # ten thousand steps of 1 ms; friction halves the amplitude in 1.4 s
    done = run(Fault("drive_freewheel", "drive_3", 0), last_tick=10_000)
    peaks = np.abs(done["plant.seen"][:, 2]).reshape(-1)[:10_000].reshape(100, 100).max(axis=1)
    # the largest of six samples per quarter turn misses the true peak by at most cos(0.05)
    assert np.all(peaks[1:] <= peaks[:-1] * 1.002)
    assert peaks[-1] < 0.01 * START[2]


@given(st.floats(0.1, 30.0))
def test_a_free_shaft_is_stable_up_to_the_stated_step(h_ms):
    theta_m, omega_m, largest = 1.0, 0.0, 0.0
    # stable below 20 ms, damped there; friction moves the limit by its own 0.1 per cent
    for _ in range(3000):
        theta_m, omega_m = free_shaft(theta_m, omega_m, K_S * theta_m, h_ms * 1e-3)
        largest = max(largest, abs(theta_m))
        if largest > 1e9:
            break
    if h_ms < 19.0:
        assert largest < 10.0
    if h_ms > 20.5:
        assert largest > 1e9


def test_two_faults_of_one_drive_act_in_the_order_of_the_list():
    runaway, dead = Fault("drive_runaway", "drive_1", 40, 80, 5.0), Fault("drive_dead", "drive_1", 60, 100)
    speed = np.diff(run(runaway, dead)["plant.seen"][:, 0]) / TICK
    np.testing.assert_allclose(speed[40:60], 5.0, atol=1e-11)
    np.testing.assert_array_equal(speed[60:100], 0.0)


def test_jacobi_sees_the_shaft_one_step_later_and_is_otherwise_the_same():
    late = Run(Robot(), [Fault("drive_dead", "drive_1", 500)], LAST, "jacobi")["plant.seen"]
    prompt = Run(Robot(), [], LAST, "jacobi")["plant.seen"]
    np.testing.assert_array_equal(late[2:, 0], prompt[1:-1, 0])
