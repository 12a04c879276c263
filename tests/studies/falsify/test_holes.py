"""What a search cannot say is said."""

from tests.studies.falsify.test_search import space
from twin.studies.falsify.space import EarlyEnd, TriedFault, UnviolatedKinds

FIRST, SECOND, THIRD = (TriedFault("drive_dead", f"drive_{i}", onset=500) for i in (1, 2, 3))


def test_places_without_a_run_are_named():
    where = space("drive_dead", "breathing")
    holes = UnviolatedKinds.from_search(where, [FIRST, THIRD, TriedFault("breathing", "contact", 5.0)], {}, ())
    assert [(hole["kind"], hole["target"]) for hole in holes.json_values["not_tried"]] == [("drive_dead", "drive_2")]
    assert holes.not_violated_kinds == ["drive_dead", "breathing"]
    assert "Not tried, 1 place" in holes.lines()[0] and "drive_dead 1 of 3." in " ".join(holes.lines())


def test_a_run_that_a_failure_ended_is_not_kept_and_one_that_was_refused_is_not_tried():
    where = space("drive_dead")
    ended = {SECOND: EarlyEnd(False, "drive_2 failed"), THIRD: EarlyEnd(True, "[[fault]] 1: changes nothing")}
    holes = UnviolatedKinds.from_search(where, [FIRST, SECOND, THIRD], ended, ())
    assert holes.not_violated_kinds == []
    assert [hole["target"] for hole in holes.json_values["not_tried"]] == ["drive_3"]
    told = " ".join(holes.lines())
    assert "judged until then: drive_dead (1 of 3 runs). The first: drive_2 failed" in told
    assert "Refused: drive_dead (1 of 3 runs). The first: [[fault]] 1: changes nothing" in told


def test_of_a_kind_that_violates_nothing_is_left_to_say():
    holes = UnviolatedKinds.from_search(space("drive_dead"), [FIRST], {FIRST: EarlyEnd(False, "")}, {"drive_dead"})
    assert (holes.lines(), holes.not_violated_kinds, holes.json_values["not_tried"]) == ([], [], [])


def test_lines_fit_80_columns():
    holes = UnviolatedKinds.from_search(space(), [], {}, ())
    assert max(map(len, holes.lines())) <= 80
