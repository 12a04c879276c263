"""The safety monitor of every task, on every drive, with noisy encoders: no fault, no trip."""

import random
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
import pytest

from tests.laws.runs import EXPERIMENTS
from twin.kernel.cosim.observers import simulate
from twin.kernel.errors import InputRefused
from twin.robot.assembly.assemble import assemble
from twin.robot.assembly.load import load_experiment
from twin.robot.experiment.experiment import Experiment
from twin.robot.monitor.component import own_monitor, trip_reason
from twin.robot.run.trace import Trace

TASKS = ("pressing", "tapping", "rolling", "pushing", "massage")
TOO_WEAK = {"xl330"}
"""Its gears stick under the load of a roll although it is commanded to move: up to a trip that is right."""
DRIVES = sorted({path.parent.name for path in EXPERIMENTS.parent.glob("fmus/*/*.fmu")} - TOO_WEAK)
SHORT = ("velocity_servo", "smart_servo", "modelica_dc")
"""The default drive, the one that follows worst, and one of another tool: the others take a minute, in endurance."""
EVERY = [pytest.param(drive, marks=[] if drive in SHORT else pytest.mark.endurance) for drive in DRIVES]

NOISE = ("plant.motor_noise_deg=0.044", "plant.joint_noise_deg=0.022")
"""Standard deviations: half a count of the motors' encoders, a whole one of the joints', which are finer and magnetic.
"""


def use(name: str, drive: str, body: str | None, seed: int) -> float:
    """Largest share of any limit that a run without faults has in use."""
    return utilisation(load_experiment(EXPERIMENTS / f"{name}.toml", (*NOISE, f"seed={seed}"), drive, body))


def utilisation(experiment: Experiment) -> float:
    """The same of one experiment, which is not to trip."""
    run = Trace(only=["monitor.utilisation"])
    with assemble(experiment) as assembly:
        done = simulate(assembly, experiment.duration_ticks, [run])
    assert done.failure is None
    assert own_monitor(done.simulation.system) is not None and trip_reason(done.simulation) == ""
    return float(np.max(run["monitor.utilisation"]))


@pytest.mark.parametrize("name", ["pressing", "tapping", "rolling", "pushing", "massage"])
def test_the_shipped_tasks_use_at_most_the_share_of_a_limit_that_the_page_states(name):
    # docs/safety.md: 0.57, that of pushing.toml
    assert utilisation(load_experiment(EXPERIMENTS / f"{name}.toml")) < 0.57


@pytest.mark.parametrize(
    ("setting", "trips"),
    [
        ("drive.parameters.droop=1.32", False),
        ("drive.parameters.droop=1.5", True),
        ("monitor.drive_droop_rad_per_s_per_Nm=1.5", False),
    ],
)
def test_a_drive_of_more_droop_than_believed_trips_from_two_and_a_half_times_on(setting: str, trips: bool):
    """docs/safety.md: 0.6 rad/s/(N m) are believed; to believe more hides a force, and trips nothing."""
    experiment = load_experiment(EXPERIMENTS / "pressing.toml", (setting,))
    with assemble(experiment) as assembly:
        done = simulate(assembly, experiment.duration_ticks, [])
    assert ("more force than the encoders show" in trip_reason(done.simulation)) is trips


def test_there_are_ten_drives():
    assert len(DRIVES) == 10


@pytest.mark.parametrize("drive", EVERY)
@pytest.mark.parametrize("name", TASKS)
def test_no_fault_no_trip_on_the_scale(name, drive):
    # a tenth of a limit is kept free: 0.85 was seen, the reversal of smart_servo in fast taps
    assert use(name, drive, None, seed=1) < 0.9


@pytest.mark.parametrize("drive", SHORT)
@pytest.mark.parametrize("name", TASKS)
def test_no_fault_no_trip_on_a_thigh(name, drive):
    assert use(name, drive, "thigh", seed=2) < 0.9


BODIES = ("scale", "back", "shoulder", "belly", "upper_arm", "forearm", "thigh", "calf")
ALL_DRIVES = sorted({*DRIVES, *TOO_WEAK})
DRAWN = 1000
"""Healthy runs of `make endurance`; the second tier makes the first `FEW`."""
FEW = 24


class Healthy(NamedTuple):
    """A run of which nothing is wrong."""

    task: str
    drive: str
    body: str
    experiment: Experiment


def healthy(draw: int, drive: str | None = None) -> Healthy:
    """Task, drive and body drawn, shipped gains, 2 to 8 N in each task; friction and noise as in healthy_fleet.toml.

    A body on whose slope friction cannot hold the head there is drawn again.
    """
    rng = random.Random(f"healthy {draw}")
    task, any_drive = rng.choice(TASKS), rng.choice(ALL_DRIVES)
    path = EXPERIMENTS / f"{task}.toml"
    settings = [
        *(f"task.{n}.force_N={rng.uniform(2.0, 8.0):.3f}" for n in range(1, len(load_experiment(path).tasks) + 1)),
        f"plant.joint_friction_Nm={rng.uniform(0.0, 0.02):.4f}",
        f"plant.motor_noise_deg={rng.uniform(0.0, 0.05):.4f}",
        f"plant.joint_noise_deg={rng.uniform(0.0, 0.02):.4f}",
        f"seed={draw}",
    ]
    for body in rng.sample(BODIES, len(BODIES)):
        try:
            experiment = load_experiment(path, settings, drive or any_drive, body)
        except InputRefused as refused:
            assert "friction cannot hold" in str(refused)
            continue
        return Healthy(task, drive or any_drive, body, experiment)
    raise AssertionError("no body holds the head")


def trip_of(run: Healthy) -> str:
    """Why its monitor trips; "" if it does not."""
    with assemble(run.experiment) as assembly:
        done = simulate(assembly, run.experiment.duration_ticks, [])
    assert done.failure is None
    return trip_reason(done.simulation)


def trips(draws: Iterable[int]) -> list[tuple[int, str, str, str, str]]:
    """Of each drawn run that trips number, task, drive, body and reason; of drives that are fit for massage."""
    runs = ((draw, healthy(draw)) for draw in draws)
    found = [(draw, *run[:3], trip_of(run)) for draw, run in runs if run.drive not in TOO_WEAK]
    return [one for one in found if one[-1]]


def test_draws_are_of_every_task_drive_and_body_and_the_same_each_time():
    some = [healthy(draw) for draw in range(100)]
    assert [{run[column] for run in some} for column in range(3)] == [set(TASKS), set(ALL_DRIVES), set(BODIES)]
    again = healthy(7)
    assert again[:3] == some[7][:3] and again.experiment.values == some[7].experiment.values


@pytest.mark.slow
def test_a_few_drawn_healthy_runs_do_not_trip():
    assert trips(range(FEW)) == []


@pytest.mark.endurance
@pytest.mark.parametrize("hundred", range(DRAWN // 100))
def test_no_drawn_healthy_run_trips(hundred: int):
    assert trips(range(100 * hundred, 100 * (hundred + 1))) == []
