"""Faults with one cause, and what the monitor does about them; each with the monitor off as its sabotage."""

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from tests.laws.runs import EXPERIMENTS
from twin.kernel.serialise import to_dict
from twin.robot.experiment.experiment import Experiment
from twin.robot.experiment.fault import FAULT_KINDS, Fault
from twin.robot.experiment.together import fault_values
from twin.studies.faults import SetOfFaults
from twin.studies.faults.cases import faults_of
from twin.studies.faults.reaction import Reaction
from twin.studies.faults.stage import Stage, load_stage
from twin.studies.faults.text import combination_result
from twin.studies.faults.together import (
    CombinationRow,
    FaultCombination,
    combination_row,
    common_causes,
    pairs,
)


@cache
def stage(body: str, *settings: str) -> Stage:
    return load_stage(EXPERIMENTS / "pressing.toml", settings, body)


def felt(experiment: Experiment, faults: Sequence[Fault], watched: bool = True) -> Reaction:
    """Return the reaction in a run from the start."""
    return Stage(experiment, share=False).reaction(faults, watched)


def is_largest(one: FaultCombination) -> bool:
    """Whether it is of its kind's largest magnitude, either way, or of a kind without any."""
    assert one.cause is not None
    magnitudes = FAULT_KINDS[one.cause.kind].magnitudes
    return magnitudes is None or abs(one.magnitude or 0.0) == abs(magnitudes[-1])


@cache
def rows(body: str) -> list[CombinationRow]:
    """Of each common cause the largest magnitudes, of both signs, in contact."""
    there = stage(body)
    onset = there.onsets[1]
    wanted = [one for one in common_causes(onset) if is_largest(one)]
    with there:
        return [combination_row(there, one, onset) for one in wanted]


def run_away(experiment: Experiment, onset: float) -> tuple:
    return faults_of(experiment, [fault_values("drive_runaway", "all drives", 8.0, onset)])


@pytest.mark.parametrize(("body", "before", "after"), [("back", 88.8, 12.2), ("shoulder", 93.6, 12.5)])
def test_three_runaway_drives_press_with_a_seventh_of_what_they_did(body: str, before: float, after: float):
    now, then = stage(body), stage(body, "monitor.disobeyed=wait")
    faults = run_away(now.experiment, now.onsets[1])
    new, old = felt(now.experiment, faults), felt(then.experiment, faults)
    # another processor may round
    assert (old.peak, new.peak) == pytest.approx((before, after), rel=0.02)
    assert old.power_off is not None and old.power_off > 0.15
    assert new.power_off == new.seen == old.seen
    assert new.peak == now.ideal_reaction(faults, new.seen or 0.0).peak


@pytest.mark.parametrize(("onset", "before", "after"), [(0.5, 49.4, 15.1), (2.5, 36.3, 20.3)])
def test_encoders_that_drift_together_are_found_by_what_the_motors_feel(onset: float, before: float, after: float):
    now, then = stage("back"), stage("back", "monitor.hidden_force_limit_N=1000")
    faults = faults_of(now.experiment, [fault_values("encoder_drift", "all joint encoders", 2.0, onset)])
    new, old = felt(now.experiment, faults), felt(then.experiment, faults)
    # another processor may round
    assert (old.peak, new.peak) == pytest.approx((before, after), rel=0.02)
    assert now.experiment.monitor is not None and new.reason == "HIDDEN_FORCE"
    assert new.peak < 1.5 * now.experiment.monitor.force_limit < old.peak
    assert new.peak == pytest.approx(now.ideal_reaction(faults, new.seen or 0.0).peak, rel=0.02)


@pytest.mark.parametrize("body", ["scale", "back"])
def test_no_common_cause_does_worse_than_an_ideal_monitor_allows(body: str):
    assert [row for row in rows(body) if row.exceeds_bound] == []


@pytest.mark.parametrize("body", ["scale", "back"])
def test_what_is_expected_to_be_seen_of_common_causes_is(body: str):
    assert [row.faults.name for row in rows(body) if row.misses_detection] == []


def test_with_the_monitor_off_every_common_cause_that_it_sees_fails():
    seen = [row for row in rows("back") if row.expects_detection]
    assert len(seen) > 8
    assert all(replace(row, watched=row.unwatched).fails for row in seen)


def test_with_the_monitor_off_or_late_the_force_of_a_common_cause_goes_beyond_its_bound():
    (row,) = (
        row for row in rows("back") if row.faults.name == "drive_runaway, all drives" and row.faults.magnitude == 8.0
    )
    late = stage("back", "monitor.disobeyed=wait")
    slow = felt(late.experiment, run_away(late.experiment, row.onset))
    assert not row.exceeds_bound
    assert replace(row, watched=slow).exceeds_bound and replace(row, watched=row.unwatched).exceeds_bound


def test_a_bus_that_holds_its_last_command_is_stopped_by_the_power():
    there = stage("back")
    onset = there.onsets[0]
    faults = faults_of(there.experiment, [fault_values("command_held", "bus", 1.0, onset)])
    with_monitor, without = (felt(there.experiment, faults, watched) for watched in (True, False))
    assert with_monitor.reason == "FOLLOW" and with_monitor.peak < 5.0
    assert without.peak > 30.0


def test_a_retraction_that_no_message_shows_ends_without_power():
    """The bus holds the last command, and the encoders' messages are lost: only the power stops the drives."""
    there = stage("back")
    onset = there.onsets[0]
    tables = [fault_values("sample_loss", "encoder", 1.0, onset), fault_values("command_held", "bus", 1.0, onset)]
    run = felt(there.experiment, faults_of(there.experiment, tables))
    monitor = there.experiment.monitor
    assert monitor is not None and run.seen is not None and run.power_off is not None
    blind = monitor.retract / monitor.retract_speed
    assert run.power_off - run.seen == pytest.approx(blind, abs=0.003)
    assert run.peak < 10.0


def holding(torque: float, *settings: str) -> Any:
    there = stage("back", f"drive.unpowered.holding_Nm={torque}", *settings)
    return felt(there.experiment, run_away(there.experiment, there.onsets[1]))


def test_springs_unwind_as_far_as_gears_without_power_yield():
    free, geared, locked = holding(0.0), holding(0.05), holding(10.0)
    # the platform's weight: 2.2 N
    assert free.left == pytest.approx(2.2, abs=0.3)
    assert geared.left < 4.0 < 9.0 < locked.left
    assert free.below is not None and locked.left == pytest.approx(holding(20.0).left)


def test_a_brake_with_the_power_keeps_the_force_and_one_with_a_line_of_its_own_lets_it_go():
    kept = holding(0.0, "drive.unpowered.brake_Nm=0.5")
    released = holding(0.0, "drive.unpowered.brake_Nm=0.5", "drive.unpowered.brake_line=own")
    assert kept.left > 9.0 > 4.0 > released.left


def test_a_healthy_run_has_the_bits_it_has_without_lines_of_power():
    """Nothing is cut, so nothing of the new reaction acts."""
    plain = felt(stage("back").experiment, ())
    assert plain == felt(stage("back", "drive.unpowered.holding_Nm=0.02").experiment, ())
    assert plain == felt(stage("back", "monitor.disobeyed=wait").experiment, ())


def test_one_drive_that_does_not_obey_is_cut_alone_where_each_has_a_line():
    one = stage("back", "drive.unpowered.holding_Nm=10")
    onset = one.onsets[1]
    alone = felt(one.experiment, faults_of(one.experiment, [fault_values("drive_runaway", "drive_1", 8.0, onset)]))
    all_of_them = felt(
        stage("back").experiment, faults_of(one.experiment, [fault_values("drive_runaway", "drive_1", 8.0, onset)])
    )
    assert alone.power_off == all_of_them.power_off
    # the two others lift the platform
    assert alone.left < 0.5 * all_of_them.left


def test_members_of_a_group_lose_the_same_samples():
    there = stage("back")
    kind = {"kind": "encoder_dropout_hold", "onset_s": 1.0, "magnitude_share": 0.2, "seed": 3}
    group = faults_of(there.experiment, [kind | {"target": "all joint encoders"}])
    assert [fault.target for fault in group] == [f"joint_encoder_{i}" for i in (1, 2, 3)]
    assert {fault.table for fault in group} == {1}


def test_what_is_felt_is_what_the_force_says():
    there = stage("back")
    quiet = felt(there.experiment, ())
    assert (quiet.seen, quiet.power_off, quiet.below, quiet.reason) == (None, None, 0.0, "")
    assert 7.5 < quiet.peak < 9.0 and 0.0 <= quiet.energy < 0.2
    # a mean force over the run
    assert 20.0 < quiet.impulse < 13.0 * quiet.peak
    assert np.isfinite(quiet.left)


def row_of(there: Stage, *kinds: str) -> CombinationRow:
    """The worst of the pair of `kinds`, of all its directions, that begins in free motion."""
    onset = there.onsets[0]
    with there:
        found = [combination_row(there, pair, onset) for pair in pairs(onset, kinds)]
    return max(found, key=lambda row: row.watched.peak)


def test_pairs_begin_together_in_every_direction_and_are_judged_by_the_bound_of_common_causes():
    there = stage("scale")
    onset = there.onsets[1]
    both = list(pairs(onset, ("encoder_drift", "belt_slip")))
    assert len(both) == 4 and {table["onset_s"] for pair in both for table in pair.tables} == {onset}
    row = row_of(there, "drive_runaway", "sample_loss")
    assert row.faults.kind is SetOfFaults.PAIRS and not row.expects_detection
    assert row.verdict == "kept" and not row.fails
    far = replace(row, watched=replace(row.watched, peak=1.01 * row.force_bound))
    assert far.verdict == "beyond" and far.fails and to_dict(far)["verdict"] == "beyond"


def test_with_the_monitor_off_a_pair_fails():
    row = row_of(stage("back"), "encoder_stuck", "command_held")
    assert row.verdict == "kept"
    assert replace(row, watched=row.unwatched).verdict == "beyond"


@pytest.mark.parametrize("kinds", [("drive_runaway", "belief_eta"), ("surface_jump", "drive_runaway"), ("brown_out",)])
def test_rows_of_runs_that_share_their_past_are_those_of_runs_from_the_start(kinds: tuple[str, ...]):
    there = stage("back")
    onset = there.onsets[1]
    few = [*common_causes(onset, kinds), *pairs(onset, kinds)][-3:]

    def facts(share: bool) -> list[dict[str, Any]]:
        with Stage(there.experiment, share=share) as runs:
            return [to_dict(combination_row(runs, one, onset)) for one in few]

    assert len(few) == 3 and facts(True) == facts(False)


def test_drives_that_keep_turning_away_slowly_after_the_retraction_lose_their_power():
    """As fast as the retraction, less the follow limit: until it is over they look like drives that obey."""
    tables = [fault_values("drive_runaway", "all drives", -1.27, 0.683)]
    now, then = stage("back").experiment, stage("back", "monitor.disobeyed=wait").experiment
    run, old = felt(now, faults_of(now, tables)), felt(then, faults_of(then, tables))
    assert "left the workspace" in old.failure and old.power_off is None
    assert run.failure == "" and run.power_off is not None and run.seen is not None
    monitor = now.monitor
    assert monitor is not None
    # before the rule of 3 degrees above the end of the retraction they were off their command for the follow time
    up = monitor.retract + math.radians(3.0)
    assert run.power_off - run.seen == pytest.approx(up / 1.27, abs=0.02)


def test_the_table_prints_the_limit_of_each_row_and_how_many_were_detected():
    row = row_of(stage("back"), "surface_jump", "drive_runaway")
    text = combination_result("pressing", [row], [SetOfFaults.PAIRS]).text
    assert text.startswith("pressing  as stated: 1 of 1 case of pairs below their limits.")
    assert f"{int(row.is_detected)} of 1 detected" in " ".join(text.split())
    assert text.splitlines()[-1].endswith(f"{row.force_bound:.1f}")
    many = [replace(row, faults=row.faults._replace(name=f"pair {n}")) for n in range(7)]
    listed = [combination_result("pressing", many, [SetOfFaults.PAIRS], complete).text for complete in (False, True)]
    assert [text.count("  pair ") for text in listed] == [5, 7]
    by_ideal = replace(row, ideal=25.0, watched=replace(row.watched, peak=28.0))
    (marked,) = (line for line in combination_result("pressing", [by_ideal], []).text.splitlines() if "28.0" in line)
    assert marked.startswith("~ ") and marked.endswith("30.0") and by_ideal.verdict == "kept"
    above = replace(row, watched=replace(row.watched, peak=2.0 * row.force_bound))
    assert combination_result("pressing", [above], [SetOfFaults.PAIRS]).text.startswith("pressing  FAILED: 0 of 1")
