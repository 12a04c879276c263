"""When have robot and twin parted? A sum over means of prior residuals, its threshold by the rate of false alarms.

E. S. Page, Continuous inspection schemes, Biometrika 41 (1954) 100. With r_n the mean residual of block n and r_0 that
of the first blocks,

    up_n = max(0, up_(n-1) + (r_n - r_0) - K),  low_n = max(0, low_(n-1) - (r_n - r_0) - K),  K = tolerance + sigma/2,

and the alarm is a sum beyond H sigma. D. Siegmund, Sequential Analysis (1985), sec. 2.4 and (10.18): blocks from one
false alarm to the next on one side, of a residual that stays at the very edge of its tolerance,

    ARL = 2 (e^b - 1 - b),  b = H + 1.166.

The tolerance is that of a fleet of healthy robots (`fleet`), sigma how far its block means differ
from one to the next.
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
"""s: as long as those of a replay."""
FIRST_BLOCKS = 2
"""They say what is normal for this robot: zeros of encoders and motors are in every block alike."""
SETTLING_TIME = 0.5
"""s after a start of the filter in which residuals do not count."""
MIN_BLOCK_SHARE = 0.5
"""Share of a block's samples without which it is none."""
RATE_RESERVE = 5.0
"""A threshold is chosen for a fifth of the rate that was asked: blocks are neither normal nor independent."""
CONFIRMING_LEVEL = 0.5
"""Share of the threshold from which on a sum is worth watching."""

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
"""Residuals that are watched: the filter's output, which of its values, unit. `spread` is NIS by the counts in it;
`command` how far the robot's commands are from those of the twin's own controller."""
ONE_SIDED_CHANNELS = ("spread", COMMAND_CHANNEL)
"""Less of these is no news."""
SUM_COUNT = 2 * len(CHANNELS) - len(ONE_SIDED_CHANNELS)
"""Sums that may alarm."""
RATE_ERROR = 0.1
"""Relative difference of a measured rate to one that has tolerances."""
UNKNOWN_PARAMETER = "which parameter is not known"


def run_length(H: float) -> float:
    """Blocks from one false alarm of one sum to the next, at the edge of the tolerance; `H`: threshold by sigma."""
    b = H + 1.166
    return 2.0 * (math.expm1(b) - b)


def threshold(
    per_hour: float, block: float = BLOCK_LENGTH, sides: int = SUM_COUNT, reserve: float = RATE_RESERVE
) -> float:
    """H, by sigma, for so many false alarms an hour of all `sides` together.

    Raises:
        InputRefused: no rate that can be asked.
    """
    if not 1e-6 <= per_hour <= 100.0:
        raise InputRefused(f"{per_hour:g} false alarms an hour: expected 1e-6 to 100")
    wanted = 3600.0 / block * sides * reserve / per_hour
    low, high = 0.0, 60.0
    while high - low > 1e-9:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if run_length(middle) < wanted else (low, middle)
    return high


@dataclass(frozen=True)
class Tolerances:
    """What is no news, by channel, in its own unit.

    Attributes:
        tolerance: largest change of a block's mean of healthy robots.
        sigma: deviation of a block's mean.
    """

    tolerance: Mapping[str, float]
    sigma: Mapping[str, float]


RateTolerances = Mapping[float, Tolerances]
"""Tolerances by sampling rate (Hz)."""


def rate_of(t: NDArray[np.float64]) -> float:
    """The sampling rate (Hz) of stamps `t` (n,), s: by the median interval; NaN if there is none."""
    return 1.0 / float(np.median(np.diff(t))) if len(t) > 1 else math.nan


def tolerances_at(limits: RateTolerances, rate: float) -> Tolerances | None:
    """Tolerances for a measured rate (Hz); None if no rate is near."""
    nearest = min(limits, key=lambda one: abs(one - rate), default=math.nan)
    return limits[nearest] if abs(nearest - rate) <= RATE_ERROR * rate else None


class WatchState(StrEnum):
    """What the watch is doing."""

    LISTENING = "listening"
    CONFIRMING = "confirming"
    GATHERING = "gathering"
    REIDENTIFYING = "re-identifying"
    COOLING_DOWN = "cooling down"
    NOT_WATCHED = "not watched"


WAITING_STATES = (WatchState.GATHERING, WatchState.REIDENTIFYING, WatchState.COOLING_DOWN)
"""In these no sum is looked at."""


@dataclass(frozen=True)
class WatchEvent:
    """A change of state, with its evidence.

    Attributes:
        t: when (s).
        state: from now on.
        channel: whose sum it is, "" if none.
        level: that sum by its threshold.
        since: when the sum began to grow (s).
        size: mean residual since then less what is normal, in the channel's unit.
        found: what was re-identified.
        alarm: whether this is an alarm.
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
        """A sentence."""
        if not self.channel:
            return f"{self.state}{f': {self.found}' if self.found else ''}"
        unit = "" if CHANNELS[self.channel][2] == "1" else f" {CHANNELS[self.channel][2]}"
        what = "robot and twin have parted" if self.alarm else f"{self.state}"
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
    """Means of the filter's outputs over blocks of time, sample by sample or slice by slice.

    Args:
        length: of a block (s).
    """

    def __init__(self, length: float = BLOCK_LENGTH):
        self._length = length
        self._start, self._settled = math.nan, -math.inf
        self._sums, self._counts, self._samples = np.zeros(len(CHANNELS)), np.zeros(len(CHANNELS)), 0
        self._most, self._anew = 0, math.inf

    def add_samples(self, t: NDArray[np.float64], y: Columns) -> Iterator[tuple[float, NDArray[np.float64]]]:
        """End (s) and means (channels,) of each block that ends within these samples; NaN where a channel had none.

        Args:
            t: times (n,), s, ascending, after those before.
            y: what the filter said then.
        """
        values = residuals(y)
        values[t < self._settled] = math.nan
        for at in t[np.asarray(y["started"]) > 0.0].tolist():
            if math.isnan(self._start):
                self._start = at + SETTLING_TIME
            else:
                self._anew = min(self._anew, at)
            self._settled = at + SETTLING_TIME
            # the sample at which it starts anew tells why
            values[(t > at) & (t < self._settled)] = math.nan
        # after a gap the twin's controller is not where the robot's is
        values[t >= self._anew, list(CHANNELS).index(COMMAND_CHANNEL)] = math.nan
        yield from self._stretch(t, values)

    def change_rate(self) -> None:
        """Forget how many samples a full block has."""
        self._most = 0
        self._clear()

    def _stretch(self, t: NDArray[np.float64], values: NDArray[np.float64]) -> Iterator[tuple[float, NDArray]]:
        begin = int(np.searchsorted(t, self._start))
        while begin < len(t):
            end = int(np.searchsorted(t, self._start + self._length))
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
                    yield self._start + self._length, self._sums / self._counts
            # of hours without a sample there is no block
            self._start += self._length * max(1.0, math.floor((t[end] - self._start) / self._length))
            self._clear()
            begin = end

    def _clear(self) -> None:
        self._sums[:], self._counts[:], self._samples = 0.0, 0.0, 0


def residuals(y: Columns) -> NDArray[np.float64]:
    """Of every channel at every sample, (n, channels); NaN where there was none."""
    # not every twin has a controller of its own
    command = y.get("residual_command", np.full(len(y["NIS"]), math.nan))
    spread = nis_per_count(y["NIS"], y["used"])
    single = {"residual_F": y["residual_F"], "NIS": spread, "residual_command": command}
    return np.column_stack([single[name] if name in single else y[name][:, i] for name, i, _ in CHANNELS.values()])


def nis_per_count(NIS: NDArray[np.float64], used: NDArray) -> NDArray[np.float64]:
    """The filter's outputs of these names, divided; 1 on average if it is right, NaN where no count was new."""
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(NIS / used, dtype=float)


class ParameterFinder(Protocol):
    """What says which parameter has moved."""

    def ask(self, since: float, t: float) -> None:
        """Look at what has come since `since`, at `t` (s)."""

    def answer(self) -> str:
        """What was found, a sentence; "": it is not known yet."""


class ShadowWatch:
    """Page's sums over the block means of a robot, and what follows from them.

    Args:
        limits: what is no news.
        per_hour: false alarms that the user bears.
        gathering: blocks after an alarm that are kept for a re-identification.
        cooling: blocks after that in which nothing is looked at.
        reidentifier: asked once after an alarm.
        block: s.
        share: of threshold and tolerance; less than 1 breaks the promise, for trials.
    """

    def __init__(
        self,
        limits: Tolerances,
        per_hour: float,
        gathering: int = 10,
        cooling: int = 10,
        reidentifier: ParameterFinder | None = None,
        block: float = BLOCK_LENGTH,
        share: float = 1.0,
    ):
        self.state, self.changes = WatchState.LISTENING, list[WatchEvent]()
        self.levels = dict.fromkeys(CHANNELS, 0.0)
        self._limits, self._block, self._share = limits, block, share
        self._H = share * threshold(per_hour, block)
        self._gathering, self._cooling = gathering, cooling
        self._reidentifier = reidentifier
        self._normal: list[NDArray[np.float64]] = []
        self._sums = {name: _Sum() for name in CHANNELS}
        self._compares, self._learns = True, False
        self._interrupted = WatchState.LISTENING
        self._left, self._alarm = 0, WatchEvent(math.nan, WatchState.LISTENING)

    @property
    def alarms(self) -> list[WatchEvent]:
        """Those so far."""
        return [change for change in self.changes if change.alarm]

    def add_block(self, t: float, means: Sequence[float] | NDArray[np.float64]) -> list[WatchEvent]:
        """A block that ended at `t` (s) with `means` by channel: what changes."""
        first = len(self.changes)
        if self.state is WatchState.NOT_WATCHED:
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
        """Robot and twin did not begin together if their commands differ from the first blocks on."""
        tolerance, sigma = (
            self._limits.tolerance.get(COMMAND_CHANNEL, math.nan),
            self._limits.sigma.get(COMMAND_CHANNEL, math.nan),
        )
        if self._compares and self._normal[-1][list(CHANNELS).index(COMMAND_CHANNEL)] > tolerance + self._H * sigma:
            self._compares = False
            self._change_state(
                WatchEvent(t, self.state, found=f"{UNCOMPARED_NOTE}: it did not begin with the robot's, or is another")
            )

    def change_tolerances(self, t: float, limits: Tolerances) -> None:
        """Listen anew with other tolerances, from `t` (s) on."""
        self._limits = limits
        self.restart(t)

    def lose(self, t: float, why: str) -> None:
        """Nothing is watched from `t` (s) on, until the next block."""
        self._interrupted = self.state
        self._change_state(WatchEvent(t, WatchState.NOT_WATCHED, found=why))

    def restart(self, t: float) -> None:
        """The twin has changed at `t` (s): what is normal for it is learnt anew, after cooling down."""
        self._learns = True
        self._cool(WatchEvent(t, WatchState.COOLING_DOWN, found="it listens anew after that"))

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
                # of the block in which the sum began to grow a part is of before
                self._reidentifier.ask(self._alarm.since + self._block, t)
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
        with np.errstate(invalid="ignore"):
            shift = means - np.mean(self._normal, axis=0)
        for k, name in enumerate(CHANNELS):
            if name == COMMAND_CHANNEL and not self._compares:
                continue
            tolerance, sigma = self._limits.tolerance.get(name, math.nan), self._limits.sigma.get(name, math.nan)
            K = self._share * tolerance + 0.5 * sigma
            # a channel that the fleet did not have, or that is silent, says nothing
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
                setattr(one, f"{side}_since", t - self._block)
            setattr(one, side, max(0.0, before + step))
        if one.up == 0.0 and one.low == 0.0:
            one.taken.clear()
        if name in ONE_SIDED_CHANNELS:
            one.low = 0.0
        return max(one.up, one.low)

    def _evidence(self, t: float, state: WatchState, name: str, level: float, alarm: bool = False) -> WatchEvent:
        one = self._sums[name]
        since = one.up_since if one.up >= one.low else one.low_since
        blocks = max(1, round((t - since) / self._block))
        return WatchEvent(t, state, name, level, since, float(np.mean(one.taken[-blocks:])), alarm=alarm)

    def _change_state(self, change: WatchEvent) -> None:
        self.state = change.state
        self.changes.append(change)
