"""Judgement of a hazard line by its runs; nothing is simulated."""

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from tests.studies.safety import by_hand
from tests.studies.safety.by_hand import LOST_THEN_RUNAWAY, RUNAWAY, FakeStage, felt, hazard, line, run, unseen
from twin.kernel.serialise import to_dict
from twin.studies.safety import evidence
from twin.studies.safety.evidence import add_reference_runs, run_of, tables_of, variant_peaks
from twin.studies.safety.hazards import Cause, Variant


def stage(**values: Any) -> Any:
    return FakeStage(**values)


def test_a_run_is_identified_by_body_settings_faults_and_seed_alone():
    one = run(felt(10.0))
    assert len(one.id) == 12 and one.id == replace(one, watched=None, cause="other", found="draw").id
    others: list[dict[str, Any]] = [{"body": "belly"}, {"settings": ("a=1",)}, {"tables": ()}, {"seed": 1}]
    assert len({one.id, *(replace(one, **other).id for other in others)}) == 5


def test_the_command_repeats_faults_settings_and_body():
    one = run(felt(10.0), settings=("task.1.point_mm=[1,2]",))
    assert one.command("pressing") == (
        "twin run pressing --body back --set 'task.1.point_mm=[1,2]' --set 'fault=[{kind=\"drive_runaway\", "
        'target="all drives", onset_s=5.0, magnitude_rad_per_s=2.0}]\''
    )


def test_the_facts_of_a_run_have_its_origin_and_all_reactions():
    facts = to_dict(run(felt(10.0), unwatched=unseen(30.0), ideal=felt(9.0), found="draw"))
    assert (facts["found"], facts["seed"], facts["fault"][0]["kind"]) == ("draw", 0, "drive_runaway")
    peaks = [facts[key]["peak_N"] for key in ("with_monitor", "without_monitor", "with_ideal_monitor")]
    assert peaks == [10.0, 30.0, 9.0]
    failed = to_dict(run(None, failure="crashed"))
    assert (failed["failure"], failed["with_monitor"]) == ("crashed", None)
    assert json.loads(json.dumps(facts)) == facts


@pytest.mark.parametrize(
    ("key", "reaction", "value"),
    [
        ("limit_N", felt(12.0), 12.0),
        ("limit_kPa", felt(12.0), 40.0),
        ("limit_s", felt(12.0, below=0.7), 0.7),
        ("limit_s", felt(12.0, below=None), math.inf),
    ],
)
def test_a_limit_is_one_of_force_pressure_or_time(key: str, reaction, value: float):
    one = line(run(reaction), of=hazard(key))
    assert one.limited_value(reaction) == pytest.approx(value) and one.value == pytest.approx(value)


def test_the_worst_run_is_that_of_the_largest_limited_quantity_and_of_equal_ones_of_the_largest_force():
    low, high = run(felt(10.0, below=0.2), seed=1), run(felt(15.0, below=0.1), seed=2)
    assert line(low, high).worst is high
    assert line(low, high, of=hazard("limit_s")).worst is low
    equal = run(felt(11.0, below=0.2), seed=3)
    assert line(low, equal, of=hazard("limit_s")).worst is equal
    assert line(run(None), low).worst is low
    assert line(run(None)).worst is None and line(run(None)).value == 0.0


def test_a_line_is_kept_up_to_its_limit_and_fails_with_any_failed_run():
    stated = replace(hazard(), table=hazard().table.model_copy(update={"beyond": "no sensor"}))
    at, above = run(felt(22.5)), run(felt(22.6))
    assert line(at).status == "kept" and line(at, above).status == "exceeded"
    assert line(above, of=stated).status == "exceeded as stated" and line(at, of=stated).status == "kept"
    broken = line(at, run(None), run(None), of=stated)
    assert broken.status == "failed" and len(broken.failed_runs) == 2 and line(at).failed_runs == []
    assert line().status == "failed"


def test_a_requirement_is_kept_by_its_distance():
    assert line(distances={"a": 0.0}).status == "kept"
    assert line(distances={"a": 1.0, "b": -1e-9}).status == "exceeded"
    assert line(run(felt(1.0)), distances={"b": -1.0}).status == "exceeded"


def test_shares_are_counted_by_origin():
    """Of the grid, the draws, and the draws that exceed the limit, or fail, without the monitor."""
    grid = [run(felt(1.0)), run(unseen(1.0)), run(None)]
    search = [run(felt(1.0), found="search")] * 4
    draws = [
        run(unseen(20.0), unwatched=unseen(30.0), found="draw"),
        run(felt(23.0), unwatched=unseen(30.0), found="draw"),
        run(unseen(9.0), unwatched=unseen(0.0, failure="left the workspace"), found="draw"),
        run(unseen(9.0), unwatched=unseen(9.0), found="draw"),
    ]
    one = line(*grid, *search, *draws)
    assert (one.grid_detection, one.search_count, one.draw_detection, one.dangerous_count) == (
        (1, 2),
        4,
        (1, 4),
        (2, 3),
    )


def test_the_facts_of_a_line_have_its_worst_run_shares_and_evidence():
    worst = run(felt(20.0), unwatched=unseen(30.0), found="draw", seed=1)
    one = line(run(felt(1.0)), worst, variants={"clutch": (3.0, 1.0)}, distances={"a": 1.0})
    facts = one.to_dict()
    assert (facts["id"], facts["status"], facts["value"], facts["worst"]) == ("H1", "kept", 20.0, worst.id)
    assert (facts["detected"], facts["runs"], facts["searched"]) == (1, 1, 0)
    assert facts["drawn"]["count"] == facts["drawn"]["of"] == 1 and facts["drawn"]["interval"][1] == 1.0
    assert len(facts["evidence"]) == 2 and facts["variants"] == {"clutch": (3.0, 1.0)}
    assert facts["limit_key"] == "limit_N" and facts["causes"] == ["drive_runaway of all drives"]
    unnoticed = line(run(unseen(1.0), unwatched=unseen(30.0), found="draw")).to_dict()
    assert (unnoticed["drawn"]["count"], unnoticed["drawn"]["of"]) == (0, 1)
    endless = line(run(felt(20.0, below=None)), of=hazard("limit_s")).to_dict()
    assert endless["value"] is None and endless["drawn"] is None and endless["dangerous"] is None


def test_the_tables_of_a_cause_have_its_faults_and_a_seed_only_if_one_is_drawn():
    one, other = tables_of(LOST_THEN_RUNAWAY, (1.0, 2.0), 5.0)
    assert one == {"kind": "sample_loss", "target": "encoder", "onset_s": 5.0, "magnitude_share": 1.0}
    assert (other["magnitude_rad_per_s"], other["onset_s"], "seed" in other) == (2.0, 5.0, False)
    assert [table["seed"] for table in tables_of(LOST_THEN_RUNAWAY, (1.0, 2.0), 5.0, seed=7)] == [7, 7]
    glitch = Cause((("encoder_glitch", "joint_encoder_1"),))
    assert tables_of(glitch, (5.0,), 1.0)[0]["share"] == 0.02


def test_a_drawn_run_is_made_with_the_monitor_and_without_others_with_it_alone():
    there = stage()
    tables = tables_of(RUNAWAY, (4.0,), 5.0)
    grid, draw = run_of(there, RUNAWAY, tables), run_of(there, RUNAWAY, tables, "draw")
    assert grid.watched is not None and grid.watched.peak == 8.0 and grid.unwatched is None
    assert draw.unwatched is not None and draw.unwatched.peak == 24.0
    assert (grid.found, draw.found, grid.cause) == ("grid", "draw", "drive_runaway of all drives")
    assert (grid.body, grid.settings, grid.seed) == ("back", ("seed=3",), 3)
    assert [watched for _, watched in there.asked] == [True, True, False]


def test_the_second_fault_of_an_ordered_cause_is_delayed_after_the_trip_of_the_first():
    there = stage()
    one = run_of(there, LOST_THEN_RUNAWAY, tables_of(LOST_THEN_RUNAWAY, (1.0, 2.0), 5.0), delay=0.2)
    onsets = [table["onset_s"] for table in one.tables]
    assert onsets == [5.0, 5.0 + by_hand.TRIPPED_AFTER + 0.2]
    assert sorted({fault.onset for fault in there.asked[0][0]}) == [5000, 5250]


@pytest.mark.parametrize("fails", ["raises", "the drive crashed"])
def test_a_run_that_fails_is_kept_as_a_failed_one_unless_the_cause_is_a_failure(fails: str):
    one = run_of(stage(fails=fails), RUNAWAY, tables_of(RUNAWAY, (4.0,), 5.0))
    assert one.watched is None and one.failure == "the drive crashed"
    crash = Cause((("drive_failure", "drive_1"),))
    meant = run_of(stage(fails="drive_1 fails"), crash, tables_of(crash, (None,), 5.0))
    assert meant.watched is not None and meant.failure == ""


def test_the_worst_run_is_compared_with_no_monitor_and_with_an_ideal_one():
    there = stage()
    found = add_reference_runs(there, run_of(there, RUNAWAY, tables_of(RUNAWAY, (4.0,), 5.0)))
    assert found.unwatched is not None and found.unwatched.peak == 24.0
    assert found.ideal is not None and (found.ideal.peak, found.ideal.power_off) == (4.0, 0.1)
    # a run without a trip has no ideal one; one that was made without the monitor is not made again
    made = unseen(1.0)
    blind = add_reference_runs(there, run(unseen(8.0), unwatched=made))
    assert blind.ideal is None and blind.unwatched is made
    assert add_reference_runs(there, run(None)).ideal is None


def test_other_hardware_repeats_the_worst_run_and_none_is_a_failure(monkeypatch: pytest.MonkeyPatch):
    loaded: list[tuple] = []

    def load(path: Path, settings: tuple[str, ...], drive: None, body: str) -> Any:
        loaded.append((settings, body))
        return stage(fails="crashed" if "bad=1" in settings else "")

    monkeypatch.setattr(evidence, "load_experiment", load)
    monkeypatch.setattr(evidence, "Stage", lambda experiment, share: experiment)
    monkeypatch.setattr(FakeStage, "cosim", property(lambda self: self.experiment.cosim), raising=False)
    variants = [Variant(name=name, set=(f"{name}=1",), why="w") for name in ("good", "bad")]
    table: Any = type("Table", (), {"variants": variants})
    worst = run(felt(20.0))
    found = variant_peaks(line(run(felt(1.0), seed=9), worst), table, Path("p"), stage())
    assert found == {"good": (4.0, 0.5), "bad": None}
    assert loaded[0] == (("seed=3", "good=1"), "back")
    assert variant_peaks(line(run(None)), table, Path("p"), stage()) == {}
    assert variant_peaks(line(worst), table, Path("p"), None) == {}
