"""The whole default matrix of pressing.toml, measured once for all tests; and rows made by hand."""

from collections.abc import Sequence
from functools import cache

from tests.laws.runs import shipped
from twin.studies.faults.matrix import FaultOutcome, FaultRow, cases, healthy_trial, known_kinds, matrix_rows, onsets_of


def matrix(name: str, *kinds: str, overrides: Sequence[str] = ()) -> list[FaultRow]:
    """Rows of an experiment of experiments/."""
    experiment = shipped(name, *overrides)
    healthy = healthy_trial(experiment)
    onsets = onsets_of(experiment, healthy, ())
    return list(matrix_rows(experiment, healthy, cases(experiment, known_kinds(kinds), onsets, None)))


@cache
def pressing() -> list[FaultRow]:
    return matrix("pressing")


def outcome(peak=8.0, peak_delay=0.0, reason="", delay=None) -> FaultOutcome:
    return FaultOutcome(peak, peak_delay, 0.0, reason, delay, None, "finished", "")


def row(kind="breathing", magnitude: float | None = 5.0, watched=None, unwatched=None) -> FaultRow:
    runs = watched or outcome(), unwatched or outcome()
    return FaultRow(kind, "contact", magnitude, 5.5, True, 15.0, 8.0, *runs)
