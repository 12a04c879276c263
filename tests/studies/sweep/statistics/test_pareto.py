"""The front holds exactly the runs that no other beats."""

from hypothesis import given
from hypothesis import strategies as st

from tests.studies.sweep.statistics.rows import row
from twin.studies.sweep.statistics.pareto import pareto_front
from twin.studies.sweep.statistics.ranking import value

PAIRS = st.lists(st.tuples(st.integers(0, 6), st.integers(0, 6)), min_size=1, max_size=25)


@given(PAIRS)
def test_a_run_is_on_the_front_if_and_only_if_no_other_beats_it(pairs: list[tuple[int, int]]):
    rows = [row(number, {}, y=float(y), z=float(z)) for number, (y, z) in enumerate(pairs, start=1)]
    beaten = {
        number
        for number, (y, z) in enumerate(pairs, start=1)
        if any(a <= y and b <= z and (a, b) != (y, z) for a, b in pairs)
    }
    front = pareto_front(rows, "y", "z")
    assert {one["run"] for one in front} == set(range(1, len(pairs) + 1)) - beaten
    assert [value(one, "y") for one in front] == sorted(value(one, "y") for one in front)


def test_runs_without_one_of_the_metrics_are_on_no_front():
    rows = [row(1, {}, y=1.0), row(2, {}, y=2.0, z=1.0), row(3, {})]
    assert [one["run"] for one in pareto_front(rows, "y", "z")] == [2]
