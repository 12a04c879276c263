"""Columns say what the rows say, whatever the parts they are made of."""

import time
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from tests.studies.sweep.statistics.rows import row
from twin.studies.sweep.columns import Columns, Row, Words, columns_of, joined, once

VALUES = st.one_of(st.booleans(), st.integers(-3, 3), st.floats(-3.0, 3.0), st.sampled_from(["", "1", "x"]))
TABLES = st.dictionaries(st.sampled_from("abc"), VALUES, max_size=3)
METRICS = st.dictionaries(st.sampled_from(["y", "z"]), st.one_of(st.none(), st.floats(-3.0, 3.0)))
CLAIM = st.fixed_dictionaries({"verdict": st.sampled_from(["holds", "fails"]), "value": st.none() | st.floats(0, 1)})


@st.composite
def rows(draw: st.DrawFn) -> list[Row]:
    """Rows in any order of runs, each with parameters, metrics and claims of its own."""
    return [
        row(run, draw(TABLES), draw(st.sampled_from([None, "one", "other"])), "done", **draw(METRICS))
        | {"claims": draw(st.dictionaries(st.just("trigger_time"), CLAIM)), "curves": draw(st.sampled_from([None, {}]))}
        for run in draw(st.permutations(range(1, draw(st.integers(1, 8)))))
    ]


def typed(values: list[Any]) -> list[tuple[type, Any]]:
    return [(type(value), value) for value in values]


def said(columns: Columns, name: str) -> list[Any]:
    """A column with None where the row has nothing, also where the column is not there."""
    column = columns.of.get(name, Words.of([None] * len(columns)))
    if isinstance(column, Words):
        return typed(list(column))
    return typed([None if np.isnan(number) else number for number in column.tolist()])


@given(rows(), rows())
def test_each_column_is_what_the_rows_say_also_if_they_come_in_parts(first: list[Row], then: list[Row]):
    columns, both = joined([columns_of(first), columns_of(then)]), [*first, *then]
    assert len(columns) == len(both)
    for name in ("drive", "status", "reason", "within_limits", "key"):
        assert said(columns, name) == typed([one[name] for one in both])
    for label in "abc":
        assert said(columns, f"parameters/{label}") == typed([one["parameters"].get(label) for one in both])
    for metric in "yz":
        assert said(columns, f"metrics/{metric}") == typed([one["metrics"].get(metric) for one in both])
    answers = [one["claims"].get("trigger_time", {}) for one in both]
    assert said(columns, "verdicts/trigger_time") == typed([answer.get("verdict") for answer in answers])
    assert said(columns, "values/trigger_time") == typed([answer.get("value") for answer in answers])
    assert list(columns.words("has_metrics")) == [bool(one["metrics"]) for one in both]


@given(rows())
def test_in_the_order_of_runs_every_row_keeps_its_values(some: list[Row]):
    columns, ordered = columns_of(some).by_run(), sorted(some, key=lambda one: one["run"])
    assert [columns.run(n) for n in range(len(columns))] == [one["run"] for one in ordered]
    assert list(columns.words("drive")) == [one["drive"] for one in ordered]


def test_words_are_counted_in_the_order_of_rows_and_those_that_no_row_has_any_more_are_not():
    words = Words.of(["b", "a", None, "b"])
    assert list(words.counts.items()) == [("b", 2), ("a", 1), (None, 1)]
    assert words.at(np.array([1, 2])).counts == {"a": 1, None: 1}
    assert words.are(lambda word: word == "b").tolist() == [True, False, False, True]


def test_what_was_found_out_of_columns_is_not_found_out_again():
    asked = []

    @once
    def length(columns: Columns, more: int) -> int:
        asked.append(more)
        return len(columns) + more

    columns, other = columns_of([row(1, {})]), columns_of([])
    assert [length(columns, 1), length(columns, 1), length(columns, 2), length(other, 1)] == [2, 2, 3, 1]
    assert asked == [1, 2, 1]


def test_two_threads_that_ask_at_once_get_what_one_of_them_found_out():
    asked: list[None] = []

    @once
    def slow(columns: Columns) -> int:
        asked.append(None)
        time.sleep(0.1)
        return len(asked)

    with ThreadPoolExecutor(2) as pool:
        assert list(pool.map(slow, [columns_of([])] * 2)) == [1, 1]
