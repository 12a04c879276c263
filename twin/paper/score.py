"""All claims of a figure on one pair of runs."""

from dataclasses import dataclass

from twin.paper.claim import Finding, as_facts, judged
from twin.paper.fig4 import CLAIMS, OUT_OF_SCOPE, QUALITY
from twin.paper.fig4_runs import Fig4Runs


@dataclass(frozen=True)
class Score:
    """What two runs say to Fig. 4.

    Attributes:
        claims: of the paper, judged on estimates. quality: ours, judged on the truth.
        tuned: parameters that were tuned to meet the figure, key -> source.
        out_of_scope: what the paper reports and no model here can.
    """

    claims: tuple[Finding, ...]
    quality: tuple[Finding, ...]
    tuned: dict[str, str]
    out_of_scope: tuple[str, ...] = OUT_OF_SCOPE

    @property
    def failed(self) -> list[str]:
        """Keys of what fails."""
        return [f.claim.key for f in (*self.claims, *self.quality) if f.verdict == "fails"]

    def facts(self) -> dict[str, object]:
        """For JSON."""
        return {
            "figure": "4",
            "failed": self.failed,
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
    )
