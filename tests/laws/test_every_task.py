"""What has to hold whenever the shipped tasks are carried out, on the scale and on every body, judged on the truth.

What holds in every experiment is in test_every_experiment.py.
"""

from functools import lru_cache

import numpy as np
import pytest

from tests.laws.runs import EXPERIMENTS, co_simulated, shipped
from twin.robot.assembly.build import plant_parameters
from twin.robot.assembly.load import load_experiment
from twin.robot.controller.program import PhaseKind as Kind
from twin.robot.controller.program import Push, Roll, Tap
from twin.robot.mechanism.geometry import Geometry
from twin.robot.mechanism.kinematics import jacobian
from twin.robot.plant.contact import surface_frame

TASKS = ("massage", "pressing", "pushing", "rolling", "tapping")
BODIES = sorted(path.stem for path in (EXPERIMENTS / "bodies").glob("*.toml"))
SHORT_PUSH = ("task.4.point_mm=[0, 12]", "task.4.to_mm=[0, -12]")
"""At 20 mm from its top the shoulder is too steep for its friction."""
over_every_task = pytest.mark.parametrize("name", TASKS)
over_every_body = pytest.mark.parametrize("body", BODIES)


@lru_cache(maxsize=len(TASKS))
def run_of(name, *overrides):
    experiment = shipped(name, *overrides)
    return experiment, co_simulated(experiment, experiment.duration_ticks * experiment.cosim.tick)


def ticks_of(rows, task, kind):
    """Ticks (n,) in which the `task`, counted from 1, is in its phase `kind`."""
    return np.flatnonzero((rows.held("controller.task") == task) & (rows.held("controller.phase") == kind))


def full_turns(rows, task, rate):
    """Ticks of a circle without the turns that lead into and out of it."""
    ticks = ticks_of(rows, task, Kind.CIRCLE)
    turn = round(1.0 / rate / rows.tick)
    return ticks[turn:-turn]


def rms(values):
    return np.sqrt(np.mean(np.square(values)))


def pressing_force(rows, ticks):
    return -rows["plant.F_ee_B"][ticks, 2]


def test_a_press_holds_8_N():
    experiment, rows = run_of("pressing")
    F_z = pressing_force(rows, ticks_of(rows, 1, Kind.HOLD))
    assert F_z.mean() == pytest.approx(experiment.tasks[0].force, rel=0.05)
    assert F_z.std() < 0.1


@pytest.mark.parametrize("number", [1, 2], ids=["50 mm/s", "100 mm/s"])
def test_taps_reach_3_N_again_and_again(number):
    experiment, rows = run_of("tapping")
    task = experiment.tasks[number - 1]
    assert isinstance(task, Tap)
    ticks = ticks_of(rows, number, Kind.TAP)
    first = ticks[np.diff(ticks, prepend=-2) > 1]
    period = round(task.period / experiment.cosim.tick)
    # the tap after the last one does not exist; a period holds the whole of each
    peaks = np.array([pressing_force(rows, slice(k, k + period - 1)).max() for k in first])
    assert len(peaks) == task.times
    np.testing.assert_array_equal(np.diff(first), period)
    np.testing.assert_allclose(peaks, task.force, rtol=0.2)
    assert peaks.std() / peaks.mean() < 0.05


def test_between_two_taps_the_surface_is_left():
    _, rows = run_of("tapping")
    for number in (1, 2):
        assert np.all(rows["plant.F_n"][ticks_of(rows, number, Kind.WAIT)] == 0.0)


@pytest.mark.parametrize("number", [1, 2], ids=["0.5 Hz", "1 Hz"])
def test_a_roll_keeps_its_force_and_its_radius(number):
    experiment, rows = run_of("rolling")
    task = experiment.tasks[number - 1]
    assert isinstance(task, Roll)
    ticks = full_turns(rows, number, task.rate)
    assert rms(pressing_force(rows, ticks) - task.force) < 0.1
    np.testing.assert_allclose(np.hypot(*rows["plant.p_B"][ticks, :2].T), task.radius, rtol=0.1)


@pytest.mark.parametrize("number", [1, 2, 3], ids=["5 mm/s", "20 mm/s", "40 mm/s"])
def test_a_push_keeps_its_force_and_follows_its_line(number):
    experiment, rows = run_of("pushing")
    task = experiment.tasks[number - 1]
    assert isinstance(task, Push)
    ticks = ticks_of(rows, number, Kind.PUSH)
    assert rms(pressing_force(rows, ticks) - task.force) < 0.15
    # along the line and across it
    error = rows["plant.p_B"][ticks, :2] - rows.held("controller.p_ref_B")[ticks, :2]
    assert rms(np.linalg.norm(error, axis=1)) < 0.5e-3


@over_every_task
def test_no_task_trips_the_monitor_and_all_are_done_in_time(name):
    experiment, rows = run_of(name)
    assert not rows["monitor.tripped"].any()
    assert rows["controller.phase"][-1] == Kind.DONE
    assert rows["controller.task"][-1] == len(experiment.tasks)
    # each task came to its work
    for number, task in enumerate(experiment.tasks, start=1):
        kind = {"press": Kind.HOLD, "tap": Kind.TAP, "roll": Kind.CIRCLE, "push": Kind.PUSH}[task.kind]
        assert len(ticks_of(rows, number, kind)) > 0


@over_every_task
def test_commanded_positions_of_tasks_do_not_jump(name):
    experiment, rows = run_of(name)
    assert experiment.approach is not None
    fastest = max(
        experiment.approach.speed,
        *(task.speed for task in experiment.tasks if isinstance(task, Tap | Push)),
        *(2.0 * np.pi * task.rate * task.radius for task in experiment.tasks if isinstance(task, Roll)),
        0.0,
    )
    step = np.linalg.norm(np.diff(rows["controller.p_cmd_B"], axis=0), axis=1)
    on = rows["controller.triggered"]
    both = on[1:] & on[:-1]
    correction = both * np.abs(np.diff(rows["controller.dp_z"]))
    # rounding: nothing is added where the force loop starts or ends
    assert np.all(step <= fastest * experiment.controller.period + correction + 1e-12)
    # while it acts, it follows an estimate that rounds to 0.05 N, and integrates at most 5 N
    force, period = experiment.controller.force, experiment.controller.period
    assert correction.max() <= force.kp * 0.05 + force.ki * 5.0 * period


@over_every_body
def test_bodies_only_push_and_friction_stays_in_its_cone_about_their_own_normal(body):
    experiment = load_experiment(EXPERIMENTS / "massage.toml", SHORT_PUSH, body=body)
    rows = co_simulated(experiment, 40.0)
    every = slice(None, None, 7)
    parameters = plant_parameters(experiment.plant, experiment.contact)
    p_B, F, F_n = rows["plant.p_B"][every], rows["plant.F_ee_B"][every], rows["plant.F_n"][every]
    moving = "body.s_B" in rows.fields()
    surface = rows["body.s_B"][every] if moving else np.zeros_like(p_B)
    n = np.array([surface_frame(parameters, *point)[3] for point in p_B - surface])
    pressing = -np.einsum("ij,ij->i", F, n)
    # rounding; where a curved body breathes the plant holds the surface's speed over a tick, which leaves the surface
    # 1e-9 m aside: over a radius of 200 mm and below 10 N
    atol = 1e-8 if moving else 1e-12
    np.testing.assert_allclose(pressing, F_n, rtol=0, atol=atol)
    assert pressing.min() >= -atol
    friction = np.linalg.norm(F + pressing[:, None] * n, axis=1)
    assert np.all(friction <= experiment.contact.friction * F_n + atol)
    assert F_n.max() > 7.0
    assert not rows["monitor.tripped"].any()
    assert rows["controller.phase"][-1] == Kind.DONE


def radii(*overrides):
    """Mean radius (m) of each roll of rolling.toml on its full turns, with a drive that does not droop."""
    experiment, rows = run_of("rolling", "drive.parameters.droop=0", *overrides)
    rates = [task.rate for task in experiment.tasks if isinstance(task, Roll)]
    turns = [full_turns(rows, number, rate) for number, rate in enumerate(rates, start=1)]
    return np.array([np.hypot(*rows["plant.p_B"][ticks, :2].T).mean() for ticks in turns])


def predicted_radii(experiment, knows_friction, knows_lag):
    """Radii (m) of the rolls by the linear law of the position loop.

    On a circle r e^(i w t) the friction turns along, F = i mu F_n e^(i w t), and deflects the springs by F/K_xy, seen
    from the platform, with K_xy = k_s N^2 eta (J^T J)_xx (Eq. 20, virtual work). So the motors have to move the
    platform at i w (r - e + F/K_xy), and a first-order drive that is to move so has to be told 1 + i w T as much. It is
    told i w r (+ i w F/K_xy) (exp(i w T)) by the feed-forward, kp e by the position loop, and to give way to the swing
    of F by the damping, gain k_s F/K_xy behind a high-pass: an equation for e.
    """
    c, plant = experiment.controller, experiment.plant
    T = c.feed_forward.lag
    J = jacobian(Geometry(plant.a, plant.b, plant.l_a, plant.l_b), (0.0, 0.0, -0.105))
    K_xy = plant.k_s * plant.N**2 * plant.eta * (J.T @ J)[0, 0]
    found = []
    for task in experiment.tasks:
        w = 2.0 * np.pi * task.rate
        deflection = 1j * experiment.contact.friction * task.force / K_xy
        told = (
            1j * w * (task.radius + (deflection if knows_friction else 0.0)) * (np.exp(1j * w * T) if knows_lag else 1)
        )
        high_pass = 1j * w / (1j * w + 2.0 * np.pi * c.damping.corner)
        told -= c.damping.gain * plant.k_s * deflection * high_pass
        drive = 1.0 + 1j * w * T
        e = (drive * 1j * w * (task.radius + deflection) - told) / (c.position.kp + drive * 1j * w)
        found.append(abs(task.radius - e))
    return np.array(found)


@pytest.mark.parametrize(
    ("knows_friction", "knows_lag"), [(False, True), (True, False), (False, False)], ids=["friction", "lag", "both"]
)
def test_without_feed_forward_a_circle_grows_by_what_friction_and_lag_predict(knows_friction, knows_lag):
    experiment = run_of("rolling", "drive.parameters.droop=0")[0]
    unknown = [] if knows_friction else ["controller.feed_forward.friction=0"]
    unknown += [] if knows_lag else ["controller.feed_forward.lag_ms=0"]
    growth = radii(*unknown) - radii()
    expected = predicted_radii(experiment, knows_friction, knows_lag) - predicted_radii(experiment, True, True)
    assert np.all(expected > 5e-5)
    # sampling, the joints' friction and the springs' own motion are in both radii; 1 % was seen to be left
    np.testing.assert_allclose(growth, expected, rtol=0.03)


def test_with_feed_forward_a_circle_grows_by_what_the_damping_gives_way():
    experiment = run_of("rolling", "drive.parameters.droop=0")[0]
    expected = predicted_radii(experiment, True, True)
    assert np.all((expected > 5.05e-3) & (expected < 5.3e-3))
    # sampling and the joints' friction are not in the law
    np.testing.assert_allclose(radii(), expected, rtol=0, atol=1e-4)
