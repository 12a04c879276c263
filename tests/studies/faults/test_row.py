from dataclasses import replace

import pytest

from tests.studies.faults.pressing import felt, row

BEYOND = 18.1


@pytest.mark.parametrize(("peak", "safe"), [(17.9, True), (BEYOND, False)])
def test_safe_is_up_to_a_fifth_above_the_limit(peak, safe):
    assert row(watched=felt(peak)).is_safe == safe
    assert row(unwatched=felt(peak)).is_safe_without_monitor == safe


SEEN = felt(8.0, 0.0, "FOLLOW", 0.1)


@pytest.mark.parametrize(
    ("kind", "magnitude"), [("drive_runaway", 0.5), ("encoder_bias", 2.0), ("surface_jump", 5.0), ("belt_slip", -30.0)]
)
def test_what_is_said_to_be_seen_and_is_not_fails_however_small_the_force(kind, magnitude):
    assert row(kind, magnitude).misses_detection and row(kind, magnitude).fails
    assert not row(kind, magnitude, SEEN).fails


@pytest.mark.parametrize(
    ("kind", "magnitude"), [("encoder_bias", 0.5), ("surface_jump", 2.0), ("belt_slip", -10.0), ("breathing", 5.0)]
)
def test_what_is_not_said_to_be_seen_may_be_missed_but_stays_below_the_bound(kind, magnitude):
    assert not row(kind, magnitude).fails
    assert row(kind, magnitude, felt(BEYOND)).fails
    # seeing it does not make up for it, nor does it make it count
    assert row(kind, magnitude, felt(BEYOND, 0.1, "FORCE", 0.2)).fails


@pytest.mark.parametrize(("kind", "below", "from_here"), [("encoder_drift", 0.5, 2.0), ("stiffness_change", 1.5, 3.0)])
def test_only_from_the_magnitude_that_was_said_may_the_force_go_beyond_the_bound(kind, below, from_here):
    seen = felt(BEYOND, 0.1, "DEFLECTION", 0.2)
    assert row(kind, below, seen).is_avoidable_excess and row(kind, below, seen).fails
    assert not row(kind, from_here, seen).fails


def test_where_it_begins_counts():
    assert not row("joint_jam", None).fails
    assert replace(row("joint_jam", None), in_contact=False).fails


def test_of_a_fault_that_ends_only_the_bound_is_asked():
    short = replace(row("drive_runaway", 0.5), stays=False)
    assert not short.fails
    assert replace(short, watched=felt(BEYOND)).fails


def test_seeing_in_time_what_was_said_to_be_invisible_is_told():
    assert not row("breathing", 5.0, felt(8.0, 1.0, "FORCE", 0.5)).matches_statement
    assert row("breathing").matches_statement
    assert row("drive_runaway", 2.0, SEEN).matches_statement


def test_facts_carry_their_units_and_the_magnitude_its_catalogues_key():
    facts = row("surface_jump", 5.0).to_dict()
    assert facts["magnitude_mm"] == 5.0 and facts["limit_N"] == 15.0
    assert facts["with_monitor"]["peak_N"] == 8.0
    assert row("drive_dead", None).to_dict()["magnitude"] is None
