"""The verdict of a session: robot and twin match, they part, or nothing could be watched."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from twin.kernel.recording.sources.stamps import Counts, Histogram
from twin.studies.replay.sample_columns import COUNT_L, COUNT_M, F_Z, OMEGA_REF, TAU
from twin.studies.shadow.ahead import PredictionScore
from twin.studies.shadow.alarm import WatchEvent

SIGNAL_COLUMNS = {"motor angles": COUNT_M, "joint angles": COUNT_L, "force": F_Z, "commands": OMEGA_REF, "torques": TAU}
"""Columns of a sample by their names in a summary."""
PLANT_JOINT = "plant joint"
"""Begins the names of the plant model's joint residuals; `joint 1` is an encoder of the alarm's channels."""
GROSS_JOINT = math.radians(2.0)
"""Mean joint residual over each of 2 s (rad) that no healthy robot has: their tolerance is a hundredth of it."""
GROSS_NIS = 50.0
"""Mean NIS per count over each of 2 s that no healthy robot has: it is 20 at most at the corners of the fleet."""
GROSS_BAND, MIN_BANDED_FORCES = 0.2, 200
"""Minimum share of the estimated forces in the band of 95 %, and minimum number of forces for that test."""


@dataclass
class RunningStatistics:
    """A residual in numbers, without its past.

    Attributes:
        count: of values.
        mean, rms: of all.
        largest, at: the largest by size, and when (s).
        recent: mean over the last second.
        last: when the last value was (s).
        worst, worst_at: the largest size that the means of two consecutive seconds reach, with its sign, and when these
            began (s).
    """

    count: int = 0
    largest: float = 0.0
    largest_time: float = math.nan
    _sum: float = 0.0
    _squares: float = 0.0
    _block: list[float] = field(default_factory=lambda: [0.0, 0.0, -math.inf])
    recent: float = math.nan
    last: float = -math.inf
    worst: float = 0.0
    worst_at: float = math.nan

    def add(self, t: NDArray[np.float64], r: NDArray[np.float64]) -> None:
        """Values r (n,) at t (n,), s; NaN are none."""
        there = np.isfinite(r)
        if not np.any(there):
            return
        t, r = t[there], r[there]
        self.count += len(r)
        self.last = float(t[-1])
        self._sum += float(np.sum(r))
        self._squares += float(np.sum(r**2))
        worst = int(np.argmax(np.abs(r)))
        if abs(r[worst]) > abs(self.largest) or not math.isfinite(self.largest_time):
            self.largest, self.largest_time = float(r[worst]), float(t[worst])
        if t[-1] - self._block[2] >= 1.0:
            if self._block[1]:
                before, self.recent = self.recent, self._block[0] / self._block[1]
                # one sample after a gap can raise the mean of its second
                lasting = min(abs(before), abs(self.recent)) if math.isfinite(before) else 0.0
                if lasting > abs(self.worst):
                    self.worst, self.worst_at = math.copysign(lasting, self.recent), self._block[2] - 1.0
            self._block = [0.0, 0.0, float(t[-1])]
        self._block[0] += float(np.sum(r))
        self._block[1] += len(r)

    @property
    def mean(self) -> float:
        return self._sum / self.count if self.count else math.nan

    @property
    def rms(self) -> float:
        return math.sqrt(self._squares / self.count) if self.count else math.nan


@dataclass
class SessionSummary:
    """What a session came to.

    Attributes:
        source: what was followed.
        recording: of it.
        seconds: from the first to the last sample, by the robot's stamps.
        counts: of samples.
        period: of them (s); infinite without a clock.
        lateness: of messages; offset, drift: of the robot's clock, see `Clocks`.
        in_hand: from a sample in our hands to its estimate.
        missed: estimates that came later than a period after their samples.
        residuals: `force` (N), `plant joint 1` .. `plant joint 3` (rad), `command 1` .. (rad/s); `NIS` per count in
            motion.
        dropped: messages that the transport or we lost knowingly.
        notes: sentences.
        changes: of the alarm's state; None: there was no alarm.
        no_alarm: why there was none.
        caution: what an alarm is to be read with; "" of an identified robot.
        ahead: how predictions compare with what came; None: there were none.
        measured: names of the `SIGNAL_COLUMNS` that came.
        silent: what was missing when the session ended; "" if samples came to the end.
        mistake: of the column map, with the one to write; "" if none was seen.
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
    residuals: dict[str, RunningStatistics] = field(default_factory=dict)
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
        """Sentences on the alarms among `changes`."""
        return None if self.changes is None else [f"{one.t:.1f} s  {one}" for one in self.changes if one.alarm]


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


def gross_disagreement(residuals: Mapping[str, RunningStatistics], mistake: str = "") -> Verdict | None:
    """Whether residuals are so large that no tolerance is needed, or the map is wrong; None if neither.

    Args:
        residuals: of a session.
        mistake: of the column map, see `MapCheck`.
    """
    if mistake:
        return Verdict("part", 0.0, f"robot and twin part: {mistake}")
    for name, one in residuals.items():
        if name.startswith(PLANT_JOINT) and abs(one.worst) > GROSS_JOINT:
            joint = name.removeprefix(f"{PLANT_JOINT} ")
            off = f"joint {joint} of the plant model is off by {math.degrees(one.worst):+.1f} deg"
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


def verdict_of(followed: SessionSummary) -> Verdict:
    """The verdict of a finished session."""
    alarm = next((one for one in followed.changes or () if one.alarm), None)
    if alarm is not None:
        caution = f"; {followed.caution}" if followed.caution else ""
        return Verdict("part", alarm.since, f"robot and twin part since {alarm.since:.1f} s{caution}")
    gross = gross_disagreement(followed.residuals, followed.map_error)
    if gross is not None:
        return gross
    ahead = followed.ahead
    if ahead is not None and ahead.banded >= MIN_BANDED_FORCES and ahead.share < GROSS_BAND:
        share = 100.0 * ahead.share
        return Verdict("part", math.nan, f"robot and twin part: {share:.0f} % of the forces lie in the band of 95 %")
    if followed.changes is None:
        return Verdict("not watched", math.nan, f"not watched: {followed.no_alarm or 'no tolerances'}")
    until = f" until {followed.seconds:.1f} s, then not watched: {followed.silent}" if followed.silent else ""
    return Verdict("match", math.nan, f"robot and twin match{until}")
