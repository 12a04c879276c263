"""Comparison of runs: better, worse or the same, measure by measure.

A difference counts if it exceeds the floor of its measure (`twin.robot.run.measures`). Candidates that can be run again
are compared by paired runs with the same random draws; there the 95 % interval of the mean difference must exclude 0,
too: mean +- t s / sqrt(n), t the 97.5 % quantile of Student's distribution with n - 1 degrees of freedom (2.365 for 8).
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from twin.robot.experiment.source import value_at
from twin.robot.run.hold import TOUCH_GRACE
from twin.robot.run.measures import HEADLINE_KEYS, LEAST_CHATTER, ROWS_BY_KEY, MeasureRow, Values, fixed_point

EFFORT_MEASURES = ("torque", "current", "shaft_work", "energy")
COMPARED_MEASURES = (*HEADLINE_KEYS, "held_lateral_error", "held_z_error", *EFFORT_MEASURES)
"""Keys of the measures that runs are compared by; less is better."""
T_QUANTILE = {8: 2.365}
"""Number of paired runs -> 97.5 % quantile of Student's distribution."""
DECISIVE_KEYS = {
    "reference": ("controller.mode", "controller.force.reference_N", "reference", "duration_s"),
    "task": ("task",),
    "body": ("contact",),
}
"""Aspect that must be equal in two compared experiments -> its keys."""
MIXED_RANK = 2
"""Rank over several experiments: better in one and worse in another."""
RANK_WORDS = {-1: "better in", 1: "worse in", 0: "the same in", MIXED_RANK: "now better, now worse in"}
"""Rank of a candidate in a measure -> its words."""
Ranks = Mapping[str, int]
"""Name of a measure -> -1 better, 1 worse, 0 the same, `MIXED_RANK`."""


def standing_sentence(one: str, other: str, ranks: Ranks, values: Mapping[str, str] | None = None) -> str:
    """Format a comparison as `B beside A: better in ..., worse in ..., the same in ...`; `values` in brackets."""
    named = {name: f"{name} ({values[name]})" for name in ranks if values and ranks[name] in (-1, 1) and name in values}
    lists = {how: [named.get(name, name) for name in ranks if ranks[name] == rank] for rank, how in RANK_WORDS.items()}
    parts = [f"{how} {', '.join(names)}" for how, names in lists.items() if names]
    return f"{one} beside {other}: {'; '.join(parts) or 'no measure that both have'}"


@dataclass(frozen=True)
class Difference:
    """Difference of a measure between two candidates, over paired runs.

    Attributes:
        mean: mean of candidate minus reference, SI.
        half_width: half width of its 95 % interval, SI.
        agreeing, runs: number of runs whose difference has the sign of the mean, and number of runs.
        rank: -1 better, 1 worse, 0 the same.
    """

    measure: MeasureRow
    mean: float
    half_width: float
    agreeing: int
    runs: int
    rank: int

    JSON_KEYS = "mean half_width agreeing runs verdict"

    @property
    def verdict(self) -> str:
        return ("better", "same", "worse")[1 + self.rank]

    @property
    def text(self) -> str:
        """Mean difference with its 95 % interval and agreement as text: `+0.4192 +- 0.0337 N, in 8 of 8`."""
        if self.measure.key == "chatter" and not (self.mean or self.half_width):
            return f"below {LEAST_CHATTER:g} N in all runs"
        per_SI, digits = self.measure.unit.per_SI, self.measure.digits + 1
        mean = fixed_point(self.mean * per_SI, digits, "+")
        interval = f"{mean} +- {self.half_width * per_SI:.{digits}f} {self.measure.unit.text}"
        return f"{interval}, in {self.agreeing} of {self.runs}"


def compared_value(key: str, values: Values) -> float | None:
    """Return the value of a measure that comparisons of runs use; None if the run lacks the measure.

    Chatter too small to be reported is 0. A force that does not settle counts with the time until the hold ends, the
    least that its settling time can be.
    """
    value = values[key].value
    if value is not None or values["hold_error"].value is None:
        return value
    if key == "chatter":
        return 0.0
    begin, end = values["hold_begin"].value, values["hold_end"].value
    if key == "hold_settling_time" and values[key].reason == ROWS_BY_KEY[key].missing and begin is not None and end:
        return end - begin + TOUCH_GRACE
    return None


def judged_keys(runs: Sequence[Values]) -> list[str]:
    """List the measures that all `runs` have; without a held force, errors over the whole run replace its errors."""
    keys: tuple[str, ...] = COMPARED_MEASURES
    if any(values["hold_error"].value is None for values in runs):
        controlled = any(values["force_error"].value is not None for values in runs)
        # z minus its pre-defined reference includes the indentation if the force is controlled
        keys = ("force_error" if controlled else "z_error", "lateral_error", *EFFORT_MEASURES)
    # a drive without a torque output is scored by the load of its spring, which is a different quantity
    alike = {values["torque"].reason for values in runs}
    return [
        key
        for key in keys
        if all(compared_value(key, values) is not None for values in runs) and (key != "torque" or len(alike) == 1)
    ]


def standing(one: Values, other: Values) -> Ranks:
    """Rank one run against another in each measure: better, worse or the same, by the measure's floor alone."""
    ranks = {}
    for key in judged_keys([one, other]):
        value, beside = compared_value(key, one), compared_value(key, other)
        assert value is not None and beside is not None
        differs = ROWS_BY_KEY[key].differs(value, beside)
        ranks[ROWS_BY_KEY[key].text] = (1 if value > beside else -1) if differs else 0
    return ranks


def paired_differences(one: Sequence[Values], other: Sequence[Values]) -> list[Difference]:
    """Compute the difference of each measure over paired runs, both in the order of the random draws."""
    found, n = [], len(one)
    for key in judged_keys([*one, *other]):
        measure = ROWS_BY_KEY[key]
        a, b = (np.array([compared_value(key, values) for values in runs], dtype=float) for runs in (one, other))
        d = a - b
        mean, half_width = float(d.mean()), float(T_QUANTILE[n] * d.std(ddof=1) / math.sqrt(n))
        counts = abs(mean) > half_width and measure.differs(float(a.mean()), float(b.mean()))
        rank = (1 if mean > 0.0 else -1) if counts else 0
        found.append(Difference(measure, mean, half_width, int(np.sum(d * mean > 0.0)), n, rank))
    return found


def overall_ranks(each: Sequence[Ranks]) -> Ranks:
    """Combine the ranks of several experiments: better if better in at least one and worse in no other, and so on."""
    found = {}
    for name in dict.fromkeys(name for ranks in each for name in ranks):
        seen = {ranks[name] for ranks in each if ranks.get(name)}
        found[name] = MIXED_RANK if len(seen) > 1 else max(seen, default=0)
    return found


def compare_single_runs(
    names: tuple[str, str], runs: tuple[Values, Values], experiments: tuple[Mapping, Mapping]
) -> str:
    """Compare two recorded runs in a sentence, without a verdict if reference, task or body differ.

    Args:
        names: candidate and reference.
        runs: measures of each run; empty without measures.
        experiments: recorded values of each, keys with units.
    """
    one, other = names
    differing = [
        what
        for what, keys in DECISIVE_KEYS.items()
        if any(len({repr(value_at(e, key)) for e in experiments}) > 1 for key in keys)
    ]
    if differing:
        return f"{one} beside {other}: no verdict, another {' and another '.join(differing)}"
    return f"{standing_sentence(one, other, standing(*runs) if all(runs) else {})} (one run each)"
