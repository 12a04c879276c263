"""The race and the evolution on a robot of which it is known what breaks it."""

from collections.abc import Sequence

import pytest

from twin.experiment.fault_catalogue import CATALOGUE
from twin.studies.falsify.search import Search
from twin.studies.falsify.space import Space, Wrong

TICKS = 13_000
WORST_ONSET = 9_000


def space(*kinds: str, bodies: Sequence[str | None] = (None,)) -> Space:
    return Space({}, [], kinds or tuple(CATALOGUE), TICKS, 0.001, None, bodies, 0)


def share(wrong: Wrong) -> float:
    """Two kinds violate: one everywhere if it is large, and most at one time; one only early."""
    if wrong.kind == "surface_jump":
        assert wrong.magnitude is not None
        return 1.0 - 0.15 * wrong.magnitude + abs(wrong.onset - WORST_ONSET) / TICKS
    if wrong.kind == "encoder_drift":
        return 0.5 if wrong.onset > 2_000 else -0.2
    return 1.0


def searched(runs: int, where: Space | None = None) -> Search:
    search = Search(where or space(), lambda batch: [share(wrong) for wrong in batch], runs, (5_500, 500))
    search.go()
    return search


def test_a_search_makes_as_many_runs_as_it_may_and_none_twice():
    for runs in (32, 40, 106):
        # fewer only where nothing is left to be found out
        assert len(searched(runs).tried) == runs


def test_every_kind_is_tried_before_any_is_tried_again():
    first = list(searched(106).tried)[: len(CATALOGUE)]
    assert [wrong.kind for wrong in first] == list(CATALOGUE)
    assert all(wrong.magnitude == (CATALOGUE[wrong.kind].magnitudes or (None,))[-1] for wrong in first)


def test_what_violates_only_early_is_found_in_the_second_round():
    search = searched(106)
    assert search.worst["encoder_drift"][1] == -0.2
    assert list(search.tried).index(search.worst["encoder_drift"][0]) < 50


def test_runs_that_are_left_go_to_where_it_is_worst():
    few, many = (searched(runs).worst["surface_jump"] for runs in (50, 160))
    assert many[1] < few[1]
    assert many[1] == pytest.approx(-0.5, abs=0.1)
    assert abs(many[0].onset - WORST_ONSET) < abs(few[0].onset - WORST_ONSET)


def test_the_same_search_is_the_same():
    assert searched(106).tried == searched(106).tried


def test_bodies_take_turns_and_the_worst_one_is_found():
    def on_body(batch: Sequence[Wrong]) -> list[float]:
        return [-1.0 if wrong.body == "back" else -0.5 for wrong in batch]

    search = Search(space("breathing", bodies=(None, "back")), on_body, 20, (5_500, 500))
    search.go()
    assert [wrong.body for wrong in search.tried][:2] == [None, "back"]
    assert search.worst["breathing"][0].body == "back"


def test_only_what_is_drawn_at_random_gets_other_seeds():
    seeds = {wrong.seed for wrong in searched(106).tried if wrong.kind == "encoder_drift"}
    assert seeds == {0}
    random = searched(20, space("sample_loss")).tried
    assert len({wrong.seed for wrong in random}) > 3
