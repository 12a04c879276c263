from pathlib import Path

import pytest

from tests.fault_matrix.pressing import matrix, pressing
from tests.laws.runs import shipped
from twin.errors import InputRefused, SafetyTrip
from twin.fault_matrix.case import cases
from twin.fault_matrix.matrix import healthy_trial, rows
from twin.faults.catalogue import CATALOGUE
from twin.report.fault_matrix_text import fault_matrix_table, fault_matrix_text

CANNOT_BE_SEEN_IN_TIME = {"stiffness_change"}
"""The only kind that goes beyond the bound; docs/faults.md says why nothing can be done."""


def test_every_fault_that_can_be_seen_stays_below_the_force_limit_plus_a_fifth():
    assert [row for row in pressing() if row.fails] == []


def test_what_goes_beyond_the_bound_is_what_is_there_before_anything_can_be_seen():
    assert {row.kind for row in pressing() if not row.safe} <= CANNOT_BE_SEEN_IN_TIME


def test_without_the_monitor_the_matrix_is_visibly_worse():
    detectable = [row for row in pressing() if row.detectable]
    worst = max(row.watched.peak for row in detectable)
    worst_unwatched = max(row.unwatched.peak for row in detectable)
    # 64 N against 17.6 N were measured
    assert worst_unwatched > 2.0 * worst
    # 4 rows beyond the bound and 14 robots that break, against none
    assert sum(not row.safe_unwatched for row in detectable) >= 4
    ended = [row for row in detectable if row.unwatched.end == "run ended" and row.watched.end != "run ended"]
    assert len(ended) >= 10


def test_the_monitor_makes_no_fault_worse():
    # a retraction may unload the springs with a swing: 0.5 N were never seen
    assert [row for row in pressing() if row.watched.peak > max(row.unwatched.peak, row.healthy_peak) + 0.5] == []


def test_the_catalogue_says_what_the_matrix_shows():
    assert [row for row in pressing() if not row.as_stated] == []


def test_a_trip_ends_retracted_held_or_without_power_and_nothing_else_does():
    for row in pressing():
        ends = (
            {"retracted", "held", "power off"}
            if row.detected and not row.watched.failure
            else {"finished", "run ended"}
        )
        assert row.watched.end in ends


def test_the_same_case_gives_the_same_row():
    first, second = (matrix("pressing", "encoder_dropout_zero", "drive_freewheel") for _ in range(2))
    assert first == second


def test_the_duration_ends_the_fault():
    experiment = shipped("pressing")
    healthy = healthy_trial(experiment)
    short, forever = (
        next(rows(experiment, healthy, cases(experiment, ("belief_eta",), (4.0,), duration)[-1:]))
        for duration in (0.1, None)
    )
    assert short.watched.peak < forever.watched.peak - 1.0


def test_text_fits_80_columns_says_the_verdict_first_and_names_every_kind():
    lines = fault_matrix_text("pressing", pressing()).splitlines()
    assert lines[0].startswith("pressing  PASSED: 158 of 160 cases stay below 18 N")
    assert max(map(len, lines)) <= 80
    assert set(CATALOGUE) <= {line.split()[0] for line in lines if line}


def documented(root: Path, title: str) -> dict[str, list[str]]:
    """The cells of a table of docs/faults.md behind `title`, by kind."""
    behind = (root / "docs" / "faults.md").read_text().partition(f"\n{title}\n")[2]
    lines = behind.strip().partition("\n\n")[0].splitlines()
    return {cells[0]: cells for line in lines[2:] if (cells := [c.strip() for c in line.strip("| ").split(" | ")])}


@pytest.mark.parametrize(
    ("title", "measured"),
    [
        ("### pressing.toml", pressing),
        ("### rolling.toml", lambda: matrix("rolling", "drive_runaway", "encoder_swap", "surface_jump")),
    ],
)
def test_the_documented_matrix_is_the_measured_one(root: Path, title, measured):
    told = documented(root, title)
    for line in fault_matrix_table(measured()).splitlines()[2:]:
        kind, *cells = (cell.strip() for cell in line.strip("| ").split(" | "))
        _, worst, onset, peak, without, seen, reason, after, end = told[kind]
        assert [worst, seen, reason, end] == [cells[0], cells[4], cells[5], cells[7]], kind
        # another processor may round, and what swings for seconds shows it
        for stated, got in ((onset, cells[1]), (peak, cells[2]), (without, cells[3]), (after, cells[6])):
            assert stated == got or abs(float(stated) - float(got)) <= 0.05 * float(stated) + 0.1, kind


def test_an_experiment_that_nobody_watches_is_refused_with_what_to_add():
    with pytest.raises(InputRefused, match=r"no safety monitor .* add a table \[monitor\]"):
        healthy_trial(shipped("fig4_force_position"))


def test_an_experiment_with_faults_of_its_own_is_refused():
    faulty = shipped("pressing", 'fault=[{kind="drive_dead", onset_s=1.0}]')
    with pytest.raises(InputRefused, match=r"has \[\[fault\]\] tables"):
        healthy_trial(faulty)


def test_a_monitor_that_trips_without_any_fault_ends_the_matrix():
    with pytest.raises(SafetyTrip, match="without any fault: safety monitor: the platform moves too fast"):
        healthy_trial(shipped("pressing", "monitor.speed_limit_mm_per_s=50"))
