"""Alarm for divergence of robot and twin: cumulative sums over means of residuals, with a chosen rate of false alarms.

E. S. Page, Continuous inspection schemes, Biometrika 41 (1954) 100. With r_n the mean residual of block n and r_0 the
mean of the first blocks,

    up_n = max(0, up_(n-1) + (r_n - r_0) - K),  low_n = max(0, low_(n-1) - (r_n - r_0) - K),  K = tolerance + sigma/2,

and a sum beyond H sigma is an alarm. D. Siegmund, Sequential Analysis (1985), sec. 2.4 and (10.18): number of blocks
between false alarms on one side, with a residual at the edge of its tolerance,

    ARL = 2 (e^b - 1 - b),  b = H + 1.166.

The tolerance comes from a fleet of healthy robots (`fleet`); sigma is the standard deviation between successive blocks.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from twin.kernel.errors import InputRefused

Columns = Mapping[str, NDArray[np.float64]]
BLOCK_LENGTH = 1.0
"""Length of a block (s), the shortest of a replay."""
FIRST_BLOCKS = 2
"""Number of reference blocks of a robot; encoder zeros are the same in all blocks."""
SETTLING_TIME = 0.5
"""Time after a start of the filter during which residuals are ignored (s)."""
MIN_BLOCK_SHARE = 0.5
RATE_RESERVE = 5.0
"""Factor between requested and computed rate, because blocks are neither normal nor independent."""
CONFIRMING_LEVEL = 0.5
"""Share of the threshold above which the state is CONFIRMING."""

COMMAND_CHANNEL = "command"
UNCOMPARED_NOTE = "the twin's controller is not compared"
CHANNELS = {
    **{f"motor {i + 1}": ("residual_m", i, "rad") for i in range(3)},
    **{f"joint {i + 1}": ("residual_l", i, "rad") for i in range(3)},
    "force": ("residual_F", 0, "N"),
    **{f"torque {i + 1}": ("residual_tau", i, "N m") for i in range(3)},
    "spread": ("NIS", 0, "1"),
    COMMAND_CHANNEL: ("residual_command", 0, "rad/s"),
}
"""Watched residuals -> output of the filter, element, unit. `spread` is NIS per count; `command` is the largest
difference between the robot's commands and the commands of the twin's own controller."""
ONE_SIDED_CHANNELS = ("spread", COMMAND_CHANNEL)
SUM_COUNT = 2 * len(CHANNELS) - len(ONE_SIDED_CHANNELS)
"""Number of sums that may alarm."""
RATE_ERROR = 0.1
"""Relative difference of a measured rate to one that has tolerances."""
UNKNOWN_PARAMETER = "which parameter is not known"


def run_length(H: float) -> float:
    """Compute the mean number of blocks between false alarms of a sum at the tolerance's edge; `H` in sigma."""
    b = H + 1.166
    return 2.0 * (math.expm1(b) - b)


def threshold(per_hour: float) -> float:
    """Compute the alarm threshold H, by sigma, for a rate of false alarms per hour over all sums together."""
    if not 1e-6 <= per_hour <= 100.0:
        raise InputRefused(f"{per_hour:g} false alarms an hour: expected 1e-6 to 100")
    wanted = 3600.0 / BLOCK_LENGTH * SUM_COUNT * RATE_RESERVE / per_hour
    low, high = 0.0, 60.0
    while high - low > 1e-9:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if run_length(middle) < wanted else (low, middle)
    return high


@dataclass(frozen=True)
class Tolerances:
    """Tolerances per channel, in its unit: largest change, and standard deviation, of a block's mean."""

    tolerance: Mapping[str, float]
    sigma: Mapping[str, float]

    def of_channel(self, name: str) -> tuple[float, float]:
        """Return tolerance and sigma of a channel; NaN if unknown."""
        return self.tolerance.get(name, math.nan), self.sigma.get(name, math.nan)


RateTolerances = Mapping[float, Tolerances]
"""Tolerances by sampling rate (Hz)."""


def rate_of(t: NDArray[np.float64]) -> float:
    """Estimate the sampling rate (Hz) from the median interval of stamps `t` (n,), s; NaN with under two stamps."""
    return 1.0 / float(np.median(np.diff(t))) if len(t) > 1 else math.nan


def tolerances_at(limits: RateTolerances, rate: float) -> Tolerances | None:
    """Select the tolerances for a measured sampling rate (Hz); None if no known rate is near."""
    nearest = min(limits, key=lambda one: abs(one - rate), default=math.nan)
    return limits[nearest] if abs(nearest - rate) <= RATE_ERROR * rate else None


class WatchState(StrEnum):
    """State of the alarm's watch on a robot: listening, confirming, searching the cause, cooling down or off."""

    LISTENING = "listening"
    CONFIRMING = "confirming"
    GATHERING = "gathering"
    REIDENTIFYING = "re-identifying"
    COOLING_DOWN = "cooling down"
    NOT_WATCHED = "not watched"


WAITING_STATES = (WatchState.GATHERING, WatchState.REIDENTIFYING, WatchState.COOLING_DOWN)


@dataclass(frozen=True)
class WatchEvent:
    """Change of the watch's state, with the evidence for it.

    Attributes:
        channel: channel of the largest sum; "" if no sum caused the change.
        level: that sum by its threshold.
        since: start of the sum's growth (s).
        size: mean residual since then, less the reference, in the channel's unit.
    """

    t: float
    state: WatchState
    channel: str = ""
    level: float = 0.0
    since: float = math.nan
    size: float = math.nan
    found: str = ""
    alarm: bool = False

    def __str__(self) -> str:
        if not self.channel:
            return f"{self.state}{f': {self.found}' if self.found else ''}"
        unit = "" if CHANNELS[self.channel][2] == "1" else f" {CHANNELS[self.channel][2]}"
        what = "robot and twin diverge" if self.alarm else f"{self.state}"
        off = f"{self.channel} is off by {self.size:+.3g}{unit} since {self.since:.1f} s"
        return f"{what}: {off} ({self.level:.2f} of the threshold)"


@dataclass
class _Sum:
    up: float = 0.0
    low: float = 0.0
    up_since: float = math.nan
    low_since: float = math.nan
    taken: list[float] = field(default_factory=list)


class Blocks:
    """Averaging of the filter's outputs over blocks of `BLOCK_LENGTH`, updated with samples or slices."""

    def __init__(self) -> None:
        self._start, self._settled = math.nan, -math.inf
        self._sums, self._counts, self._samples = np.zeros(len(CHANNELS)), np.zeros(len(CHANNELS)), 0
        self._most, self._anew = 0, math.inf

    def add_samples(self, t: NDArray[np.float64], y: Columns) -> Iterator[tuple[float, NDArray[np.float64]]]:
        """Add ascending samples (n,), s; yield end (s) and means (channels,) of completed blocks, NaN if empty."""
        values = residuals(y)
        values[t < self._settled] = math.nan
        for at in t[np.asarray(y["started"]) > 0.0].tolist():
            if math.isnan(self._start):
                self._start = at + SETTLING_TIME
            else:
                self._anew = min(self._anew, at)
            self._settled = at + SETTLING_TIME
            # the sample of the restart itself shows the reason
            values[(t > at) & (t < self._settled)] = math.nan
        # after a gap the twin's controller is not where the robot's is
        values[t >= self._anew, list(CHANNELS).index(COMMAND_CHANNEL)] = math.nan
        yield from self._stretch(t, values)

    def change_rate(self) -> None:
        """Reset the expected number of samples per block, because the sampling rate has changed."""
        self._most = 0
        self._clear()

    def _stretch(self, t: NDArray[np.float64], values: NDArray[np.float64]) -> Iterator[tuple[float, NDArray]]:
        begin = int(np.searchsorted(t, self._start))
        while begin < len(t):
            end = int(np.searchsorted(t, self._start + BLOCK_LENGTH))
            part = values[begin:end]
            there = ~np.isnan(part)
            self._sums += np.where(there, part, 0.0).sum(axis=0)
            self._counts += there.sum(axis=0)
            self._samples += len(part)
            if end == len(t):
                return
            self._most = max(self._most, self._samples)
            if self._samples >= MIN_BLOCK_SHARE * self._most:
                with np.errstate(invalid="ignore"):
                    yield self._start + BLOCK_LENGTH, self._sums / self._counts
            # a gap of hours makes no blocks
            self._start += BLOCK_LENGTH * max(1.0, math.floor((t[end] - self._start) / BLOCK_LENGTH))
            self._clear()
            begin = end

    def _clear(self) -> None:
        self._sums[:], self._counts[:], self._samples = 0.0, 0.0, 0


def residuals(y: Columns) -> NDArray[np.float64]:
    """Collect the residuals of all channels (n, channels) from the filter's outputs; NaN if a channel has no value."""
    # a twin with a third-party controller has no commands
    command = y.get("residual_command", np.full(len(y["NIS"]), math.nan))
    spread = nis_per_count(y["NIS"], y["used"])
    single = {"residual_F": y["residual_F"], "NIS": spread, "residual_command": command}
    return np.column_stack([single[name] if name in single else y[name][:, i] for name, i, _ in CHANNELS.values()])


def nis_per_count(NIS: NDArray[np.float64], used: NDArray) -> NDArray[np.float64]:
    """Compute the NIS per new encoder count; 1 on average for a correct filter, NaN without new counts."""
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(NIS / used, dtype=float)


class ParameterFinder(Protocol):
    """Interface of the search for the changed parameter after an alarm."""

    def ask(self, since: float, t: float) -> None:
        """Start the search for the changed parameter in the samples since `since`, at `t` (s)."""

    def answer(self) -> str:
        """Return the result of the search for the changed parameter as a sentence; "" while the search is running."""


class ShadowWatch:
    """Watch on a robot: Page's cumulative sums over the block means, and the alarm's state machine.

    Args:
        per_hour: accepted rate of false alarms.
        gathering: number of blocks after an alarm that are collected for a re-identification.
        cooling: number of blocks after that without a watch.
        reidentifier: called once after each alarm.
        share: factor of threshold and tolerance; below 1 the rate of false alarms is not kept (for tests).

    Attributes:
        judged: number of blocks compared with the reference.
    """

    def __init__(
        self,
        limits: Tolerances,
        per_hour: float,
        gathering: int = 10,
        cooling: int = 10,
        reidentifier: ParameterFinder | None = None,
        share: float = 1.0,
    ):
        self.state, self.changes = WatchState.LISTENING, list[WatchEvent]()
        self.levels, self.judged = dict.fromkeys(CHANNELS, 0.0), 0
        self._limits, self._share = limits, share
        self._H = share * threshold(per_hour)
        self._gathering, self._cooling = gathering, cooling
        self._reidentifier = reidentifier
        self._normal: list[NDArray[np.float64]] = []
        self._sums = {name: _Sum() for name in CHANNELS}
        self._compares, self._learns = True, False
        self._interrupted = WatchState.LISTENING
        self._left, self._alarm = 0, WatchEvent(math.nan, WatchState.LISTENING)

    @property
    def alarms(self) -> list[WatchEvent]:
        return [change for change in self.changes if change.alarm]

    def add_block(self, t: float, means: Sequence[float] | NDArray[np.float64]) -> list[WatchEvent]:
        """Update the alarm's sums with a block that ended at `t` (s), and return the resulting changes of state."""
        first = len(self.changes)
        if self.state is WatchState.NOT_WATCHED:
            if t - BLOCK_LENGTH < self.changes[-1].t:
                # the samples ended within this block
                return []
            self._change_state(WatchEvent(t, self._interrupted))
        means = np.asarray(means, dtype=float)
        if len(self._normal) < FIRST_BLOCKS:
            self._normal.append(means)
            self._refuse_other_beginning(t)
        elif self.state in WAITING_STATES:
            self._wait(t)
        else:
            self._look(t, means)
        return self.changes[first:]

    def _refuse_other_beginning(self, t: float) -> None:
        """Stop comparing commands that differ in the first blocks: the programs did not begin together."""
        tolerance, sigma = self._limits.of_channel(COMMAND_CHANNEL)
        if self._compares and self._normal[-1][list(CHANNELS).index(COMMAND_CHANNEL)] > tolerance + self._H * sigma:
            self._compares = False
            self._change_state(
                WatchEvent(t, self.state, found=f"{UNCOMPARED_NOTE}: it did not begin with the robot's, or is another")
            )

    def change_tolerances(self, t: float, limits: Tolerances) -> None:
        self._limits = limits
        self.restart(t)

    def lose(self, t: float, why: str) -> None:
        """Suspend the watch at `t` (s) until the next block."""
        if self.state is not WatchState.NOT_WATCHED:
            self._interrupted = self.state
        self._change_state(WatchEvent(t, WatchState.NOT_WATCHED, found=why))

    def restart(self, t: float) -> None:
        """Restart the watch with a new reference after cooling down, because the twin has changed at `t` (s)."""
        self._learns = True
        self._cool(WatchEvent(t, WatchState.COOLING_DOWN, found="a new reference is learnt"))

    def _wait(self, t: float) -> None:
        self._left -= 1
        if self._left > 0:
            return
        if self.state is WatchState.COOLING_DOWN:
            self._change_state(WatchEvent(t, WatchState.LISTENING))
            if self._learns:
                self._learns, self._compares = False, True
                self._normal.clear()
            return
        found = UNKNOWN_PARAMETER
        if self._reidentifier is not None:
            if self.state is WatchState.GATHERING:
                # the sum's growth began within a block, which is partly from before the change
                self._reidentifier.ask(self._alarm.since + BLOCK_LENGTH, t)
            found = self._reidentifier.answer()
        if self.state is WatchState.GATHERING:
            self._change_state(WatchEvent(t, WatchState.REIDENTIFYING))
        if found:
            self._cool(WatchEvent(t, WatchState.COOLING_DOWN, found=found))

    def _cool(self, change: WatchEvent) -> None:
        self._change_state(change)
        self._left = self._cooling
        self._sums = {name: _Sum() for name in CHANNELS}
        self.levels = dict.fromkeys(CHANNELS, 0.0)

    def _look(self, t: float, means: NDArray[np.float64]) -> None:
        self.judged += 1
        with np.errstate(invalid="ignore"):
            shift = means - np.mean(self._normal, axis=0)
        for k, name in enumerate(CHANNELS):
            if name == COMMAND_CHANNEL and not self._compares:
                continue
            tolerance, sigma = self._limits.of_channel(name)
            K = self._share * tolerance + 0.5 * sigma
            # channels without tolerance or value are skipped
            if math.isfinite(shift[k] - K):
                self.levels[name] = self._add(name, t, float(shift[k]), K) / (self._H * sigma)
        worst = max(self.levels, key=lambda name: self.levels[name])
        level = self.levels[worst]
        if level > 1.0:
            self._alarm = self._evidence(t, WatchState.GATHERING, worst, level, alarm=True)
            self._change_state(self._alarm)
            self._left = self._gathering
        elif level > CONFIRMING_LEVEL and self.state is WatchState.LISTENING:
            self._change_state(self._evidence(t, WatchState.CONFIRMING, worst, level))
        elif level <= CONFIRMING_LEVEL and self.state is WatchState.CONFIRMING:
            self._change_state(WatchEvent(t, WatchState.LISTENING))

    def _add(self, name: str, t: float, shift: float, K: float) -> float:
        one = self._sums[name]
        one.taken.append(shift)
        for side, step in (("up", shift - K), ("low", -shift - K)):
            before = getattr(one, side)
            if before == 0.0:
                setattr(one, f"{side}_since", t - BLOCK_LENGTH)
            setattr(one, side, max(0.0, before + step))
        if one.up == 0.0 and one.low == 0.0:
            one.taken.clear()
        if name in ONE_SIDED_CHANNELS:
            one.low = 0.0
        return max(one.up, one.low)

    def _evidence(self, t: float, state: WatchState, name: str, level: float, alarm: bool = False) -> WatchEvent:
        one = self._sums[name]
        since = one.up_since if one.up >= one.low else one.low_since
        blocks = max(1, round((t - since) / BLOCK_LENGTH))
        return WatchEvent(t, state, name, level, since, float(np.mean(one.taken[-blocks:])), alarm=alarm)

    def _change_state(self, change: WatchEvent) -> None:
        self.state = change.state
        self.changes.append(change)
