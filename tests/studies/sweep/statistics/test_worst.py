"""The worst over a parameter, beside what a plain loop finds."""

from itertools import product
from typing import Any

from hypothesis import given
from hypothesis import strategies as st

from tests.studies.sweep.statistics.rows import kept, row
from twin.studies.sweep.show.parts import Asked, parts
from twin.studies.sweep.statistics.worst import worst_over

SPRINGS, TISSUES, DRIVES = (300.0, 600.0, 900.0), ("back", "belly", "skin"), ("a", "b")
POINTS = list(product(SPRINGS, TISSUES, DRIVES))
LABELS = ("plant.k_s", "contact.body")


@given(st.lists(st.none() | st.floats(0.0, 9.0), min_size=len(POINTS), max_size=len(POINTS)))
def test_each_choice_counts_with_its_worst_run_and_a_failure_is_worse_than_any(errors: list[float | None]):
    metrics: list[dict[str, Any]] = [{} if error is None else {"force_error_N": error} for error in errors]
    rows = [
        row(n, {LABELS[0]: k, LABELS[1]: body}, drive, **of_run)
        for n, ((k, body, drive), of_run) in enumerate(zip(POINTS, metrics, strict=True), start=1)
    ]
    numbers = [float("inf") if error is None else round(error, 12) for error in errors]
    of = dict(zip(POINTS, numbers, strict=True))
    found = worst_over(kept(rows).columns, "force_error_N", LABELS[1], LABELS)
    expected = {(k, drive): max(of[k, body, drive] for body in TISSUES) for k in SPRINGS for drive in DRIVES}
    at = [POINTS[one.row] for one in found]
    assert {(k, drive): one.metric for (k, _, drive), one in zip(at, found, strict=True)} == expected
    assert [one.metric for one in found] == sorted(expected.values())
    assert all(of[point] == one.metric and one.runs == len(TISSUES) for point, one in zip(at, found, strict=True))
    assert sum(one.bad for one in found) == errors.count(None)


def test_it_is_the_first_table_and_says_on_which_tissue():
    errors = {(300.0, "back"): 0.1, (300.0, "belly"): 0.9, (600.0, "back"): 0.4, (600.0, "belly"): 0.3}
    rows = [
        row(n, dict(zip(LABELS, point, strict=True)), force_error_N=error, lateral_error_mm=1.0)
        for n, (point, error) in enumerate(errors.items(), start=1)
    ]
    part = parts(kept(rows), Asked("force_error_N", "lateral_error_mm", 5, LABELS[1]))[0]
    assert part.title == "worst force_error_N over body, least worst first"
    assert part.head == ["k_s", "worst force_error_N", "at body", "runs", "failed"]
    assert part.rows == [["600", "0.4", "back", "2", "-"], ["300", "0.9", "belly", "2", "-"]]
