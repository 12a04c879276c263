"""A claim of the paper: a quote, a measure, and bounds with their source."""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from twin.kernel.errors import UnknownSeries

Verdict = Literal["holds", "fails", "trivial", "not reproduced", "reproduced after all", "not scored"]
""""not reproduced" and "reproduced after all" are verdicts on claims with a `KnownMiss`; "fails" is unexpected."""
PAPER_CLAIMS, OWN_CHECKS = "claims of the paper's text", "of this run's own checks"
"""Names of scores: claims of the paper's text, and twin's own requirements on the true force."""


@dataclass(frozen=True)
class KnownMiss:
    """Reason for a claim known to be missed, and the range `low` to `high` it explains; outside, the claim fails."""

    reason: str
    low: float = -math.inf
    high: float = math.inf


@dataclass(frozen=True)
class Claim:
    """One claim of the paper with its measure and bounds.

    Attributes:
        text: one line for the scorecard.
        figure: figure or section of the claim.
        quote: the paper's words, or our reason for a claim that the paper does not make.
        measure: runs -> judged number; infinity or nan if the event never happens, and nan always fails. None if the
            claim cannot be measured.
        low, high: bounds, inclusive, in `unit` (measured SI values are multiplied by `scale` first).
        source: origin of the bounds, but not their date (docs/paper.md has the dates of Fig. 5).
        trivial: runs -> why this run cannot support the claim, or "".
        miss: explanation of a claim that is known not to be reproduced; required without a `measure`.
    """

    key: str
    text: str
    figure: str
    quote: str
    measure: Callable[[Any], float] | None = None
    low: float = -math.inf
    high: float = math.inf
    unit: str = ""
    scale: float = 1.0
    digits: int = 2
    source: str = ""
    trivial: Callable[[Any], str] = lambda runs: ""
    miss: KnownMiss | None = None

    @property
    def bounds_text(self) -> str:
        """Bounds of the claim as text: `5.4 .. 5.8`, `<= 0.5` or `>= 2`."""
        if math.isfinite(self.low):
            return f"{self.low:g} .. {self.high:g}" if math.isfinite(self.high) else f">= {self.low:g}"
        return f"<= {self.high:g}" if math.isfinite(self.high) else ""


@dataclass(frozen=True)
class ClaimFinding:
    """Verdict on a claim of the paper for a run, with the measured value in the claim's unit."""

    claim: Claim
    value: float
    verdict: Verdict
    reason: str

    JSON_KEYS = (
        "claim=claim.key text=claim.text figure=claim.figure quote=claim.quote measured=value unit=claim.unit "
        "low=claim.low high=claim.high tolerance_source=claim.source verdict reason"
    )

    @property
    def measured_text(self) -> str:
        """Measured value of the claim as text: `5.606 s`, or `never`."""
        if self.claim.measure is None or (self.verdict in ("trivial", "not scored") and not math.isfinite(self.value)):
            return ""
        if not math.isfinite(self.value):
            return "never"
        return f"{self.value:.{self.claim.digits}f} {self.claim.unit}".rstrip()


def judge_claim(claim: Claim, runs: Any) -> ClaimFinding:
    """Judge a claim of the paper on runs; it is not scored if the runs lack a series that it needs."""
    if claim.measure is None:
        return ClaimFinding(claim, math.nan, "not reproduced", claim.miss.reason if claim.miss else "")
    try:
        value = claim.measure(runs) * claim.scale
    except UnknownSeries as problem:
        return ClaimFinding(claim, math.nan, "not scored", f"needs {problem.key}")
    if reason := claim.trivial(runs):
        return ClaimFinding(claim, value, "trivial", reason)
    holds = claim.low <= value <= claim.high
    if claim.miss and holds:
        return ClaimFinding(claim, value, "reproduced after all", f"known not to be: {claim.miss.reason}")
    if claim.miss and claim.miss.low <= value <= claim.miss.high:
        return ClaimFinding(claim, value, "not reproduced", claim.miss.reason)
    return ClaimFinding(claim, value, "holds" if holds else "fails", "")


def keys_with_verdict(findings: Iterable[ClaimFinding], verdict: Verdict) -> list[str]:
    return [f.claim.key for f in findings if f.verdict == verdict]


def tally(findings: Iterable[ClaimFinding]) -> tuple[int, int]:
    """Count claims: (number that hold, number judged); claims that are not reproduced count as judged."""
    verdicts = [f.verdict for f in findings]
    holds = verdicts.count("holds") + verdicts.count("reproduced after all")
    return holds, len(verdicts) - verdicts.count("trivial") - verdicts.count("not scored")


def standing_text(findings: Sequence[ClaimFinding], name: str) -> str:
    """Summarise verdicts on claims: `25 of 31 claims of the paper's text hold, 5 not reproduced, 1 fails`."""
    held, judged = tally(findings)
    missed, failing = (keys_with_verdict(findings, verdict) for verdict in ("not reproduced", "fails"))
    lost = f", {len(failing)} {'fails' if len(failing) == 1 else 'fail'}" if failing and missed else ""
    return f"{held} of {judged} {name} hold" + (f", {len(missed)} not reproduced" if missed else "") + lost


def bound_usage(finding: ClaimFinding) -> float:
    """Return the share of its bound that a claim's measured value uses: 1 is at the bound, more fails.

    Between two bounds, 0 is in the middle. Claims with a lower bound alone have no scale and give 0 or infinity.
    """
    low, high, value = finding.claim.low, finding.claim.high, finding.value
    if not math.isfinite(value):
        return math.inf
    if math.isfinite(low) and math.isfinite(high):
        return abs(value - 0.5 * (low + high)) / (0.5 * (high - low))
    if math.isfinite(high) and high > 0.0:
        return max(0.0, value / high)
    return math.inf if finding.verdict == "fails" else 0.0
