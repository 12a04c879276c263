"""A claim of the paper: a quote, a measure, and bounds with their source."""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from twin.kernel.errors import UnknownSeries

Verdict = Literal["holds", "fails", "trivial", "not reproduced", "reproduced after all", "not scored"]
""""Not reproduced" and "reproduced after all" are of claims with a `KnownMiss`; "fails" is unexpected."""
PAPER_CLAIMS, OWN_CHECKS = "claims of the paper's text", "of this run's own checks"
"""Names of scores: of claims that the paper's text makes, and of what is asked of the true force."""


@dataclass(frozen=True)
class KnownMiss:
    """A claim that the twin is known not to reproduce.

    Attributes:
        low, high: what `reason` explains, in the claim's unit; a number beyond it fails, as that of any other claim.
    """

    reason: str
    low: float = -math.inf
    high: float = math.inf


@dataclass(frozen=True)
class Claim:
    """One claim: `source` says where its bounds come from, not when they were set (docs/fig5.md says it of Fig. 5).

    Attributes:
        key: short name.
        text: one line for the scorecard.
        figure: where it stands.
        quote: the paper's words, or why we ask it if the paper does not.
        measure: runs -> the number judged; infinity or nan where it never happens, and nan always fails. None: nothing
            can be measured.
        low, high: bounds, inclusive, in `unit` (measured SI values are multiplied by `scale` first).
        source: where the bounds come from.
        trivial: runs -> why this run says nothing about the claim, or "".
        miss: why it is not reproduced, if it is known not to be; without a `measure` it always is so.
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
        """`5.4 .. 5.8`, `<= 0.5` or `>= 2`."""
        if math.isfinite(self.low):
            return f"{self.low:g} .. {self.high:g}" if math.isfinite(self.high) else f">= {self.low:g}"
        return f"<= {self.high:g}" if math.isfinite(self.high) else ""


@dataclass(frozen=True)
class ClaimFinding:
    """A claim and what a run says to it; `value` in the claim's unit."""

    claim: Claim
    value: float
    verdict: Verdict
    reason: str

    @property
    def measured_text(self) -> str:
        """`5.606 s`, or `never`."""
        if self.claim.measure is None or (self.verdict in ("trivial", "not scored") and not math.isfinite(self.value)):
            return ""
        if not math.isfinite(self.value):
            return "never"
        return f"{self.value:.{self.claim.digits}f} {self.claim.unit}".rstrip()

    @property
    def bounds_text(self) -> str:
        """See `Claim.bounds_text`."""
        return self.claim.bounds_text


def judge_claim(claim: Claim, runs: Any) -> ClaimFinding:
    """Measure `claim` on `runs`; one that needs a series which they lack is not scored."""
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


def finding_to_dict(finding: ClaimFinding) -> dict[str, object]:
    """For JSON: what was claimed, measured, expected and found."""
    claim = finding.claim
    return {
        "claim": claim.key,
        "text": claim.text,
        "figure": claim.figure,
        "quote": claim.quote,
        "measured": finding.value if math.isfinite(finding.value) else None,
        "unit": claim.unit,
        "low": claim.low if math.isfinite(claim.low) else None,
        "high": claim.high if math.isfinite(claim.high) else None,
        "tolerance_source": claim.source,
        "verdict": finding.verdict,
        "reason": finding.reason,
    }


def failed_keys(findings: Iterable[ClaimFinding]) -> list[str]:
    """Keys of the claims that fail."""
    return keys_with_verdict(findings, "fails")


def keys_with_verdict(findings: Iterable[ClaimFinding], verdict: Verdict) -> list[str]:
    """Keys of the claims with this verdict."""
    return [f.claim.key for f in findings if f.verdict == verdict]


def unscored_keys(findings: Iterable[ClaimFinding]) -> list[str]:
    """Keys of the claims that need a series which the runs lack."""
    return keys_with_verdict(findings, "not scored")


def tally(findings: Iterable[ClaimFinding]) -> tuple[int, int]:
    """(how many hold, how many were judged); what is not reproduced was judged."""
    verdicts = [f.verdict for f in findings]
    holds = verdicts.count("holds") + verdicts.count("reproduced after all")
    return holds, len(verdicts) - verdicts.count("trivial") - verdicts.count("not scored")


def standing_text(findings: Sequence[ClaimFinding], name: str) -> str:
    """`25 of 31 claims of the paper's text hold, 5 not reproduced, 1 fails`."""
    (held, judged), missed, failing = (
        tally(findings),
        keys_with_verdict(findings, "not reproduced"),
        failed_keys(findings),
    )
    lost = f", {len(failing)} {'fails' if len(failing) == 1 else 'fail'}" if failing and missed else ""
    return f"{held} of {judged} {name} hold" + (f", {len(missed)} not reproduced" if missed else "") + lost


def bound_usage(finding: ClaimFinding) -> float:
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
