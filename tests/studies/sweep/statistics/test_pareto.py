"""The front holds exactly the runs that no other beats."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from tests.studies.sweep.statistics.rows import row
from twin.studies.sweep.columns import columns_of
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
    columns = columns_of(rows)
    front = pareto_front(columns, "y", "z")
    assert {columns.run(row) for row in front} == set(range(1, len(pairs) + 1)) - beaten
    assert (np.diff(value(columns, "y")[front]) >= 0.0).all()


def test_runs_without_one_of_the_metrics_are_on_no_front():
    columns = columns_of([row(1, {}, y=1.0), row(2, {}, y=2.0, z=1.0), row(3, {})])
    assert pareto_front(columns, "y", "z").tolist() == [1]
