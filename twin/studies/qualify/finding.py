"""What a qualification run finds: checks that a drive passes or not, measures with a number or a reason for none."""

from dataclasses import dataclass
from typing import Literal

Verdict = Literal["ok", "FAIL", "note"]


@dataclass(frozen=True)
class Check:
    """One thing that is right or not.

    Attributes:
        name: key in `definitions.CHECKS`.
        verdict: "FAIL" disqualifies the drive, "note" is worth knowing and does not.
        detail: the evidence, in a phrase.
    """

    name: str
    verdict: Verdict
    detail: str


@dataclass(frozen=True)
class Measure:
    """One number.

    Attributes:
        name: key in `definitions.MEASURES`.
        value: in the unit of the definition; None: not measurable.
        remark: why not, or what to know about the value.
    """

    name: str
    value: float | None
    remark: str = ""


Finding = Check | Measure


def judged(name: str, right: bool, detail: str, otherwise: Verdict = "FAIL") -> Check:
    """A check that is "ok" if `right`, else `otherwise`."""
    return Check(name, "ok" if right else otherwise, detail)
