"""Grid, search and draws of a hazard line, on stages made by hand; nothing is simulated."""

import json
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.studies.safety.by_hand import LOST_THEN_RUNAWAY, RUNAWAY, TRIPPED_AFTER, FakeStage, hazard
from twin.kernel.errors import ComponentFailed, InputRefused
from twin.studies.command import ignore_progress
from twin.studies.faults.together import SECOND_DELAYS
from twin.studies.safety import lines
from twin.studies.safety.evidence import EvidenceRun, run_of, tables_of
from twin.studies.safety.hazards import Cause, Hazard
from twin.studies.safety.lines import _cases, _distance, _make_run, _numbers, draw_runs, line_of, search_runs
from twin.studies.safety.page import magnitude_ranges

AREA = 3e-4


def stages(body: str, point: tuple[float, float]) -> Any:
    return FakeStage(body, point)


def stage(**values: Any) -> Any:
    return FakeStage(**values)


def made(of: Hazard, cause: Cause, numbers: tuple[float, ...], seed: int = 0) -> EvidenceRun:
    found = _make_run(of, stages, stage(), cause, numbers, "draw", seed)
    assert found is not None
    return found[0]


def test_the_grid_has_every_magnitude_direction_and_onset_of_each_cause():
    grid = list(_cases(hazard(causes=(RUNAWAY, Cause(requirement="always a"))), stage()))
    speeds = {sizes[0] for _, sizes, _, _ in grid}
    assert speeds == {0.5, 2.0, 8.0, -0.5, -2.0, -8.0} and {onset for _, _, onset, _ in grid} == {1.0, 5.0}
    assert len(grid) == 12 and {delay for *_, delay in grid} == {0.0}
    ordered = list(_cases(hazard(causes=(LOST_THEN_RUNAWAY,)), stage()))
    # of two faults the largest magnitude alone
    assert len(ordered) == 2 * 2 * len(SECOND_DELAYS) and {delay for *_, delay in ordered} == set(SECOND_DELAYS)
    assert {sizes for _, sizes, _, _ in ordered} == {(1.0, 8.0), (1.0, -8.0)}


def test_the_magnitudes_of_a_line_are_those_of_its_grid_search_and_draws():
    """A second drive may creep."""
    assert magnitude_ranges([hazard(causes=(RUNAWAY,))]) == ["drive_runaway 0.5 to 8 rad/s"]
    both = hazard(causes=(LOST_THEN_RUNAWAY, RUNAWAY, Cause(requirement="always a")))
    assert magnitude_ranges([both]) == ["sample_loss 0.02 to 1", "drive_runaway 0.05 to 8 rad/s"]


def test_numbers_are_time_magnitude_by_ratio_direction_and_delay():
    one = made(hazard(), RUNAWAY, (0.5, 1.0))
    (table,) = one.tables
    assert (table["onset_s"], table["magnitude_rad_per_s"]) == (5.0, 8.0) and "seed" not in table
    # the middle of 0 .. 1 is the smallest magnitude, its ends the largest of either direction
    for number, speed in ((0.5, 0.5), (0.0, -8.0), (0.75, 2.0)):
        (table,) = made(hazard(), RUNAWAY, (0.0, number), seed=4).tables
        assert table["magnitude_rad_per_s"] == speed and table["seed"] == 4
    first, second = made(hazard(), LOST_THEN_RUNAWAY, (0.2, 1.0, 0.5, 0.5)).tables
    assert (first["magnitude_share"], second["magnitude_rad_per_s"]) == (1.0, 0.05)
    assert second["onset_s"] == pytest.approx(first["onset_s"] + TRIPPED_AFTER + 0.5 * SECOND_DELAYS[-1], abs=1e-3)


def test_the_last_two_numbers_move_the_tasks_within_reach_of_the_point():
    of = hazard(reach_mm=10.0)
    found = _make_run(of, stages, stage(offset=(0.0, 0.02)), RUNAWAY, (0.5, 1.0, 1.0, 0.25), "search", 0)
    assert found is not None and found[1] is not None
    assert found[1].offset == pytest.approx((0.0, 0.03), abs=1e-4) and found[0].found == "search"
    there = stage()
    kept = _make_run(of, stages, there, RUNAWAY, (0.5, 1.0, 0.0, 0.0), "search", 0)
    assert kept is not None and kept[1] is there


@pytest.mark.parametrize("problem", [InputRefused("no pose"), ComponentFailed("trips without any fault")])
def test_a_place_that_cannot_be_reached_makes_no_run_and_one_that_fails_a_failed_one(problem: Exception):
    def refused(body: str, point: tuple[float, float]) -> Any:
        raise problem

    found = _make_run(hazard(reach_mm=10.0), refused, stage(), RUNAWAY, (0.5, 1.0, 1.0, 0.25), "draw", 0)
    if isinstance(problem, InputRefused):
        assert found is None
    else:
        assert found is not None and found[1] is None
        assert found[0].watched is None and found[0].failure == "trips without any fault" and found[0].found == "draw"


@pytest.mark.parametrize(("cause", "sizes"), [(RUNAWAY, (2.0,)), (RUNAWAY, (-8.0,)), (LOST_THEN_RUNAWAY, (1.0, 0.2))])
def test_the_numbers_of_a_run_make_it_again(cause: Cause, sizes: tuple[float, ...]):
    there, of = stage(), hazard(causes=(cause,), reach_mm=10.0)
    run = run_of(there, cause, tables_of(cause, sizes, 4.0), delay=0.6)
    numbers = _numbers(run, there, cause, 0.01)
    assert len(numbers) == 3 + len(cause.faults) + cause.ordered and np.all((numbers >= 0.0) & (numbers <= 1.0))
    again = _make_run(of, stages, there, cause, numbers, "search", 0)
    assert again is not None
    for table, other in zip(run.tables, again[0].tables, strict=True):
        assert {k: v for k, v in table.items() if not isinstance(v, float)} == {
            k: v for k, v in other.items() if not isinstance(v, float)
        }
        for key in ("onset_s", "magnitude_rad_per_s", "magnitude_share"):
            # an onset is that of the nearest tick
            assert table.get(key) == pytest.approx(other.get(key), abs=2e-3), key


def test_the_search_ends_near_the_worst_run_and_takes_no_more_than_its_budget():
    of, there = hazard(search=40, reach_mm=10.0), stage()
    worst = run_of(there, RUNAWAY, tables_of(RUNAWAY, (2.0,), 5.0))
    found = [run for run, _ in search_runs(of, stages, there, RUNAWAY, worst, lambda one: one.peak)]
    assert len(found) == 40 and {run.found for run in found} == {"search"}
    peaks = [run.watched.peak for run in found if run.watched]
    times = [run.tables[0]["onset_s"] for run in found]
    # everywhere, then near: the times of the second half are those of a third of the run
    assert max(times[:20]) - min(times[:20]) > 8.0 and max(times[20:]) - min(times[20:]) < 6.5
    assert np.mean(peaks[20:]) > np.mean(peaks[:20]) and max(peaks) > 14.0
    assert any(run.settings == ("seed=3",) for run in found)
    again = [run for run, _ in search_runs(of, stages, there, RUNAWAY, worst, lambda one: one.peak)]
    assert [run.tables for run in again] == [run.tables for run in found]
    other = hazard(search=40, reach_mm=10.0, seed=1)
    assert [r.tables for r, _ in search_runs(other, stages, there, RUNAWAY, worst, lambda one: one.peak)] != [
        run.tables for run in found
    ]


def test_draws_are_of_every_cause_body_point_time_size_and_direction():
    of = hazard(
        causes=(RUNAWAY, LOST_THEN_RUNAWAY, Cause(requirement="always a")), bodies=("back", "belly"),
        points_mm=((0.0, 0.0), (0.0, 10.0)), draws=200, reach_mm=5.0,
    )  # fmt: skip
    found = list(draw_runs(of, stages))
    runs = [run for run, _ in found]
    assert len(runs) == 200 and {run.found for run in runs} == {"draw"}
    assert {run.cause for run in runs} == {str(RUNAWAY), str(LOST_THEN_RUNAWAY)}
    assert {run.body for run in runs} == {"back", "belly"} and len({run.tables[0]["seed"] for run in runs}) == 200
    speeds = [run.tables[-1]["magnitude_rad_per_s"] for run in runs]
    assert min(speeds) < -4.0 and max(speeds) > 4.0 and 0.4 < np.mean(np.array(speeds) > 0.0) < 0.6
    times = [run.tables[0]["onset_s"] for run in runs]
    assert min(times) < 1.0 and max(times) > 9.0 and 4.0 < float(np.mean(times)) < 6.0
    far = [math.hypot(where.offset[0], where.offset[1]) for _, where in found if where and where.offset[1] < 5e-3]
    assert max(far) <= 5e-3 + 1e-4 and 2.5e-3 < float(np.mean(far)) < 4e-3
    assert any(where and where.offset[1] > 6e-3 for _, where in found)
    assert [run.tables for run, _ in draw_runs(of, stages)] == [run.tables for run in runs]
    other = replace(of, table=of.table.model_copy(update={"id": "H2"}))
    assert [run.tables for run, _ in draw_runs(other, stages)] != [run.tables for run in runs]
    assert list(draw_runs(hazard(causes=(Cause(requirement="always a"),), draws=5), stages)) == []


def test_a_body_without_a_healthy_robot_is_not_drawn():
    def one_body(body: str, point: tuple[float, float]) -> Any:
        if body == "belly":
            raise ComponentFailed("trips")
        return FakeStage(body, point)

    found = [run for run, _ in draw_runs(hazard(bodies=("back", "belly"), draws=10), one_body)]
    assert len(found) == 10 and {run.body for run in found} == {"back"}


def test_a_line_has_grid_search_and_draws_and_its_worst_run_is_compared():
    said: list[str] = []
    of = hazard(bodies=("back", "belly"), search=8, draws=6, reach_mm=5.0)
    line, where = line_of(of, stages, AREA, said.append)
    assert said == ["H1: x"] * 2
    assert [sum(run.found == origin for run in line.runs) for origin in ("grid", "search", "draw")] == [24, 8, 6]
    worst = line.worst
    assert worst is not None and worst.watched is not None and where is not None and where.body == worst.body == "belly"
    assert worst.watched.peak == max(run.watched.peak for run in line.runs if run.watched) == 24.0
    assert worst.unwatched is not None and worst.ideal is not None
    others = [run for run in line.runs if run is not worst and run.found != "draw"]
    assert all(run.unwatched is None and run.ideal is None for run in others)
    assert line.head_area == AREA and json.dumps(line.to_dict())


def test_a_stage_that_trips_without_any_fault_is_a_failed_run_of_the_line():
    def one_body(body: str, point: tuple[float, float]) -> Any:
        if body == "belly":
            raise ComponentFailed("trips without any fault")
        return FakeStage(body, point)

    line, where = line_of(hazard(bodies=("back", "belly"), search=0), one_body, AREA, ignore_progress)
    assert line.status == "failed" and where is not None
    assert [(run.cause, run.body, run.failure) for run in line.failed_runs] == [
        ("healthy", "belly", "trips without any fault")
    ]
    nothing, where = line_of(hazard(bodies=("belly",), search=0, draws=3), one_body, AREA, ignore_progress)
    assert len(nothing.runs) == 1 and where is None


def test_a_requirement_is_measured_on_the_healthy_robot_of_each_stage(monkeypatch: pytest.MonkeyPatch):
    def measured(of: Any, formula: str) -> tuple[dict[str, float], list[EvidenceRun]]:
        if of.body == "belly":
            return {}, [EvidenceRun(formula, of.body, of.settings, (), 3, None, failure="no such signal")]
        return {f"{formula} on {of.body}": 1.5}, []

    monkeypatch.setattr(lines, "_distance", measured)
    of = hazard(key="", causes=(Cause(requirement="always a"),), bodies=("back", "belly"))
    line, where = line_of(of, stages, AREA, ignore_progress)
    assert line.distances == {"always a on back": 1.5} and where is None
    assert [run.failure for run in line.failed_runs] == ["no such signal"] and line.status == "failed"


def test_a_distance_names_formula_body_and_offset_and_a_failure_is_a_failed_run(monkeypatch: pytest.MonkeyPatch):
    run = type("Run", (), {"tick": 1e-3, "held": None})

    class Assembled:
        system = None

        def __enter__(self) -> "Assembled":
            return self

        def __exit__(self, *failure: object) -> None: ...

    monkeypatch.setattr(lines, "assemble", lambda experiment: Assembled())
    monkeypatch.setattr(lines, "fields_of", lambda system: {})
    monkeypatch.setattr(lines, "checked_requirement", lambda formula, fields: (formula, "N"))
    monkeypatch.setattr(lines, "run_in_memory", lambda experiment: run)
    monkeypatch.setattr(lines, "distance", lambda formula, tick, held: 2.5)
    assert _distance(stage(), "always a") == ({"always a on back": 2.5}, [])
    assert _distance(stage(offset=(0.0, 0.01)), "always a")[0] == {"always a on back at 0, 10 mm": 2.5}

    def refused(formula: str, fields: object) -> None:
        raise InputRefused("no such signal")

    monkeypatch.setattr(lines, "checked_requirement", refused)
    found, failed = _distance(stage(), "always a")
    assert found == {} and [(one.cause, one.failure, one.watched) for one in failed] == [
        ("always a", "no such signal", None)
    ]
