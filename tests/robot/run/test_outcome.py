"""The force of each task: from the rows of a run, however they are sliced."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

from twin.kernel.recording.reader import Recording, read
from twin.robot.assembly.load import load_experiment
from twin.robot.controller.program import TASK_KINDS, PhaseKind, Press, Tap
from twin.robot.experiment.schema import checked_tasks
from twin.robot.run.hold import HoldRequest
from twin.robot.run.outcome import HeldForces, Tally
from twin.robot.run.run import execute
from twin.studies.metrics.response import rms
from twin.studies.paper.task_run import task_runs

PRESS = {"kind": "press", "point_mm": (0.0, 0.0), "force_N": 8.0, "build_up_s": 1.0, "hold_s": 5.0}
TAP = {
    "kind": "tap", "point_mm": (0.0, 0.0), "force_N": 3.0, "speed_mm_per_s": 50.0, "lift_mm": 2.0, "period_s": 0.5,
    "times": 3,
}  # fmt: skip
TASK_COLUMNS = {"plant.F_ee_B": slice(0, 3), "controller.task": slice(3, 4), "controller.phase": slice(4, 5)}


class TaskSystem:
    """As much of one as the forces of tasks need: 1 ms ticks, five columns, or fewer."""

    tick = 1e-3

    def __init__(self, *without: str):
        self._without = without

    def has_output(self, name: str) -> bool:
        return name in TASK_COLUMNS and name not in self._without

    def columns(self, name: str) -> slice:
        return TASK_COLUMNS[name]


def tasks(*tables: dict[str, Any]) -> tuple[Press | Tap, ...]:
    return cast(tuple[Press | Tap, ...], tuple(checked_tasks(TASK_KINDS, tables, []).values()))


def rows(*spans: tuple[int, PhaseKind, list[float]]) -> np.ndarray:
    """Rows of spans: a task, its phase, the pressing force at each tick."""
    return np.array([(0.0, 0.0, -F_z, task, phase) for task, phase, force in spans for F_z in force])


def held(
    table: np.ndarray, size: int, *asked: dict[str, Any], system: TaskSystem | None = None
) -> tuple[HeldForces, ...]:
    listed = tasks(*asked)
    request = HoldRequest(True, tuple(task.force for task in listed), tuple(task.kind for task in listed))
    tally = Tally(system or TaskSystem(), request)
    for first in range(0, len(table), size):
        tally.on_rows(first, table[first : first + size], [])
    # the errors have tests of their own
    return tuple(replace(one, error=None, mean_error=None, overshoot=None) for one in tally.held_forces)


@pytest.mark.parametrize("size", [1, 3, 100])
def test_the_force_is_that_of_the_phases_that_hold_it_however_rows_are_sliced(size: int):
    table = rows(
        (1, PhaseKind.BUILD_UP, [1.0, 9.0]),
        (1, PhaseKind.HOLD, [7.9, 8.0, 8.1]),
        (1, PhaseKind.RELEASE, [0.0]),
        (2, PhaseKind.PROBE, [5.0]),
        (2, PhaseKind.TAP, [0.0, 2.0]),
        (2, PhaseKind.RISE, [2.9, 0.0]),
        (2, PhaseKind.TAP, [0.0, 3.1]),
        (2, PhaseKind.RISE, [0.5]),
    )
    assert held(table, size, PRESS, TAP, PRESS) == (
        HeldForces(1, "press", 8.0, 0, 7.9, 8.1, 0.002, 0.004),
        # the force of the first touch is none of a tap; a tap's peak may come while it rises
        HeldForces(2, "tap", 3.0, 2, 2.9, 3.1, 0.007, 0.012),
        HeldForces(3, "press", 8.0),
    )


def test_without_tasks_or_a_controller_that_names_them_nothing_is_said():
    assert held(rows((1, PhaseKind.HOLD, [1.0])), 1) == ()
    table = rows((1, PhaseKind.HOLD, [1.0]))
    assert held(table, 1, PRESS, system=TaskSystem("controller.task")) == ()


def test_a_run_says_of_its_taps_what_its_recording_holds(root: Path, tmp_path: Path):
    run = execute(load_experiment(root / "experiments/tapping.toml", []), tmp_path)
    recorded = task_runs(read(run.recording))
    assert [one.taps for one in run.held] == [len(task.taps) for task in recorded] == [10, 10]
    for one, task in zip(run.held, recorded, strict=True):
        assert (one.least, one.largest) == (task.peaks.min(), task.peaks.max())


COLUMNS = {
    "plant.F_ee_B": slice(0, 3), "plant.p_B": slice(3, 6), "controller.p_ref_B": slice(6, 9),
    "controller.triggered": slice(9, 10), "controller.F_z_ref": slice(10, 11),
}  # fmt: skip


class System:
    """As much of one as a tally looks at: 1 ms ticks, eleven columns."""

    tick = 1e-3

    def columns(self, name: str) -> slice:
        return COLUMNS[name]

    def has_output(self, name: str) -> bool:
        return name in COLUMNS


REQUEST = HoldRequest(force_loop=True)


def rows_of(recording: Recording) -> np.ndarray:
    """A run's true signals with the controller's held from its samples to every tick."""
    t = recording.time("plant")
    rows = np.zeros((len(t), 11))
    held = np.searchsorted(recording.time("controller"), t, side="right") - 1
    for name, columns in COLUMNS.items():
        series = np.asarray(recording[name], dtype=float)
        series = series.reshape(len(series), -1)
        rows[:, columns] = series if name.startswith("plant") else series[held]
    return rows


@pytest.mark.parametrize("size", [7, 100, 50_000])
def test_the_outcome_is_that_of_the_recording_however_the_run_is_sliced(force_position: Recording, size: int):
    rows = rows_of(force_position)
    tally = Tally(System(), REQUEST)
    for start in range(0, len(rows), size):
        tally.on_rows(start, rows[start : start + size], [])
    found, F_z, on = tally.outcome, -rows[:, 2], rows[:, 9] > 0
    whole = Tally(System(), REQUEST)
    whole.on_rows(0, rows, [])
    assert found == whole.outcome
    # sums in another order round differently
    assert found.peak == F_z.max() and found.peak_time == pytest.approx(F_z.argmax() * 1e-3, rel=1e-12)
    assert found.end == pytest.approx(F_z[-1000:].mean(), rel=1e-12)
    assert (found.end_x, found.end_y) == pytest.approx(rows[-1000:, 0:2].mean(axis=0), rel=1e-12)
    assert found.force_error == pytest.approx(rms(5.0 - F_z[on]), rel=1e-9)
    error = rows[:, 3:6] - rows[:, 6:9]
    assert found.lateral_error == pytest.approx(rms(np.hypot(error[:, 0], error[:, 1])), rel=1e-9)
    assert found.z_error == pytest.approx(rms(error[:, 2]), rel=1e-9)


def test_a_run_tells_its_outcome_in_its_summary(force_position: Recording):
    outcome = json.loads((force_position.path.parent / "summary.json").read_text())["outcome"]
    # the final true force of the paper's run, 4.88 N
    assert outcome["end"] == pytest.approx(4.88, abs=0.1)


def test_a_tilted_scale_is_seen_in_the_force_along_x(force_position: Recording, imperfect: tuple[Recording, Recording]):
    level, tilted = (
        json.loads((run.path.parent / "summary.json").read_text())["outcome"] for run in (force_position, imperfect[0])
    )
    # 5 N on a slope of 1 degree are 0.087 N across it
    assert level["end_x"] == pytest.approx(0.0, abs=1e-6)
    assert tilted["end_x"] == pytest.approx(-5.0 * np.sin(np.radians(1.0)), abs=0.01)


def test_without_a_force_loop_there_is_no_force_error(position: Recording):
    tally = Tally(System(), REQUEST)
    tally.on_rows(0, rows_of(position), [])
    assert tally.outcome.force_error is None


def tallied(F_z: np.ndarray, on: np.ndarray, size: int = 3):
    """The outcome of a run with this true pressing force (N) and these ticks with the force loop on, 5 N asked for."""
    rows = np.zeros((len(F_z), 11))
    rows[:, 2], rows[:, 9], rows[:, 10] = -F_z, on, 5.0
    tally = Tally(System(), REQUEST)
    for start in range(0, len(rows), size):
        tally.on_rows(start, rows[start : start + size], [])
    return tally.outcome


TOUCH = 1500
TICKS = np.arange(3000)
PRESSED = np.where(TICKS >= TOUCH, 4.0, 0.0)


@pytest.mark.parametrize("size", [3, 5000])
def test_a_force_error_is_counted_from_the_first_touch_on(size: int):
    # 1.4 s of air would make it 3.2 N
    assert tallied(PRESSED, TICKS >= 100, size).force_error == pytest.approx(1.0, rel=1e-12)
    # a contact that is lost again is an error of the force
    lost = np.where(TICKS >= 2000, 0.0, PRESSED)
    expected = np.sqrt((500 * 1.0 + 1000 * 25.0) / 1500)
    assert tallied(lost, TICKS >= 100, size).force_error == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize(
    ("trigger", "early"), [(100, 1.4), (TOUCH - 1, 0.001), (TOUCH, 0.0), (2000, 0.0), (len(TICKS), None)]
)
def test_how_long_the_force_loop_was_on_before_the_first_touch(trigger: int, early: float | None):
    found = tallied(PRESSED, TICKS >= trigger).early_trigger
    assert found == (None if early is None else pytest.approx(early, abs=1e-12))


def test_a_force_loop_that_is_on_and_never_touches_was_early_all_the_time_and_has_no_force_error():
    found = tallied(np.zeros(3000), TICKS >= 1000)
    assert found.early_trigger == pytest.approx(2.0, abs=1e-12) and found.force_error is None
