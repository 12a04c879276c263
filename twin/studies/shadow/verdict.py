"""The verdict of a session: robot and twin match, they part, or nothing could be watched."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from twin.studies.shadow.samples import COUNT_L, COUNT_M, F_Z, OMEGA_REF, TAU

if TYPE_CHECKING:
    from twin.studies.shadow.session import Followed, Running

SIGNALS = {"motor angles": COUNT_M, "joint angles": COUNT_L, "force": F_Z, "commands": OMEGA_REF, "torques": TAU}
"""Columns of a sample by their names in a summary."""
GROSS_JOINT = math.radians(2.0)
"""Mean joint residual over each of 2 s (rad) that no healthy robot has: their tolerance is a hundredth of it."""
GROSS_NIS = 50.0
"""Mean NIS per count over each of 2 s that no healthy robot has: it is 20 at most at the corners of the fleet."""
GROSS_BAND, FEWEST_PREDICTED = 0.2, 200
"""Minimum share of the estimated forces in the band of 95 %, and minimum number of forces for that test."""


@dataclass(frozen=True)
class Verdict:
    """The verdict of a session on robot and twin.

    Attributes:
        kind: "match", "part" or "not watched".
        since: when they parted (s); NaN if they did not.
        text: half a sentence.
    """

    kind: str
    since: float
    text: str


def gross_disagreement(residuals: Mapping[str, "Running"], mistake: str = "") -> Verdict | None:
    """Whether residuals are so large that no tolerance is needed, or the map is wrong; None if neither.

    Args:
        residuals: of a session.
        mistake: of the column map, see `MapCheck`.
    """
    if mistake:
        return Verdict("part", 0.0, f"robot and twin part: {mistake}")
    for name, one in residuals.items():
        if name.startswith("joint") and abs(one.worst) > GROSS_JOINT:
            off = f"{name} is off by {math.degrees(one.worst):+.1f} deg"
            text = f"robot and twin part: {off}; are joints, signs and zeros of the map those of the experiment?"
            return Verdict("part", one.worst_at, text)
    NIS = residuals.get("NIS")
    if NIS is not None and NIS.worst > GROSS_NIS:
        text = (
            f"robot and twin part: NIS is {NIS.worst:.3g} per count; the encoders contradict each other or the "
            "commands: a dead drive, joints exchanged in the map, or two publishers that disagree"
        )
        return Verdict("part", NIS.worst_at, text)
    return None


def verdict_of(followed: "Followed") -> Verdict:
    """The verdict of a finished session."""
    alarm = next((one for one in followed.changes or () if one.alarm), None)
    if alarm is not None:
        caution = f"; {followed.caution}" if followed.caution else ""
        return Verdict("part", alarm.since, f"robot and twin part since {alarm.since:.1f} s{caution}")
    gross = gross_disagreement(followed.residuals, followed.mistake)
    if gross is not None:
        return gross
    ahead = followed.ahead
    if ahead is not None and ahead.banded >= FEWEST_PREDICTED and ahead.share < GROSS_BAND:
        share = 100.0 * ahead.share
        return Verdict("part", math.nan, f"robot and twin part: {share:.0f} % of the forces lie in the band of 95 %")
    if followed.changes is None:
        return Verdict("not watched", math.nan, f"not watched: {followed.no_alarm or 'no tolerances'}")
    until = f" until {followed.seconds:.1f} s, then not watched: {followed.silent}" if followed.silent else ""
    return Verdict("match", math.nan, f"robot and twin match{until}")
