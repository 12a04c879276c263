"""Better, worse and the same are what a reader of the numbers would say."""

import math

from hypothesis import given
from hypothesis import strategies as st

from twin.studies.metrics.better import SAME, Standing, overall, standing

NUMBERS = st.one_of(st.none(), st.floats(0.0, 1e6), st.just(math.inf))
VALUES = st.dictionaries(st.sampled_from("abcdef"), NUMBERS)


def test_less_is_better_and_a_fiftieth_is_the_same():
    found = standing(
        {"a": 1.0, "b": 2.0, "c": 1.0, "d": None, "e": 1.0, "f": 0.0},
        {"a": 2.0, "b": 1.0, "c": 1.0 + 0.9 * SAME, "d": 1.0, "e": math.inf, "f": 1e-12},
    )
    assert found == Standing(better=("a", "e"), worse=("b",), same=("c", "f"))
    assert found.sentence("B", "A") == "B beside A: better in a, e; worse in b; the same in c, f"


@given(VALUES, VALUES)
def test_what_is_better_one_way_round_is_worse_the_other(one: dict[str, float | None], other: dict[str, float | None]):
    there, back = standing(one, other), standing(other, one)
    assert set(there.better) == set(back.worse) and set(there.same) == set(back.same)
    both = {name for name in one if one[name] is not None and other.get(name) is not None}
    assert {*there.better, *there.worse, *there.same} == both


def test_over_several_experiments_it_is_torn_where_they_disagree():
    found = overall([Standing(("a", "b"), ("c",), ("d",)), Standing(("b",), ("a",), ("c", "d"))])
    assert found == Standing(better=("b",), worse=("c",), same=("d",), torn=("a",))
    assert found.sentence("B", "A") == (
        "B beside A: better in b; worse in c; the same in d; now better, now worse in a"
    )


def test_nothing_in_common_is_said_so():
    assert standing({"a": 1.0}, {"b": 1.0}).sentence("B", "A") == "B beside A: no measure that both have"
