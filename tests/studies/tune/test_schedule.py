"""Gains over the stiffness: where they are looked for, what is told of them, and what is written of them."""

import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.laws.runs import EXPERIMENTS
from twin.kernel.errors import InputRefused
from twin.robot.assembly.load import load_experiment
from twin.robot.run.measures import MeasuredValue
from twin.studies.analyse.stability import stability
from twin.studies.result import TEXT_WIDTH, lay_out
from twin.studies.tune import tuned as search
from twin.studies.tune.prediction import Goals
from twin.studies.tune.schedule import (
    MAX_ERROR_RATIO,
    GainSchedule,
    design_schedule,
    geometric_grid,
    schedule_lines,
    schedule_parts,
    with_schedule,
)
from twin.studies.tune.text import fragment
from twin.studies.tune.tuned import tune_gains

PRESSING = EXPERIMENTS / "pressing.toml"
TWO = (
    "controller.force.schedule=[{stiffness_N_per_m=600,kp_mm_per_N=1.5,ki_mm_per_N_s=18},"
    "{stiffness_N_per_m=1200,kp_mm_per_N=1.2,ki_mm_per_N_s=12}]"
)


@pytest.fixture(scope="module")
def over_two() -> GainSchedule:
    """A schedule of two points, by a search that is short."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(search, "MAX_GENERATIONS", 10)
        base = tune_gains([load_experiment(PRESSING)], Goals(), (600.0, 1200.0))
        return design_schedule(base)


@pytest.mark.parametrize(("low", "high", "count"), [(300.0, 5000.0, 6), (600.0, 1200.0, 2), (600.0, 700.0, 2)])
def test_points_are_at_most_twofold_apart_and_reach_both_ends(low: float, high: float, count: int):
    found = geometric_grid(low, high)
    assert len(found) == count and (found[0], found[-1]) == (low, high)
    # three digits
    assert np.all(np.array(found[1:]) / found[:-1] < 2.01)


@pytest.mark.endurance
def test_on_each_point_the_gains_are_faster_than_one_set_and_the_force_is_held_better(over_two: GainSchedule):
    one = over_two.base.after.gains
    for point in over_two.points:
        assert point.gains.kp == one.kp and all(prediction.stable for prediction in point.predictions)
        # the co-simulation with the drive itself, the estimator and the schedule in it
        assert point.ratio(0) < 0.7
    assert over_two.points[0].gains.force_ki > over_two.points[1].gains.force_ki
    assert over_two.midpoint_predictions[0].stable


@pytest.mark.endurance
def test_a_schedule_that_is_worse_somewhere_is_told(over_two: GainSchedule):
    point = over_two.points[0]
    where, fixed, followed = point.wholes[0]
    assert fixed.numbers and fixed.numbers.force_error and followed.numbers
    fixed_hold = fixed.measures["hold_error"].value or 0.0
    slower = replace(followed.numbers, force_error=1.1 * MAX_ERROR_RATIO * fixed.numbers.force_error)
    looser = replace(followed.numbers, measures={**followed.measures, "hold_error": MeasuredValue(fixed_hold + 0.06)})
    for numbers, sentence in ((slower, "error since the first touch is 116 % of that"), (looser, "hold error")):
        points = [replace(point, wholes=[(where, fixed, replace(followed, numbers=numbers))]), *over_two.points[1:]]
        told = replace(over_two, points=points)
        (doubt,) = told.contradictions
        assert doubt.startswith("touch-down on 600 N/m with velocity_servo") and sentence in doubt
        assert not told.meets_goals and lay_out(schedule_parts(told)).splitlines()[0].endswith(
            "this is the best that was found"
        )


@pytest.mark.endurance
def test_what_is_written_is_an_experiment_with_the_schedule_that_was_tried(over_two: GainSchedule, tmp_path: Path):
    file = tmp_path / "tuned.toml"
    file.write_text(fragment(over_two.base, PRESSING, tmp_path, ()) + schedule_lines(over_two, own_tissue=False))
    tomllib.loads(file.read_text())
    written = load_experiment(file).controller
    tried = with_schedule(over_two.base.experiments[0], over_two.base.after.gains, over_two.points).controller
    for attribute in ("stiffness", "kp", "ki"):
        found, meant = ([getattr(point, attribute) for point in c.force.schedule] for c in (written, tried))
        # six digits
        np.testing.assert_allclose(found, meant, rtol=1e-5)
    assert written.tissue == tried.tissue and written.force.kp == pytest.approx(tried.force.kp, rel=1e-5)


@pytest.mark.endurance
def test_the_text_keeps_to_80_columns(over_two: GainSchedule):
    assert max(map(len, lay_out(schedule_parts(over_two)).splitlines())) <= TEXT_WIDTH


@pytest.mark.endurance
def test_a_schedule_is_no_single_stiffness(over_two: GainSchedule):
    with pytest.raises(InputRefused, match="a schedule needs a range"):
        design_schedule(replace(over_two.base, stiffness=(600.0, 600.0)))


@pytest.mark.parametrize(("asked", "said"), [
    (lambda e: tune_gains([e], Goals()), "twin tune finds one set"),
    (stability, "twin analyse takes one set. For point 1"),
])  # fmt: skip
def test_where_a_schedule_is_in_force_those_who_know_one_set_say_so(asked, said):
    with pytest.raises(InputRefused, match=said):
        asked(load_experiment(PRESSING, ["controller.tissue.dither_N=0.1", TWO]))
