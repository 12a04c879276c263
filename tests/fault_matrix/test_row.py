from dataclasses import asdict

import pytest

from tests.fault_matrix.pressing import outcome, row
from twin.fault_matrix.row import Row

BEYOND = 18.1


@pytest.mark.parametrize(("peak", "safe"), [(17.9, True), (BEYOND, False)])
def test_safe_is_up_to_a_fifth_above_the_limit(peak, safe):
    assert row(watched=outcome(peak)).safe == safe
    assert row(unwatched=outcome(peak)).safe_unwatched == safe


def test_a_fault_of_which_yes_is_stated_fails_beyond_the_bound_even_if_unseen():
    assert row("drive_runaway", 0.5, outcome(BEYOND)).fails


def test_one_that_is_seen_if_large_fails_where_it_is_large_or_was_seen():
    seen = outcome(BEYOND, 0.1, "FORCE", 0.2)
    assert row("surface_jump", 5.0, outcome(BEYOND)).fails
    assert row("surface_jump", 2.0, seen).fails
    assert not row("surface_jump", 2.0, outcome(BEYOND)).fails


def test_one_that_cannot_be_seen_fails_only_if_it_was_seen_before_the_worst():
    assert not row("stiffness_change", 10.0, outcome(BEYOND)).fails
    assert not row("stiffness_change", 10.0, outcome(BEYOND, 0.001, "FORCE_RATE", 0.008)).fails
    assert row("stiffness_change", 10.0, outcome(BEYOND, 0.009, "FORCE_RATE", 0.008)).fails


def test_the_catalogue_is_contradicted_by_what_it_misses_and_by_what_it_denies():
    assert not row("drive_runaway", 2.0).as_stated
    assert not row("breathing", 5.0, outcome(8.0, 1.0, "FORCE", 0.5)).as_stated
    assert row("breathing").as_stated
    assert row("drive_runaway", 2.0, outcome(8.0, 0.0, "FOLLOW", 0.1)).as_stated


def test_a_row_survives_being_taken_apart():
    whole = row("surface_jump", 5.0, outcome(17.0, 0.02, "FORCE_RATE", 0.015))
    assert Row.of(asdict(whole)) == whole


def test_facts_carry_their_units_and_the_magnitude_its_catalogues_key():
    facts = row("surface_jump", 5.0).facts()
    assert facts["magnitude_mm"] == 5.0 and facts["limit_N"] == 15.0
    assert facts["with_monitor"]["peak_N"] == 8.0
    assert row("drive_dead", None).facts()["magnitude"] is None
