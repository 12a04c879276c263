"""Parameters changed while a run goes on: where they act, from when on, what is written of it, what is refused."""

import json
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest

from tests.laws.runs import shipped
from twin.kernel.cosim.observers import TickEvent
from twin.kernel.errors import InputRefused
from twin.kernel.recording.reader import Recording, read
from twin.kernel.recording.recorder import RowStream
from twin.robot.run.run import SLICE_TICKS, Run, execute
from twin.robot.run.tuning import Tuning
from twin.robot.scene import Scene

REFERENCE = "controller.force.reference_N"
TOUCHING = ("duration_s=2", "contact.height_mm=-85.5")
"""A scale so high that contact begins soon."""


class Knob:
    """A viewer that does `turn` once: when tick `at` is the next, or before the first if that is 0."""

    def __init__(self, turn: Callable[[Tuning], object], at: int = 0):
        self._turn, self._at = turn, at

    def begin(self, streams: Sequence[RowStream], scene: Scene, tick: float, tuning: Tuning) -> None:
        self.tuning = tuning
        if self._at == 0:
            self._turn(tuning)

    def show(self, first: int, rows: np.ndarray, events: Sequence[TickEvent]) -> None:
        if first + len(rows) == self._at:
            self._turn(self.tuning)


def turned(
    folder: Path, knob: Knob, name: str = "fig4_force_position", overrides: Sequence[str] = TOUCHING
) -> tuple[Run, Recording]:
    folder.mkdir()
    run = execute(shipped(name, *overrides), folder, viewer=knob)
    return run, read(run.recording)


@pytest.mark.parametrize(
    ("name", "keys"),
    [
        ("fig4_force_position", ["force.reference_N", "force.kp_mm_per_N", "force.ki_mm_per_N_s", "position.kp_per_s"]),
        # its force loop never acts
        ("fig4_position", ["position.kp_per_s"]),
        # its tasks bring their own forces
        ("pressing", ["force.kp_mm_per_N", "force.ki_mm_per_N_s", "position.kp_per_s"]),
    ],
)
def test_what_can_be_changed_is_what_acts(tmp_path: Path, name: str, keys: list[str]):
    values: dict[str, float] = {}
    run, _ = turned(tmp_path / "x", Knob(lambda tuning: values.update(tuning.values())), name, ())
    assert list(values) == [f"controller.{key}" for key in keys]
    assert not run.changed


@pytest.mark.parametrize(
    ("key", "number"),
    [
        (REFERENCE, 6.5),
        ("controller.force.kp_mm_per_N", 1.1),
        ("controller.force.ki_mm_per_N_s", 7.0),
        ("controller.position.kp_per_s", 2.5),
    ],
)
def test_a_value_changed_before_the_first_tick_gives_the_run_of_an_experiment_that_has_it(
    tmp_path: Path, key: str, number: float
):
    _, changed = turned(tmp_path / "changed", Knob(lambda tuning: tuning.request(key, number)))
    _, written = turned(tmp_path / "written", Knob(lambda tuning: None), overrides=[*TOUCHING, f"{key}={number}"])
    _, before = turned(tmp_path / "before", Knob(lambda tuning: None))
    for signal in ("plant.F_ee_B", "controller.omega_ref", "controller.F_z_ref"):
        assert np.array_equal(changed[signal], written[signal])
    assert not np.array_equal(changed["plant.F_ee_B"], before["plant.F_ee_B"])


def test_gains_of_a_task_can_be_changed_like_those_of_way_points(tmp_path: Path):
    key = "controller.force.kp_mm_per_N"
    _, changed = turned(tmp_path / "changed", Knob(lambda tuning: tuning.request(key, 0.4)), "pressing", ())
    _, written = turned(tmp_path / "written", Knob(lambda tuning: None), "pressing", [f"{key}=0.4"])
    assert np.array_equal(changed["plant.F_ee_B"], written["plant.F_ee_B"])


def test_a_change_acts_from_its_tick_on_and_the_recording_says_so(tmp_path: Path):
    at = 7 * SLICE_TICKS
    run, changed = turned(tmp_path / "changed", Knob(lambda tuning: tuning.request(REFERENCE, 6), at))
    _, plain = turned(tmp_path / "plain", Knob(lambda tuning: None))
    time, force = changed.time("controller"), changed["controller.F_z_ref"]
    assert set(force[time < 0.7]) == {5.0}
    assert set(force[time >= 0.7]) == {6.0}
    earlier = plain.time("plant") < 0.7
    assert np.array_equal(changed["plant.F_ee_B"][earlier], plain["plant.F_ee_B"][earlier])
    (event,) = [event for event in changed.events if event.name == "tuning"]
    assert (event.time, event.level, event.text) == (0.7, "info", f"{REFERENCE}: 5 -> 6 (live)")
    assert event.text in [text for _, _, text in run.events]
    assert run.changed
    assert changed.metadata["changed"]["first"] == event.text
    assert "changed" not in plain.metadata


def test_of_several_wishes_between_two_slices_the_last_counts(tmp_path: Path):
    def turn(tuning: Tuning) -> None:
        for number in (9, 8, 0.1 + 0.2):
            tuning.request(REFERENCE, number)
        assert tuning.values()[REFERENCE] == 0.1 + 0.2

    run, _ = turned(tmp_path / "x", Knob(turn))
    # with every digit, so that it can be repeated
    assert [text for _, _, text in run.events if "live" in text] == [f"{REFERENCE}: 5 -> 0.30000000000000004 (live)"]


def test_a_value_that_is_there_already_is_no_change(tmp_path: Path):
    run, recording = turned(tmp_path / "x", Knob(lambda tuning: tuning.request(REFERENCE, 5)))
    assert not run.changed
    assert "changed" not in recording.metadata


@pytest.mark.parametrize(
    ("key", "number", "said"),
    [
        (REFERENCE, -1.0, "[controller.force] reference_N = -1.0: expected a number > 0"),
        (REFERENCE, 50.5, "[controller.force] reference_N = 50.5: expected a number <= 50"),
        (REFERENCE, 1e308, "expected a number <= 50"),
        ("controller.force.kp_mm_per_N", 1e308, "expected a number <= 1000"),
        ("controller.force.ki_mm_per_N_s", 1e308, "expected a number <= 10000"),
        ("controller.position.kp_per_s", 1e308, "expected a number <= 1000"),
        (REFERENCE, "6", '[controller.force] reference_N = "6": expected a number'),
        (REFERENCE, True, "[controller.force] reference_N = true: expected a number"),
        (REFERENCE, None, f"{REFERENCE}: no value; expected a number"),
        (REFERENCE, float("nan"), "[controller.force] reference_N = nan: expected a finite number"),
        ("controller.force.reference", 6.0, f"did you mean '{REFERENCE}'?"),
        ("plant.k_s", 6.0, "only these can be changed while it runs"),
    ],
)
def test_what_the_schema_refuses_in_a_file_is_refused_here(tmp_path: Path, key: str, number: object, said: str):
    def turn(tuning: Tuning) -> None:
        with pytest.raises(InputRefused) as refused:
            tuning.request(key, number)
        assert said in str(refused.value)

    run, _ = turned(tmp_path / "x", Knob(turn))
    assert not run.changed


def test_with_every_value_at_its_bound_the_numbers_stay_finite(tmp_path: Path):
    bounds = {
        REFERENCE: 50.0,
        "controller.force.kp_mm_per_N": 1000.0,
        "controller.force.ki_mm_per_N_s": 10_000.0,
        "controller.position.kp_per_s": 1000.0,
    }

    def turn(tuning: Tuning) -> None:
        assert tuning.values().keys() == bounds.keys()
        for key, number in bounds.items():
            tuning.request(key, number)

    run, recording = turned(tmp_path / "x", Knob(turn, 10 * SLICE_TICKS))
    assert np.all(np.isfinite(recording["plant.F_ee_B"]))
    # Infinity and NaN are no JSON
    json.loads((tmp_path / "x" / "summary.json").read_text(), parse_constant=pytest.fail)
    assert len([text for _, _, text in run.events if "live" in text]) == len(bounds)


def test_after_the_end_nothing_can_be_changed(tmp_path: Path):
    knob = Knob(lambda tuning: None)
    turned(tmp_path / "x", knob)
    with pytest.raises(InputRefused, match="the run is over"):
        knob.tuning.request(REFERENCE, 6)


def test_a_change_of_the_experiment_acts_within_a_slice_and_is_an_event_of_its_tick(tmp_path: Path):
    changes = "change=[{t_s = 0.734, key = 'controller.force.reference_N', value = 6.0}]"
    run, changed = turned(tmp_path / "changed", Knob(lambda tuning: None), overrides=[*TOUCHING, changes])
    time, force = changed.time("controller"), changed["controller.F_z_ref"]
    assert set(force[time < 0.7335]) == {5.0}
    assert set(force[time > 0.7335]) == {6.0}
    (event,) = [event for event in changed.events if event.name == "tuning"]
    assert (event.time, event.text) == (0.734, f"{REFERENCE}: 5 -> 6")
    # it is part of the experiment: whoever repeats that gets the same run
    assert not run.changed and "changed" not in changed.metadata


def test_a_live_change_after_one_of_the_experiment_tells_what_was_before_it(tmp_path: Path):
    changes = "change=[{t_s = 0.25, key = 'controller.force.reference_N', value = 6.0}]"
    knob = Knob(lambda tuning: tuning.request(REFERENCE, 7), 7 * SLICE_TICKS)
    _, changed = turned(tmp_path / "changed", knob, overrides=[*TOUCHING, changes])
    told = [event.text for event in changed.events if event.name == "tuning"]
    assert told == [f"{REFERENCE}: 5 -> 6", f"{REFERENCE}: 6 -> 7 (live)"]
