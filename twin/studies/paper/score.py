"""Claims judged together, and those of Fig. 4 on its runs."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

from twin.studies.paper.claim import ClaimFinding, Verdict, as_facts, judged
from twin.studies.paper.fig4 import CLAIMS, OUT_OF_SCOPE, QUALITY
from twin.studies.paper.fig4_runs import Fig4Runs


def failed(findings: Iterable[ClaimFinding]) -> list[str]:
    """Keys of the claims that fail."""
    return with_verdict(findings, "fails")


def with_verdict(findings: Iterable[ClaimFinding], verdict: Verdict) -> list[str]:
    """Keys of the claims with this verdict."""
    return [f.claim.key for f in findings if f.verdict == verdict]


def unscored(findings: Iterable[ClaimFinding]) -> list[str]:
    """Keys of the claims that need a series which the runs lack."""
    return with_verdict(findings, "not scored")


def tally(findings: Iterable[ClaimFinding]) -> tuple[int, int]:
    """(how many hold, how many were judged); what is not reproduced was judged."""
    verdicts = [f.verdict for f in findings]
    holds = verdicts.count("holds") + verdicts.count("reproduced after all")
    return holds, len(verdicts) - verdicts.count("trivial") - verdicts.count("not scored")


def standing(findings: Sequence[ClaimFinding]) -> str:
    """`25 of 31 claims hold, 5 not reproduced, 1 fails`."""
    (held, judged), missed, failing = tally(findings), with_verdict(findings, "not reproduced"), failed(findings)
    lost = f", {len(failing)} {'fails' if len(failing) == 1 else 'fail'}" if failing and missed else ""
    return f"{held} of {judged} claims hold" + (f", {len(missed)} not reproduced" if missed else "") + lost


def bound_used(finding: ClaimFinding) -> float:
    """How much of its bound a measure takes: 1 is at the bound, more fails; between two bounds, 0 is in their middle.

    Claims with a lower bound alone have no scale to measure that on and give 0 or infinity.
    """
    low, high, value = finding.claim.low, finding.claim.high, finding.value
    if not math.isfinite(value):
        return math.inf
    if math.isfinite(low) and math.isfinite(high):
        return abs(value - 0.5 * (low + high)) / (0.5 * (high - low))
    if math.isfinite(high) and high > 0.0:
        return max(0.0, value / high)
    return math.inf if finding.verdict == "fails" else 0.0


@dataclass(frozen=True)
class Score:
    """What runs say to Fig. 4.

    Attributes:
        claims: of the paper, judged on estimates.
        quality: ours, judged on the truth.
        tuned: parameters that were tuned to meet the text, key -> source.
        without_x: why nothing is said of forces in x, or "".
        missing: run -> series that claims need and it lacks.
        out_of_scope: what the paper reports and no model here can.
    """

    claims: tuple[ClaimFinding, ...]
    quality: tuple[ClaimFinding, ...]
    tuned: dict[str, str]
    without_x: str = ""
    missing: Mapping[str, Sequence[str]] = field(default_factory=dict)
    out_of_scope: tuple[str, ...] = OUT_OF_SCOPE

    @property
    def failed(self) -> list[str]:
        """Keys of what fails."""
        return failed((*self.claims, *self.quality))

    @property
    def not_reproduced(self) -> list[str]:
        """Keys of what is known not to hold, and does not."""
        return with_verdict((*self.claims, *self.quality), "not reproduced")

    @property
    def reproduced_after_all(self) -> list[str]:
        """Keys of what is known not to hold, and does."""
        return with_verdict((*self.claims, *self.quality), "reproduced after all")

    @property
    def unscored(self) -> list[str]:
        """Keys of what cannot be scored."""
        return unscored((*self.claims, *self.quality))

    def facts(self) -> dict[str, object]:
        """For JSON."""
        held, judged = tally(self.claims)
        return {
            "figure": "4",
            "claims_held": held,
            "claims_judged": judged,
            "failed": self.failed,
            "not_reproduced": self.not_reproduced,
            "reproduced_after_all": self.reproduced_after_all,
            "not_scored": self.unscored,
            "missing": {run: list(series) for run, series in self.missing.items()},
            "claims": [as_facts(finding) for finding in self.claims],
            "quality_on_true_force": [as_facts(finding) for finding in self.quality],
            "tuned": self.tuned,
            "out_of_scope": list(self.out_of_scope),
        }


def fig4_score(runs: Fig4Runs) -> Score:
    """Judge every claim of Fig. 4."""
    return Score(
        claims=tuple(judged(claim, runs) for claim in CLAIMS),
        quality=tuple(judged(claim, runs) for claim in QUALITY),
        tuned=runs.tuned,
        without_x=runs.without_x,
        missing=runs.missing,
    )
