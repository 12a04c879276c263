"""Single faults of the fault matrix: each kind of the catalogue with each magnitude at each onset."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

from twin.kernel.errors import InputRefused
from twin.robot.experiment.experiment import Experiment
from twin.robot.experiment.fault import FAULT_KINDS, GLITCH_SHARE, Fault, checked_faults, expected_names
from twin.robot.experiment.together import fault_values


@dataclass(frozen=True)
class Case:
    """Cell of the fault matrix: magnitude in the catalogue's unit (None without one), the fault in SI and ticks."""

    magnitude: float | None
    fault: Fault


def known_kinds(kinds: Sequence[str]) -> tuple[str, ...]:
    """Sort the fault `kinds` into the catalogue's order; all kinds of the catalogue if `kinds` is empty."""
    for kind in kinds:
        if kind not in FAULT_KINDS:
            raise InputRefused(f"--kind {kind}: {expected_names(kind, tuple(FAULT_KINDS))}")
    return tuple(kind for kind in FAULT_KINDS if not kinds or kind in kinds)


def cases(
    experiment: Experiment, kinds: Sequence[str], onsets: Sequence[float], duration: float | None
) -> tuple[Case, ...]:
    """List the faults of each kind's first target by magnitude and onset (s); a `duration` of None lasts to the end."""
    end = experiment.duration_ticks * experiment.cosim.tick
    for onset in onsets:
        if not 0.0 <= onset < end:
            raise InputRefused(f"--onset {onset:g}: outside the experiment; expected 0 <= S < {end:g}")
    if duration is not None and not duration > 0.0:
        raise InputRefused(f"--duration {duration:g}: a fault lasts longer than 0 s; without it, to the end")
    found = []
    for kind in kinds:
        known = FAULT_KINDS[kind]
        for magnitude, onset in product(known.magnitudes or (None,), onsets):
            table = with_share(fault_values(kind, known.targets[0], magnitude, onset))
            table |= {} if duration is None else {"duration_s": duration}
            found.append(Case(magnitude, faults_of(experiment, [table])[0]))
    return tuple(found)


def with_share(table: dict[str, Any]) -> dict[str, Any]:
    """Add the share of affected samples to the table of a fault, if its kind has one."""
    return table | ({"share": GLITCH_SHARE} if FAULT_KINDS[table["kind"]].has_share else {})


def faults_of(experiment: Experiment, tables: Sequence[dict[str, Any]]) -> tuple[Fault, ...]:
    """Parse the faults of [[fault]] `tables` for an experiment; raise `InputRefused` for an invalid one."""
    mistakes: list[str] = []
    faults = checked_faults(tuple(tables), experiment.cosim.tick, mistakes)
    if mistakes:
        raise InputRefused("\n".join(mistakes))
    return faults
