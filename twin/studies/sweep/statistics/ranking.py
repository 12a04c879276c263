"""Runs by a metric: which is better, and which metrics say that at all."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from twin.errors import InputRefused
from twin.studies.sweep.columns import Columns, Numbers, Positions, Words, once
from twin.studies.sweep.measures import METRICS, checked_metric
from twin.studies.sweep.vary import Value

USUAL_METRICS = ("force_error_N", "lateral_error_mm")
UNRANKED = ("end_N", "peak_time_s")
UNRANKED_MEASURES = ("mean", "peak", "steady_state_error", "frequency")
"""Less of these is neither better nor worse: where a force or a signal should end is for its reference to say. Of every
other metric less is better."""

ROUNDING = 12
"""Decimals of a metric: what runs differ by beyond them is the rounding of doubles, and no run is better for it."""


@once
def value(columns: Columns, metric: str) -> Numbers:
    """The number of each run, (n,), a metric or what a claim measured; nan if it has none, because it failed or no
    force was controlled, or it never happened."""
    name = f"metrics/{metric}"
    found = columns.numbers(name) if name in columns.of else np.full(len(columns), np.nan)
    if f"verdicts/{metric}" in columns.of:
        judged = columns.words(f"verdicts/{metric}").are(lambda verdict: verdict is not None)
        found = np.where(judged, columns.numbers(f"values/{metric}"), found)
    return rounded(found)


def rounded(numbers: Numbers) -> Numbers:
    """`numbers` to `ROUNDING` decimals as Python's `round` has them: what is written is the nearest double.

    To scale by a power of ten and back, as numpy does, is exact but where the product, which is rounded, too, comes
    near the middle between two decimals. From 2^13 on doubles are further apart than decimals.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        scaled = numbers * 10.0**ROUNDING
        whole = np.rint(scaled)
        near_middle = np.abs(np.abs(scaled - whole) - 0.5) <= 2.0**-52 * np.abs(scaled)
    coarse = np.abs(numbers) >= 2.0**13
    found = np.where(coarse, numbers, whole / 10.0**ROUNDING)
    doubtful = np.flatnonzero(near_middle & ~coarse)
    found[doubtful] = [round(number, ROUNDING) for number in numbers[doubtful].tolist()]
    return found


def usual_metric(columns: Columns) -> str:
    """What runs are ranked by unless somebody says otherwise: the force error, or where no force was controlled, the
    lateral one."""
    force, lateral = USUAL_METRICS
    controlled = not np.isnan(value(columns, force)).all()
    return force if controlled or not len(columns) else lateral


@once
def metrics_in(columns: Columns) -> list[str]:
    """Names of all metrics that some run has a number for, those of every sweep first."""
    there = {name: ~np.isnan(columns.numbers(column)) for name, column in columns.under("metrics").items()}
    found = sorted((name for name, has in there.items() if has.any()), key=lambda name: int(there[name].argmax()))
    return [name for name in METRICS if name in found] + [name for name in found if name not in METRICS]


def claims_in(columns: Columns) -> list[str]:
    """Keys of the paper's claims that some run was judged by; where there are any, no run is better than another."""
    return list(columns.under("verdicts"))


def checked_rank(option: str, metric: str, known: Sequence[str], claims: Sequence[str] = ()) -> str:
    """`metric` as it was given with `option`.

    Args:
        known: metrics that a run may have.
        claims: whose numbers may be asked for, too; see `claims_in`.

    Raises:
        InputRefused: there is no such metric, or less of it is not better.
    """
    checked_metric(option, metric, [*known, *claims])
    if not claims and _unranked(metric):
        others = ", ".join(name for name in known if not _unranked(name))
        raise InputRefused(f"{option} {metric}: less of it is neither better nor worse; rank by {others}")
    return metric


def _unranked(metric: str) -> bool:
    return metric in UNRANKED or metric.rpartition(".")[2] in UNRANKED_MEASURES


@once
def best(columns: Columns, metric: str) -> Positions:
    """Rows of runs that did not trip and keep the sweep's limits and have the metric, least first; ties in the order of
    rows."""
    numbers = value(columns, metric)
    fit = columns.words("status").are(lambda status: status == "done")
    fit &= columns.words("within_limits").are(lambda kept: kept is not False) & ~np.isnan(numbers)
    (rows,) = fit.nonzero()
    return rows[np.argsort(numbers[rows], kind="stable")]


def parameter(columns: Columns, label: str) -> Numbers:
    """The parameter of each run, (n,); nan where it has no rank: truth values and texts have none."""
    found = columns.of.get(f"parameters/{label}")
    if isinstance(found, Words):
        of_words = [float(word) if _is_number(word) else np.nan for word in found.words]
        return np.array(of_words)[found.codes]
    return np.full(len(columns), np.nan) if found is None else found


def _is_number(parameter: Value | None) -> bool:
    return isinstance(parameter, int | float) and not isinstance(parameter, bool)


def numeric_labels(labels: Sequence[str], columns: Columns) -> list[str]:
    """Parameters that are numbers in some run, in the order given."""
    return [label for label in labels if not np.isnan(parameter(columns, label)).all()]


def drives_in(columns: Columns) -> list[str | None]:
    """The drives of the runs, in the order of these; None is the experiment's own."""
    return list(columns.words("drive").counts)


def of_drive(columns: Columns, drive: str | None) -> NDArray[np.bool_]:
    """Which runs are those of a drive, (n,)."""
    return columns.words("drive").are(lambda name: name == drive)
