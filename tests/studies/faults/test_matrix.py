from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.laws.runs import shipped
from tests.studies.faults.pressing import matrix, pressing
from twin.kernel.errors import InputRefused, SafetyTrip
from twin.robot.experiment import fault
from twin.robot.experiment.fault import FAULT_KINDS, GLITCH_SHARE, NEVER_DETECTED
from twin.robot.run.runs import Outcome
from twin.studies.faults.cases import cases, known_kinds
from twin.studies.faults.matrix import matrix_rows
from twin.studies.faults.onsets import checked_healthy_run, default_onsets, touching
from twin.studies.faults.stage import Stage
from twin.studies.faults.text import _cells, _worst, fault_matrix_result


def test_there_is_a_case_for_every_kind_magnitude_and_onset():
    made = cases(shipped("pressing"), known_kinds(()), (0.5, 5.5), None)
    assert {case.fault.kind for case in made} == set(FAULT_KINDS)
    assert len(made) == 2 * sum(len(known.magnitudes or (None,)) for known in FAULT_KINDS.values())
    assert all(case.fault.end == fault.NO_END_TICK for case in made)


def test_a_case_is_in_si_and_ticks_and_lasts_as_long_as_asked():
    (*_, case) = cases(shipped("pressing"), ("surface_jump",), (2.0,), 0.5)
    assert case.magnitude == 10.0
    assert (case.fault.magnitude, case.fault.onset, case.fault.end) == (10e-3, 2000, 2500)
    assert case.fault.target == FAULT_KINDS["surface_jump"].targets[0]


def test_glitches_hit_the_share_that_the_documentation_states():
    assert {case.fault.share for case in cases(shipped("pressing"), ("encoder_glitch",), (1.0,), None)} == {
        GLITCH_SHARE
    }


def test_kinds_come_in_the_catalogues_order():
    assert known_kinds(("drive_dead", "encoder_bias")) == ("encoder_bias", "drive_dead")


def test_a_misspelt_kind_is_told_with_the_right_one():
    with pytest.raises(InputRefused, match=r"--kind drive_runway: .*did you mean 'drive_runaway'"):
        known_kinds(("drive_runway",))


@pytest.mark.parametrize(
    ("onset", "duration", "told"),
    [
        (13.0, None, r"--onset 13: outside the experiment; expected 0 <= S < 13"),
        (-1.0, None, "--onset -1: outside"),
        (1.0, 0.0, "--duration 0: a fault lasts longer"),
        (1.0005, None, "not a whole number of ticks"),
    ],
)
def test_a_time_that_cannot_be_is_one_sentence(onset, duration, told):
    with pytest.raises(InputRefused, match=told):
        cases(shipped("pressing"), ("surface_jump",), (onset,), duration)


def healthy(force, z) -> Outcome:
    """A run with these forces along y (N) and heights."""
    trace: Any = {
        "plant.F_ee_B": np.outer(force, (0.0, -1.0, 0.0)),
        "plant.p_B": np.outer(z, (0.0, 0.0, 1.0)),
    }
    return Outcome("done", "", trace, None, None, None, True, "", None, 0.0)


def test_onsets_are_the_middles_of_the_descent_and_of_the_longest_contact():
    # rests for 4 ticks, falls from tick 3 on, touches from tick 9 to 11 and from 14 to 20
    z = [5, 5, 5, 5, 4, 3, 2, 1, 0, -1, -1, -1, 0, 0, -1, -1, -1, -1, -1, -1, -1, 0]
    force = [0] * 9 + [1] * 3 + [0] * 2 + [1] * 7 + [0]
    free, contact = default_onsets(healthy(force, z))
    assert free == (3 + 9) // 2
    assert contact == (14 + 21) // 2


def test_a_robot_that_touches_from_the_start_has_both_onsets_too():
    assert default_onsets(healthy([2, 2, 2, 0], [0, 0, 0, 1])) == (0, 1)


def test_a_lighter_touch_than_half_a_newton_is_none():
    assert not touching(healthy([0.4, 0.49], [0, 0])).any()


def test_a_run_without_contact_asks_for_an_onset():
    with pytest.raises(InputRefused, match=r"touches nothing.*--onset S"):
        default_onsets(healthy([0, 0], [1, 0]))


@pytest.mark.slow
def test_the_matrix_of_pressing_is_as_it_was_said_before():
    assert [row for row in pressing() if row.fails] == []


def test_the_bound_is_broken_where_it_was_said_to_be_and_that_is_not_hidden():
    broken = {(row.kind, row.magnitude) for row in pressing() if not row.is_safe}
    assert broken == {
        ("stiffness_change", 3.0),
        ("stiffness_change", 10.0),
        ("surface_jump", 10.0),
        ("belt_slip", -30.0),
    }


SAID = [kind for kind, known in FAULT_KINDS.items() if known.threshold != NEVER_DETECTED and kind != "drive_failure"]
"""Of `drive_failure` no monitor is needed: the run ends."""


@pytest.mark.parametrize("kind", SAID)
def test_with_the_monitor_switched_off_every_kind_that_is_said_to_be_seen_fails(kind):
    said = [row for row in pressing() if row.kind == kind and row.expects_detection]
    assert said and all(replace(row, watched=row.unwatched).fails for row in said)


@pytest.mark.parametrize(
    ("kind", "check"),
    [
        ("encoder_bias", "monitor.jump_limit_rad_per_s=10000"),
        ("sample_delay", "monitor.stale_time_ms=5000"),
        ("drive_dead", "monitor.frozen_time_ms=13000 monitor.follow_time_ms=13000"),
        ("surface_jump", "monitor.force_rate_limit_N_per_s=100000"),
        ("drive_saturation", "monitor.follow_time_ms=13000"),
    ],
)
def test_with_one_check_of_the_monitor_switched_off_a_kind_that_it_sees_fails(kind, check):
    assert any(row.misses_detection for row in matrix("pressing", kind, overrides=check.split()))


@pytest.mark.parametrize("kind", ["stiffness_change", "surface_jump", "belt_slip"])
def test_a_broken_bound_that_was_not_said_fails_unless_an_ideal_monitor_breaks_it_too(kind, monkeypatch):
    monkeypatch.setitem(FAULT_KINDS, kind, replace(FAULT_KINDS[kind], excess_from=None))
    broken = [row for row in pressing() if row.kind == kind and not row.is_safe]
    # the peak is over before the motors could have done anything
    assert broken and all(row.is_unavoidable and not row.fails for row in broken)
    assert all(replace(row, ideal=0.8 * row.watched.peak).fails for row in broken)


def test_an_ideal_monitor_betters_encoders_that_drift_unseen(monkeypatch):
    """Cut at 15 N that force stays; without the look for a hidden one it grows to half as much again."""
    monkeypatch.setitem(FAULT_KINDS, "encoder_drift", replace(FAULT_KINDS["encoder_drift"], excess_from=None))
    unseen = matrix("pressing", "encoder_drift", overrides=["monitor.hidden_force_limit_N=1000"])
    (late,) = (row for row in unseen if not row.is_safe)
    assert late.fails and late.ideal is not None and late.ideal < 15.5 < late.watched.peak


def test_without_the_monitor_the_matrix_is_visibly_worse():
    detectable = [row for row in pressing() if row.expects_detection and not row.expects_excess]
    worst = max(row.watched.peak for row in detectable)
    worst_unwatched = max(row.unwatched.peak for row in detectable)
    # 64 N against 17.5 N were measured
    assert worst_unwatched > 2.0 * worst
    # 6 rows beyond the bound and 14 robots that break, against none
    assert sum(not row.is_safe_without_monitor for row in detectable) >= 4
    ended = [row for row in detectable if row.unwatched.end == "run ended" and row.watched.end != "run ended"]
    assert len(ended) >= 10


def test_the_monitor_makes_no_fault_worse():
    # a retraction may unload the springs with a swing: 0.5 N were never seen
    assert [row for row in pressing() if row.watched.peak > max(row.unwatched.peak, row.healthy_peak) + 0.5] == []


def test_the_catalogue_says_what_the_matrix_shows():
    assert [row for row in pressing() if not row.matches_statement] == []


def test_a_trip_ends_retracted_held_or_without_power_and_nothing_else_does():
    for row in pressing():
        ends = (
            {"retracted", "held", "power off"}
            if row.is_detected and not row.watched.failure
            else {"finished", "run ended"}
        )
        assert row.watched.end in ends


def test_the_same_case_gives_the_same_row():
    first, second = (matrix("pressing", "encoder_dropout_zero", "drive_freewheel") for _ in range(2))
    assert first == second


def test_the_duration_ends_the_fault():
    stage = Stage(shipped("pressing"))
    short, forever = (
        next(matrix_rows(stage, cases(stage.experiment, ("belief_eta",), (4.0,), duration)[-1:]))
        for duration in (0.1, None)
    )
    assert short.watched.peak < forever.watched.peak - 1.0


@pytest.mark.parametrize(("kind", "delay"), [("drive_failure", 0.0), ("encoder_dropout_nan", None)])
def test_a_fault_that_ends_the_run_in_its_very_first_step_has_touched_nobody(kind: str, delay: float | None):
    stage = Stage(shipped("pressing"))
    (row,) = matrix_rows(stage, cases(stage.experiment, (kind,), (0.0,), None)[-1:])
    assert (row.watched.peak, row.watched.seen, row.watched.end) == (0.0, delay, "run ended")


@pytest.mark.parametrize("complete", [False, True])
def test_text_fits_80_columns_and_begins_with_the_verdict(complete: bool):
    lines = fault_matrix_result("pressing", pressing(), Path("x.png"), complete=complete).text.splitlines()
    assert lines[0].startswith("pressing  as stated: 170 of 174 below 18 N")
    assert "plus 20 %, 4 beyond as stated; without the monitor" in " ".join(" ".join(lines).split())
    assert max(map(len, lines)) <= 80


def test_text_has_the_five_kinds_with_the_largest_force_and_every_kind_only_if_complete():
    short, full = (fault_matrix_result("pressing", pressing(), Path("x.png"), complete=c) for c in (False, True))
    assert set(FAULT_KINDS) <= {line.split()[0] for line in full.text.splitlines() if line}
    kinds = [line.split()[0] for line in short.text.splitlines() if line.split(" ")[0] in FAULT_KINDS]
    peaks = {row.kind: row.watched.peak for row, _ in _worst(pressing())}
    assert kinds == sorted(peaks, key=lambda kind: -peaks[kind])[:5]
    assert f"5 of {len(FAULT_KINDS)} kinds; --all prints" in short.text
    assert short.facts == full.facts


@pytest.mark.parametrize("complete", [False, True])
def test_each_row_above_the_bound_has_its_limit_and_the_force_under_an_ideal_monitor(complete: bool):
    text = fault_matrix_result("pressing", pressing(), Path("x.png"), complete=complete).text
    stated = " ".join(text.partition("! above the bound, as expected:")[2].split())
    above = [row for row in pressing() if not row.is_safe]
    assert stated.count("(limit 18 N)") == len(above) == 4
    for row in above:
        assert f"{row.watched.peak:.1f} N (limit 18 N)" in stated and f"; ideal {row.ideal:.1f} N" in stated


def test_a_failure_is_printed_without_complete():
    rows = list(pressing())
    missed = next(i for i, row in enumerate(rows) if row.expects_detection and row.is_detected)
    rows[missed] = replace(rows[missed], watched=replace(rows[missed].watched, reason="", seen=None))
    text = fault_matrix_result("pressing", rows, Path("x.png")).text
    assert "! expected to be detected, and not detected:" in text


def documented(root: Path, title: str) -> dict[str, list[str]]:
    """The cells of a table of docs/faults_reference.md behind `title`, by kind."""
    behind = (root / "docs" / "faults_reference.md").read_text().partition(f"\n{title}\n")[2]
    lines = behind.strip().partition("\n\n")[0].splitlines()
    return {cells[0]: cells for line in lines[2:] if (cells := [c.strip() for c in line.strip("| ").split(" | ")])}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("title", "measured"),
    [
        ("### pressing.toml", pressing),
        ("### rolling.toml", lambda: matrix("rolling", "drive_runaway", "encoder_swap", "surface_jump")),
    ],
)
def test_the_documented_matrix_is_the_measured_one(root: Path, title, measured):
    told = documented(root, title)
    for row, of_kind in _worst(measured()):
        kind, cells = f"`{row.kind}`", [cell or "-" for cell in (*_cells(row, of_kind), row.watched.end)]
        _, worst, onset, peak, without, seen, reason, after, end = told[kind]
        assert [worst, seen, reason, end] == [cells[0], cells[4], cells[5], cells[7]], kind
        # another processor may round, and what swings for seconds shows it
        for stated, got in ((onset, cells[1]), (peak, cells[2]), (without, cells[3]), (after, cells[6])):
            assert stated == got or abs(float(stated) - float(got)) <= 0.05 * float(stated) + 0.1, kind


def test_an_experiment_that_nobody_watches_is_refused_with_what_to_add():
    with pytest.raises(InputRefused, match=r"no safety monitor .* add a table \[monitor\]"):
        checked_healthy_run(shipped("fig4_force_position"))


def test_an_experiment_with_faults_of_its_own_is_refused():
    faulty = shipped("pressing", 'fault=[{kind="drive_dead", onset_s=1.0}]')
    with pytest.raises(InputRefused, match=r"has \[\[fault\]\] tables"):
        checked_healthy_run(faulty)


def test_a_monitor_that_trips_without_any_fault_ends_the_matrix():
    with pytest.raises(SafetyTrip, match="without any fault: safety monitor: the platform moves too fast"):
        checked_healthy_run(shipped("pressing", "monitor.speed_limit_mm_per_s=50"))
