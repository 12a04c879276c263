"""A whole study, short, and what it recommends."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.laws.runs import FORCE, shipped
from twin.kernel.serialise import to_dict
from twin.robot.assembly.load import load_experiment
from twin.studies.converge.convergence import CouplingSeries, CouplingStudy, TickPoint, convergence, recommend_coupling
from twin.studies.converge.picture import draw_convergence
from twin.studies.converge.reference import COUPLINGS
from twin.studies.converge.text import convergence_result


@pytest.fixture(scope="module")
def study() -> CouplingStudy:
    return convergence(
        shipped(FORCE, "controller.force.trigger_time_s=0.2", "controller.force.trigger_N=1e9"), duration=1.0
    )


def test_every_coupling_has_the_order_that_is_expected_of_it(study: CouplingStudy):
    assert [one.coupling for one in study.series] == list(COUPLINGS)
    for one in study.series:
        for name in ("theta_m", "p_B"):
            # in the air, with a force loop that comes on there: smooth; an order more or less is far outside
            assert one.orders[name].slope == pytest.approx(one.coupling.expected_order, abs=0.15)
        # nothing touches anything
        assert one.orders["F_z"].slope is None


def test_the_experiments_own_coupling_and_tick_are_among_the_runs(study: CouplingStudy):
    ticks = [point.tick for one in study.series if one.coupling == study.coupling for point in one.points]
    assert study.tick in ticks
    # two ticks make one period of the controller; four would not fit
    assert max(ticks) == 2.0 * study.tick


def test_the_text_is_for_80_columns_and_begins_with_what_can_be_said(study: CouplingStudy):
    text = convergence_result(study, {"picture": "convergence.png"}).text
    assert max(map(len, text.splitlines())) <= 80
    assert text.startswith("fig4_force_position: never presses\n")
    assert "largest error of p_B in um at" in text


def test_nothing_is_recommended_in_the_air_and_nothing_is_amiss(study: CouplingStudy, tmp_path: Path, recwarn):
    assert study.choice is None and study.judged_signal.name == "p_B"
    draw_convergence(study, tmp_path / "picture.png")
    assert not recwarn.list


def test_a_pressing_robot_is_told_what_to_use(tmp_path: Path):
    down = ("reference.p_mm=[[0,0,-101],[0,0,-102],[0,0,-102]]", "reference.t_s=[0,0.2,1]", "duration_s=0.4")
    found = convergence(shipped("fig4_position", *down), tolerance=1e-3)
    assert found.judged_signal.name == "F_z" and found.choice is not None
    assert found.choice.point.errors["F_z"] <= 1e-3
    files = {"picture": "convergence.png"}
    text = convergence_result(found, files).text
    assert max(map(len, text.splitlines())) <= 80
    assert text.startswith(f"fig4_position: use {found.choice.coupling.name} at ")
    draw_convergence(found, tmp_path / "picture.png")
    for tolerance, resolution, why in (
        (1e-3, None, "it keeps the tolerance, too"),
        (1e-4, 1.0, "its error is 0% of a step"),
        (1e-4, None, "be seen: take"),
    ):
        other = replace(found, tolerance=tolerance, resolution=resolution)
        words = " ".join(convergence_result(other, files).text.split())
        assert why in words and f"--set cosim.inputs={found.choice.coupling.inputs}" in words


def test_facts_are_plain_numbers(study: CouplingStudy):
    facts = to_dict(study)
    assert facts["tolerance_N"] == 0.005
    assert len(facts["series"]) == len(COUPLINGS)  # type: ignore[arg-type]


def series(number: int, *errors: float) -> CouplingSeries:
    points = tuple(TickPoint(tick, {"F_z": error}, 1.0) for tick, error in zip((2e-3, 1e-3), errors, strict=True))
    return CouplingSeries(COUPLINGS[number], points, {}, ())


def test_the_longest_tick_that_is_good_enough_is_chosen_and_there_the_simplest_coupling():
    found = recommend_coupling([series(0, 9e-3, 4e-3), series(2, 3e-3, 1e-3), series(3, 2e-3, 1e-3)], 5e-3)
    assert found is not None and (found.coupling, found.point.tick) == (COUPLINGS[2], 2e-3)


def test_an_error_that_is_small_at_one_tick_only_is_no_reason_to_choose_it():
    found = recommend_coupling([series(0, 3e-3, 9e-3), series(2, 9e-3, 3e-3)], 5e-3)
    assert found is not None and (found.coupling, found.point.tick) == (COUPLINGS[2], 1e-3)


def test_a_run_that_failed_is_never_chosen_and_nothing_may_be_good_enough():
    assert recommend_coupling([series(0, np.inf, 6e-3)], 5e-3) is None


def test_a_drive_that_cannot_repeat_steps_leaves_that_coupling_out(root):
    path = root / "experiments" / f"{FORCE}.toml"
    found = convergence(load_experiment(path, ["duration_s=0.1"], drive=str(root / "fmus" / "modelica_dc")))
    assert list(found.left_out) == [COUPLINGS[4].name]
    assert "modelica_dc.fmu: cannot go back" in found.left_out[COUPLINGS[4].name]
    assert len(found.series) == 4
