"""The whole default matrix of pressing.toml, measured once for all tests; and rows made by hand."""

from collections.abc import Sequence
from functools import cache

from tests.laws.runs import shipped
from twin.studies.faults.cases import cases, known_kinds
from twin.studies.faults.matrix import FaultRow, matrix_rows
from twin.studies.faults.reaction import Reaction
from twin.studies.faults.stage import Stage


def matrix(name: str, *kinds: str, overrides: Sequence[str] = ()) -> list[FaultRow]:
    """Rows of an experiment of experiments/."""
    stage = Stage(shipped(name, *overrides))
    return list(matrix_rows(stage, cases(stage.experiment, known_kinds(kinds), stage.onsets, None)))


@cache
def pressing() -> list[FaultRow]:
    return matrix("pressing")


def felt(peak=8.0, peak_delay=0.0, reason="", seen=None) -> Reaction:
    return Reaction(
        seen=seen, acted=seen, power_off=None, below=0.0, reason=reason, peak=peak, peak_delay=peak_delay, above=0.0,
        impulse=0.0, energy=0.0, left=0.0, end="finished", failure="",
    )  # fmt: skip


def row(kind="breathing", magnitude: float | None = 5.0, watched=None, unwatched=None) -> FaultRow:
    runs = watched or felt(), unwatched or felt()
    return FaultRow(kind, "contact", magnitude, 5.5, True, 15.0, 8.0, *runs)
