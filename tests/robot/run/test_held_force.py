"""The force of each task: from the rows of a run, however they are sliced."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from twin.kernel.recording.reader import read
from twin.robot.assembly.load import load_experiment
from twin.robot.controller.program import TASKS, PhaseKind, Press, Tap
from twin.robot.experiment.task import checked_tasks
from twin.robot.run.held_force import SIGNALS, Held, HeldForce
from twin.robot.run.run import execute
from twin.studies.paper.fig5_measures import task_runs

PRESS = {"kind": "press", "point_mm": (0.0, 0.0), "force_N": 8.0, "build_up_s": 1.0, "hold_s": 5.0}
TAP = {
    "kind": "tap", "point_mm": (0.0, 0.0), "force_N": 3.0, "speed_mm_per_s": 50.0, "lift_mm": 2.0, "period_s": 0.5,
    "times": 3,
}  # fmt: skip
SYSTEM = SimpleNamespace(
    tick=0.001,
    has=lambda name: True,
    columns=lambda name: {"plant.F_ee_B": slice(0, 3), "controller.task": slice(3, 4)}.get(name, slice(4, 5)),
)


def tasks(*tables: dict[str, Any]) -> tuple[Press | Tap, ...]:
    return cast(tuple[Press | Tap, ...], tuple(checked_tasks(TASKS, tables, []).values()))


def rows(*spans: tuple[int, PhaseKind, list[float]]) -> np.ndarray:
    """Rows of spans: a task, its phase, the pressing force at each tick."""
    return np.array([(0.0, 0.0, -F_z, task, phase) for task, phase, force in spans for F_z in force])


def held(table: np.ndarray, size: int, *asked: dict[str, Any]) -> tuple[Held, ...]:
    observer = HeldForce(cast(Any, SYSTEM), tasks(*asked))
    for first in range(0, len(table), size):
        observer.take(first, table[first : first + size], [])
    return observer.held


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
        Held(1, "press", 8.0, 0, 7.9, 8.1, 0.002, 0.004),
        # the force of the first touch is none of a tap; a tap's peak may come while it rises
        Held(2, "tap", 3.0, 2, 2.9, 3.1, 0.007, 0.012),
        Held(3, "press", 8.0),
    )


def test_without_tasks_or_a_controller_that_names_them_nothing_is_said():
    assert held(rows((1, PhaseKind.HOLD, [1.0])), 1) == ()
    silent = SimpleNamespace(tick=0.001, has=lambda name: name != SIGNALS[1], columns=SYSTEM.columns)
    assert HeldForce(cast(Any, silent), tasks(PRESS)).held == ()


def test_a_run_says_of_its_taps_what_its_recording_holds(root: Path, tmp_path: Path):
    run = execute(load_experiment(root / "experiments/tapping.toml", []), tmp_path)
    recorded = task_runs(read(run.recording))
    assert [one.taps for one in run.held] == [len(task.taps) for task in recorded] == [10, 10]
    for one, task in zip(run.held, recorded, strict=True):
        assert (one.least, one.largest) == (task.peaks.min(), task.peaks.max())
