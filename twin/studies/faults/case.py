"""The cases of a matrix: every kind at each of its magnitudes and each onset."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from twin.errors import InputRefused
from twin.experiment.experiment import Experiment
from twin.experiment.fault import Fault, checked_faults
from twin.experiment.fault_catalogue import CATALOGUE, expected

GLITCH_SHARE = 0.02
"""Of the samples, for kinds that hit a share of them besides having a magnitude: ten a second at 2 ms."""


@dataclass(frozen=True)
class Case:
    """One fault at one time.

    Attributes:
        magnitude: in `unit`, as the catalogue has it; None where the kind has none.
        fault: the same, SI and ticks.
    """

    magnitude: float | None
    fault: Fault


def known_kinds(kinds: Sequence[str]) -> tuple[str, ...]:
    """`kinds`, in the catalogue's order; all of them if none is named.

    Raises:
        InputRefused: one is not in the catalogue.
    """
    for kind in kinds:
        if kind not in CATALOGUE:
            raise InputRefused(f"--kind {kind}: {expected(kind, tuple(CATALOGUE))}")
    return tuple(kind for kind in CATALOGUE if not kinds or kind in kinds)


def cases(
    experiment: Experiment, kinds: Sequence[str], onsets: Sequence[float], duration: float | None
) -> tuple[Case, ...]:
    """kinds x magnitudes x onsets, each on the kind's first target.

    Args:
        onsets: (s).
        duration: of each fault (s); None: to the end.

    Raises:
        InputRefused: an onset or the duration is not one of this experiment.
    """
    end = experiment.duration_ticks * experiment.cosim.tick
    for onset in onsets:
        if not 0.0 <= onset < end:
            raise InputRefused(f"--onset {onset:g}: outside the experiment; expected 0 <= S < {end:g}")
    if duration is not None and not duration > 0.0:
        raise InputRefused(f"--duration {duration:g}: a fault lasts longer than 0 s; without it, to the end")
    return tuple(
        Case(magnitude, _fault(experiment, kind, magnitude, onset, duration))
        for kind in kinds
        for magnitude in CATALOGUE[kind].magnitudes or (None,)
        for onset in onsets
    )


def _fault(experiment: Experiment, kind: str, magnitude: float | None, onset: float, duration: float | None) -> Fault:
    known = CATALOGUE[kind]
    table: dict[str, Any] = {"kind": kind, "onset_s": onset}
    if duration is not None:
        table["duration_s"] = duration
    if known.magnitude_key:
        table[known.magnitude_key] = magnitude
    if known.has_share:
        table["share"] = GLITCH_SHARE
    mistakes: list[str] = []
    faults = checked_faults((table,), experiment.cosim.tick, mistakes)
    if mistakes:
        raise InputRefused("\n".join(mistakes))
    return faults[0]
