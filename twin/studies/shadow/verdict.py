"""Verdict of a session: robot and twin match, they diverge, or nothing was watched."""

import math
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from twin.kernel.recording.sources.stamps import Counts, Histogram
from twin.studies.replay.sample_columns import COUNT_L, COUNT_M, F_Z, OMEGA_REF, TAU
from twin.studies.shadow.ahead import PredictionScore
from twin.studies.shadow.alarm import WatchEvent, WatchState
from twin.studies.shadow.statistics import RunningStatistics

SIGNAL_COLUMNS = {"motor angles": COUNT_M, "joint angles": COUNT_L, "force": F_Z, "commands": OMEGA_REF, "torques": TAU}
"""Columns of a sample by the names in a summary."""
PLANT_JOINT = "plant joint"
"""Prefix of the plant model's joint residuals; `joint 1` is an encoder channel of the alarm."""
GROSS_JOINT = math.radians(2.0)
"""Limit of the mean joint residual over each of 2 s (rad); the tolerance of healthy robots is a hundredth of it."""
GROSS_NIS = 50.0
"""Limit of the mean NIS per count over each of 2 s; in the shipped fleets it rises by at most 24 (massage, 250 Hz)."""
UNWATCHED_STATES = (WatchState.NOT_WATCHED, WatchState.COOLING_DOWN)
GROSS_BAND, MIN_BANDED_FORCES = 0.2, 200
"""Minimum share of the estimated forces in the band of 95 %, and minimum number of forces for that test."""


@dataclass
class SessionSummary:
    """Summary of a session with a robot: counts, residuals, alarms and predictions.

    Attributes:
        seconds: time from the first to the last sample, by the robot's stamps.
        period: sampling period (s); infinite without a clock.
        offset, drift: offset and drift of the robot's clock, see `Clocks`.
        missed: number of estimates later than a period after their samples.
        residuals: `force` (N), `plant joint 1` .. `plant joint 3` (rad), `command 1` .. (rad/s); `NIS` per count in
            motion.
        dropped: number of messages lost by the transport or by a full queue.
        changes: changes of the alarm's state; None without an alarm.
        caution: caution for alarms; "" for an identified robot.
        ahead: score of the predictions; None without predictions.
        measured_signals: names of the `SIGNAL_COLUMNS` that arrived.
        silent: missing topic or joint at the end; "" if samples arrived until the end.
        map_error: error of the column map, with the correct map; "" without an error.
    """

    source: str
    recording: Path = Path()
    seconds: float = 0.0
    counts: Counts = field(default_factory=Counts)
    period: float = math.inf
    lateness: Histogram = field(default_factory=Histogram)
    offset: float = math.nan
    drift: float = math.nan
    in_hand: Histogram = field(default_factory=Histogram)
    missed: int = 0
    residuals: dict[str, RunningStatistics] = field(default_factory=lambda: defaultdict(RunningStatistics))
    dropped: int = 0
    notes: list[str] = field(default_factory=list)
    changes: list[WatchEvent] | None = None
    no_alarm: str = ""
    caution: str = ""
    ahead: PredictionScore | None = None
    measured_signals: list[str] = field(default_factory=list)
    silent: str = ""
    map_error: str = ""

    @property
    def alarms(self) -> list[str] | None:
        """Alarms among the `changes`, a sentence each; None without a watch."""
        return None if self.changes is None else [f"{one.t:.1f} s  {one}" for one in self.changes if one.alarm]


@dataclass(frozen=True)
class Verdict:
    """Verdict of a session: "match", "diverge" or "not watched"; `since` (s) is NaN if they match."""

    kind: str
    since: float
    text: str


def gross_disagreement(residuals: Mapping[str, RunningStatistics], mistake: str = "") -> Verdict | None:
    """Judge residuals that are too large for any healthy robot, or a wrong column map; None if neither applies."""
    if mistake:
        return Verdict("diverge", 0.0, f"robot and twin diverge: {mistake}")
    for name, one in residuals.items():
        if name.startswith(PLANT_JOINT) and abs(one.worst) > GROSS_JOINT:
            joint = name.removeprefix(f"{PLANT_JOINT} ")
            off = f"joint {joint} of the plant model is off by {math.degrees(one.worst):+.1f} deg"
            text = f"robot and twin diverge: {off}; do joints, signs and zeros of the map match the experiment?"
            return Verdict("diverge", one.worst_at, text)
    NIS = residuals.get("NIS")
    if NIS is not None and NIS.worst > GROSS_NIS:
        text = (
            f"robot and twin diverge: NIS is {NIS.worst:.3g} per count; the encoders contradict each other or the "
            "commands: a dead drive, joints exchanged in the map, or two publishers that disagree"
        )
        return Verdict("diverge", NIS.worst_at, text)
    return None


def verdict_of(followed: SessionSummary) -> Verdict:
    alarm = next((one for one in followed.changes or () if one.alarm), None)
    if alarm is not None:
        caution = f"; {followed.caution}" if followed.caution else ""
        return Verdict("diverge", alarm.since, f"robot and twin diverge since {alarm.since:.1f} s{caution}")
    gross = gross_disagreement(followed.residuals, followed.map_error)
    if gross is not None:
        return gross
    ahead = followed.ahead
    if ahead is not None and ahead.banded >= MIN_BANDED_FORCES and ahead.share < GROSS_BAND:
        share = 100.0 * ahead.share
        return Verdict(
            "diverge", math.nan, f"robot and twin diverge: {share:.0f} % of the forces lie in the band of 95 %"
        )
    if followed.changes is None:
        return Verdict("not watched", math.nan, f"not watched: {followed.no_alarm or 'no tolerances'}")
    return Verdict("match", math.nan, f"robot and twin match{_unwatched_text(followed)}")


def _unwatched_text(followed: SessionSummary) -> str:
    """Describe the times without a watch of a robot without an alarm; "" if it was always watched."""
    total, since, why = 0.0, math.nan, ""
    for one in followed.changes or ():
        if one.state not in UNWATCHED_STATES:
            total += one.t - since if math.isfinite(since) else 0.0
            since = math.nan
        elif math.isnan(since) or one.state is WatchState.NOT_WATCHED:
            since, why = one.t if math.isnan(since) else since, one.found
    text = f" (not watched for up to {math.ceil(total)} s)" if total else ""
    if math.isfinite(since):
        text += f" until {since:.1f} s, then not watched: {followed.silent or why}"
    return text
