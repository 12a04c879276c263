"""Each kind of fault from the catalogue's largest magnitude up to where another rule, or physics, limits it.

`python -m tests.studies.faults.beyond > rows.md` prints the rows of the table of
docs/faults_reference.md: kind, body, magnitude, target, onset, peak, peak under an ideal monitor, reason, runs.
"""

import math
from collections.abc import Iterator
from functools import cache
from typing import NamedTuple

from tests.laws.runs import EXPERIMENTS
from twin.robot.experiment.fault import FAULT_KINDS
from twin.robot.experiment.together import fault_values
from twin.studies.faults.cases import faults_of, with_share
from twin.studies.faults.magnitudes import CLAIMED_SHARE, UPPER_ENDS, UPPER_SHARE, has_two_ways, magnitude_between
from twin.studies.faults.reaction import Reaction
from twin.studies.faults.stage import Stage, load_stage
from twin.studies.faults.text import magnitude_text

BODIES = ("back", "shoulder")
RATIO = 2.0
"""At most, of one magnitude to the next."""


class Tried(NamedTuple):
    """One run: where, what, and what a person feels."""

    target: str
    magnitude: float
    onset: float
    felt: Reaction


@cache
def stage(body: str) -> Stage:
    """Return pressing.toml on a body, default drive, with onsets in free motion, in contact and midway."""
    there = load_stage(EXPERIMENTS / "pressing.toml", body=body)
    free, contact = there.onsets
    there.onsets = (free, round(0.5 * (free + contact), 3), contact)
    return there


def targets(kind: str) -> tuple[str, ...]:
    """The first target of the kind and, where it has any, its groups."""
    return (FAULT_KINDS[kind].targets[0], *FAULT_KINDS[kind].groups)


def magnitudes(kind: str) -> list[float]:
    """From the catalogue's largest to the upper end, evenly by ratio, in either direction."""
    largest, upper = (FAULT_KINDS[kind].magnitudes or (1.0,))[-1], UPPER_ENDS[kind].magnitude
    steps = math.ceil(abs(math.log(upper / largest)) / math.log(RATIO) - 1e-9)
    shares = (
        [CLAIMED_SHARE + (UPPER_SHARE - CLAIMED_SHARE) * step / steps for step in range(steps + 1)]
        if steps
        else [CLAIMED_SHARE]
    )
    ways = (1.0, -1.0) if has_two_ways(kind) else (1.0,)
    return [size for share in shares for way in ways if (size := magnitude_between(kind, way * share, 0.001))]


def run(body: str, kind: str, target: str, magnitude: float, onset: float) -> Reaction:
    there = stage(body)
    return there.reaction(faults_of(there.experiment, [with_share(fault_values(kind, target, magnitude, onset))]))


def ladder(body: str, kind: str) -> Iterator[Tried]:
    """Every magnitude, target and onset."""
    for target in targets(kind):
        for magnitude in magnitudes(kind):
            for onset in stage(body).onsets:
                yield Tried(target, magnitude, onset, run(body, kind, target, magnitude, onset))


def ideal(body: str, kind: str, one: Tried) -> float | None:
    there = stage(body)
    faults = faults_of(there.experiment, [with_share(fault_values(kind, one.target, one.magnitude, one.onset))])
    return None if one.felt.seen is None else there.ideal_reaction(faults, one.felt.seen).peak


def row(body: str, kind: str) -> str:
    """The worst run as a row of the page."""
    tried = list(ladder(body, kind))
    worst = max(tried, key=lambda one: one.felt.peak)
    best = ideal(body, kind, worst)
    cells = [
        f"`{kind}`", body, magnitude_text(kind, worst.magnitude), worst.target, f"{worst.onset:g}",
        f"{worst.felt.peak:.1f}", "-" if best is None else f"{best:.1f}", worst.felt.reason or "-", str(len(tried)),
    ]  # fmt: skip
    return "| " + " | ".join(cells) + " |"


if __name__ == "__main__":
    for kind in UPPER_ENDS:
        for body in BODIES:
            print(row(body, kind), flush=True)
