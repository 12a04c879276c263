"""Drives ranked over the same points: what the points do to all of them drops out."""

import math
from typing import Any

import numpy as np
import pytest

from tests.studies.sweep.statistics.rows import row
from twin.studies.sweep.columns import Columns, Row, columns_of
from twin.studies.sweep.statistics.drives import drive_ranking


def rows_of(values: dict[str, list[float | None]]) -> Columns:
    rows: list[Row] = []
    for drive, numbers in values.items():
        for point, number in enumerate(numbers):
            metrics: dict[str, Any] = {} if number is None else {"y": number}
            rows.append(row(len(rows) + 1, {"a": float(point)}, drive, **metrics))
    return columns_of(rows)


def test_a_small_difference_at_every_point_is_told_from_a_large_spread_over_points():
    points = np.random.default_rng(0).uniform(1.0, 10.0, 40)
    noise = np.random.default_rng(1).normal(0.0, 0.02, 40)
    first, second = drive_ranking(rows_of({"b": list(points + 0.1 + noise), "a": list(points)}), "y")
    assert (first.drive, second.drive) == ("a", "b")
    # the median of 40 differences of 0.1 that scatter by 0.02
    assert second.behind == pytest.approx(0.1, abs=0.02) and second.told_apart
    assert math.isnan(first.behind)


def test_drives_that_differ_by_chance_only_are_not_told_apart():
    rng = np.random.default_rng(3)
    first, second = drive_ranking(rows_of({d: list(rng.normal(5.0, 1.0, 30)) for d in "ab"}), "y")
    assert not second.told_apart
    assert first.best + second.best == pytest.approx(1.0) and second.best > 0.02


def test_equal_drives_share_the_first_place():
    values: list[float | None] = [1.0, 2.0, 3.0]
    scores = drive_ranking(rows_of({"a": values, "b": values}), "y")
    assert [score.best for score in scores] == [0.5, 0.5]
    assert scores[1].behind_interval == (0.0, 0.0) and not scores[1].told_apart


def test_who_fails_ranks_below_who_is_slow_and_nothing_of_it_vanishes():
    scores = drive_ranking(rows_of({"fragile": [0.1, None, 0.1, None], "slow": [5.0, 5.0, 5.0, 5.0]}), "y")
    assert [score.drive for score in scores] == ["slow", "fragile"]
    assert [(score.completed, score.runs) for score in scores] == [(4, 4), (2, 4)]
    # it ranks first only if no draw of four points meets one where it failed: 1 in 16
    assert scores[1].best == pytest.approx(1 / 16, abs=0.02)
    assert scores[1].behind == pytest.approx(-4.9)


def test_points_that_one_drive_has_not_run_yet_are_not_resampled():
    scores = drive_ranking(rows_of({"a": [2.0, 2.0, 0.0], "b": [1.0, 1.0]}), "y")
    assert {score.drive: score.best for score in scores} == {"a": 0.0, "b": 1.0}


def test_the_same_rows_give_the_same_intervals():
    values: dict[str, list[float | None]] = {d: list(np.random.default_rng(ord(d)).normal(5.0, 1.0, 20)) for d in "abc"}
    assert repr(drive_ranking(rows_of(values), "y")) == repr(drive_ranking(rows_of(values), "y"))


def test_drives_without_any_number_are_ranked_last_with_no_number():
    scores = drive_ranking(rows_of({"dead": [None, None], "alive": [1.0, 2.0]}), "y")
    assert scores[1].drive == "dead" and math.isnan(scores[1].median) and math.isnan(scores[1].behind)
    assert drive_ranking(rows_of({"dead": [None], "too": [None]}), "y")[0].completed == 0


def test_what_the_points_are_changes_no_number():
    values = {d: np.random.default_rng(ord(d)).normal(5.0, 1.0, 20) for d in "ab"}
    found = [
        drive_ranking(
            columns_of([
                row(n, {"a": name(float(point)), "b": point % 2 > 0}, drive, y=float(number))
                for drive, numbers in values.items()
                for n, (point, number) in enumerate(enumerate(numbers), start=1)
            ]),
            "y",
        )
        for name in (float, float.__neg__, str)
    ]  # fmt: skip
    assert repr(found[0]) == repr(found[1]) == repr(found[2])
