"""Alignment of a robot's readings to samples by their stamps; counts of missing samples, and the drift of the clocks.

A sample is the robot's state at one stamp. It may arrive in several messages, of one topic or several, in any order,
twice, late or never; arrival times do not matter. A sample is complete when no earlier data can arrive: after the next
stamp in sequence, or after the lateness budget. An interval of more than 1.5 periods between stamps is a gap; readings
for it that arrive later are counted as late, and not used.

Clocks: the delay from stamp to arrival is never negative except for the offset of the clocks. The smallest delay of
each second belongs to a message that did not wait, so that these delays show the offset (least delay, as in the clock
filter of NTP: D. L. Mills, Computer Network Time Synchronization, 2006, sec. 3.3), and the shortest transport.
"""

import math
from bisect import bisect_left, bisect_right, insort
from collections import Counter, deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin.kernel.cosim.histogram import Histogram
from twin.kernel.recording.logs.log import GAP_RATIO, MIN_REGULAR_SHARE
from twin.kernel.recording.logs.topics import MAX_CLOCK_DIFFERENCE, MAX_OVERTAKING, MAX_OVERTAKING_PERIODS
from twin.kernel.recording.sources.signals import Reading

NS_PER_S = 10**9
MIN_INTERVALS, MAX_INTERVALS = 20, 101
"""Minimum number of intervals for a known period, and maximum number of intervals in its median."""
WHOLE_TOLERANCE, MIN_WHOLE_SHARE = 0.1, 0.9
"""Tolerance of multiples of an interval, and minimum share of multiples; random intervals have a share of 0.2."""
MIN_SINGLE_SHARE, MIN_MEDIAN_SHARE = 0.2, 0.5
"""The period is shorter than the median interval only if at least this share of all intervals are single periods, or
less than `MIN_MEDIAN_SHARE` are near the median."""
MIN_PERIOD_CHANGE = 0.1
"""Relative change of the period above which earlier losses are counted again with the new period."""
RESTART_MESSAGES, SET_BACK_MESSAGES = 3, 10
"""Number of successive messages of another clock for a restart, or a clock set back by less than `MAX_OVERTAKING`."""
MIN_ADVANCE = 10.0
"""Minimum advance of stamps against arrivals (s) for a clock that was set while its delay is unknown."""
MIN_KNOWN_ADVANCE = 0.1
"""The same once the least delay is known: a delay may grow, but cannot fall this much below its minimum (s)."""
LEARNING_TIME = 2.0
"""Maximum time (s) that the first readings of a log wait for the periods of their topics."""
MAX_SIDE_READINGS = 1000
"""Maximum number of readings that wait for their sample."""
FLOOR_SECONDS = 5
"""Number of seconds whose smallest delay is the delay without waiting."""
MIN_DRIFT_SECONDS = 10
"""Minimum time for a drift (s)."""
NO_COLUMNS: frozenset[int] = frozenset()


class Sample(NamedTuple):
    """State of the robot at one stamp, assembled from its messages; missing values are NaN.

    `t` is the time since the first sample (ns); after a restart of the robot's clock it continues by arrivals.
    `arrived` is the arrival of the last message, `due` the time of the decision that the sample is complete (ns).
    """

    t: int
    row: list[float]
    arrived: int
    due: int


@dataclass
class Counts:
    """Counts of a session's complete samples, and of its readings.

    Attributes:
        gaps, missing: intervals without samples, and samples missing in them.
        incomplete: samples without all readings after the budget; they are missing, too.
        unmatched: incomplete samples before the first complete one: messages of two topics are matched by their stamps
            once their periods are known. The largest number over the topics.
        duplicates: repeated readings.
        out_of_order: readings that arrived after later ones.
        late: readings that arrived after the budget.
        invalid: samples with a needed value that is not finite.
    """

    samples: int = 0
    gaps: int = 0
    missing: int = 0
    incomplete: int = 0
    unmatched: int = 0
    duplicates: int = 0
    out_of_order: int = 0
    late: int = 0
    invalid: int = 0
    restarts: int = 0


class Clocks:
    """Comparison of the robot's clock with the local one.

    `lateness` is the histogram of the messages' delays in excess of the delay without a queue.
    """

    def __init__(self) -> None:
        self.lateness = Histogram()
        self.restart()

    def restart(self) -> None:
        """Forget the robot's previous clock, whose comparison is invalid after a restart."""
        self._first: int | None = None
        self._least: list[int] = []
        self._second = -1
        self._sums = [0.0] * 5
        self._floors: deque[int] = deque(maxlen=FLOOR_SECONDS)

    def add(self, stamp: int, arrived: int) -> None:
        """Add the stamp and the arrival time of a message (ns) to the comparison of the clocks."""
        delay = arrived - stamp
        if self._first is None:
            self._first, self._offset_0 = arrived, delay
        second = (arrived - self._first) // NS_PER_S
        if second > self._second:
            self._finish_second()
            self._second = second
            self._floors.append(delay)
        elif delay < self._floors[-1]:
            self._floors[-1] = delay
        self.lateness.add((delay - min(self._floors)) / NS_PER_S)

    def _finish_second(self) -> None:
        if self._second >= 0:
            x, y = float(self._second), float(self._floors[-1] - self._offset_0)
            for k, term in enumerate((1.0, x, y, x * x, x * y)):
                self._sums[k] += term

    @property
    def offset(self) -> float:
        """Lag of the robot's clock behind the local clock, with the shortest transport (s); NaN without messages."""
        return min(self._floors) / NS_PER_S if self._floors else math.nan

    @property
    def drift(self) -> float:
        """Drift of the robot's clock against the local one (s/s), positive for a slow robot clock; NaN until known."""
        n, x, y, xx, xy = self._sums
        determinant = n * xx - x * x
        if n < MIN_DRIFT_SECONDS or determinant <= 0.0:
            return math.nan
        return (n * xy - x * y) / determinant / NS_PER_S


@dataclass(order=True, slots=True)
class _PartialSample:
    """Sample with some readings still missing."""

    stamp: int
    row: list[float] = field(compare=False)
    there: frozenset[int] = field(compare=False)
    arrived: int = field(compare=False)


@dataclass
class _ReadingStream:
    """Readings of one topic with the same columns; the columns in `there` are needed."""

    there: frozenset[int]
    newest: int = 0
    stamps: deque[int] = field(default_factory=lambda: deque(maxlen=MAX_INTERVALS))
    since: int = 0
    period: float = math.inf

    def add(self, stamp: int) -> None:
        self.stamps.append(stamp)
        self.newest = max(self.newest, stamp)
        self.since += 1
        if self.since > MIN_INTERVALS and (math.isinf(self.period) or self.since > MAX_INTERVALS):
            self.since = 0
            self.period = _period(b - a for a, b in pairwise(sorted(self.stamps)))


def _period(intervals: Iterable[int]) -> float:
    """Estimate the sampling interval (ns) from intervals with gaps, as if without; infinite if they are irregular.

    It is the median. If most intervals are several times as long, because of losses, it is their common divisor. A late
    message causes one long and one short interval, which is not sufficient. Jittering stamps are not multiples of their
    shortest interval; two publishers cause no double intervals.
    """
    lengths = sorted(intervals)
    median = _median(lengths)
    if 0 < lengths[0] < median / GAP_RATIO:
        single = _divisor(lengths[: bisect_right(lengths, 3.5 * lengths[0])], lengths[0])
        times = [round(one / single) for one in lengths]
        whole = sum(abs(one - k * single) <= WHOLE_TOLERANCE * single for one, k in zip(lengths, times, strict=True))
        usual = bisect_right(lengths, 1.25 * median) - bisect_left(lengths, 0.75 * median)
        often = times.count(1) >= MIN_SINGLE_SHARE * len(lengths) or usual < MIN_MEDIAN_SHARE * len(lengths)
        if whole >= MIN_WHOLE_SHARE * len(lengths) and 2 in times and often:
            return _divisor(lengths, single)
    near = lengths[bisect_left(lengths, 0.5 * median) : bisect_right(lengths, 1.5 * median)]
    # gaps among the intervals move the median of all
    return _median(near) if len(near) >= MIN_REGULAR_SHARE * len(lengths) else math.inf


def _median(lengths: Sequence[int]) -> float:
    return 0.5 * (lengths[(len(lengths) - 1) // 2] + lengths[len(lengths) // 2])


def _divisor(lengths: Sequence[int], single: float) -> float:
    """Find the common divisor of `lengths` (ns), near `single`."""
    return sum(lengths) / sum(round(one / single) for one in lengths)


@dataclass(slots=True)
class _Interval:
    """Interval between two samples (ns), and the number of samples missing in it; None if the period was unknown."""

    length: int
    missing: int | None


class Aligner:
    """Alignment of readings from several messages to samples, by their stamps.

    Attributes:
        clocks: clocks by the needed columns.
        gaps: (start, end) of new gaps, ns since the first sample.
        period: sampling period (ns); infinite if unknown or irregular.
        clock_step: step of the robot's clock at the last restart (s).
        lacking: needed columns missing in the last incomplete sample; empty after a complete one.
    """

    def __init__(self, width: int, needed: Sequence[int], lateness: float, learns_first: bool = False):
        """Create an aligner for rows of `width` values, still without readings.

        Args:
            needed: needed columns of a sample. Other columns belong to the first sample at or after their stamp.
            lateness: budget (s) for late readings.
            learns_first: whether the first readings wait for the periods, so that no row of several topics is lost.
        """
        self._waiting: list[tuple[str, int, Reading]] | None = [] if learns_first else None
        self._learning: dict[tuple[str, tuple[int, ...]], _ReadingStream] = {}
        self._width, self._needed, self._budget = width, frozenset(needed), round(lateness * NS_PER_S)
        self._pending: list[_PartialSample] = []
        self._unmatched: Counter[frozenset[int]] = Counter()
        self._streams: dict[tuple[str, tuple[int, ...]], _ReadingStream] = {}
        self._sides: dict[tuple[str, tuple[int, ...]], deque[Reading]] = {}
        self._last = self._last_arrived = self._due = -1
        self._base: int | None = None
        self._after_restart: int | None = None
        self._suspects: list[tuple[str, int, Reading]] = []
        self._intervals: deque[_Interval] = deque(maxlen=MAX_INTERVALS)
        self._gap_start, self._after_gap, self._watched_after_gap = 0, 0, 0
        self.clock_step, self.lacking = 0.0, NO_COLUMNS
        self._recent: deque[int] = deque(maxlen=MAX_INTERVALS)
        self._learnt = 0
        self.period = math.inf
        self.counts, self.clocks = Counts(), Clocks()
        self.gaps: list[tuple[int, int]] = []

    @property
    def base(self) -> int:
        """Stamp of the first sample, time 0 of the session (ns); 0 before it."""
        return self._base or 0

    @property
    def due(self) -> int | None:
        """Deadline for completing the next sample (ns, by the clock of arrivals); None without a pending sample."""
        return self._pending[0].arrived + self._budget if self._pending else None

    def add(self, topic: str, arrived: int, reading: Reading) -> list[Sample]:
        """Add a reading of a topic, and return the samples that it completes, in order."""
        if not reading.columns:
            return []
        if self._waiting is None:
            return self._add(topic, arrived, reading)
        self._waiting.append((topic, arrived, reading))
        return self._begin() if self._knows_periods(topic, arrived, reading) else []

    def _knows_periods(self, topic: str, arrived: int, reading: Reading) -> bool:
        """Check whether waiting readings can be aligned: the periods of all needed columns are known, or not needed."""
        assert self._waiting is not None
        key, there = (topic, reading.columns), self._needed.intersection(reading.columns)
        stream = self._learning.setdefault(key, _ReadingStream(there))
        stream.add(reading.stamp)
        known = NO_COLUMNS.union(*(one.there for one in self._learning.values() if one.period < math.inf))
        is_long = arrived - self._waiting[0][1] > LEARNING_TIME * NS_PER_S or len(self._waiting) >= MAX_SIDE_READINGS
        return there == self._needed or known == self._needed or is_long

    def _begin(self) -> list[Sample]:
        """Add the readings that waited for the periods, and return the completed samples."""
        waiting, self._waiting = self._waiting or [], None
        self._streams |= {key: _ReadingStream(one.there, period=one.period) for key, one in self._learning.items()}
        return [sample for one in waiting for sample in self._add(*one)]

    def _add(self, topic: str, arrived: int, reading: Reading) -> list[Sample]:
        key = topic, reading.columns
        stream = self._stream(key)
        if not stream.there:
            stream.add(reading.stamp)
            side = self._sides.setdefault(key, deque(maxlen=MAX_SIDE_READINGS))
            if len(side) == side.maxlen:
                # without samples the oldest are dropped
                side.popleft()
            # two publishers, or a network, may reorder messages
            insort(side, reading)  # type: ignore[arg-type]
            return self.ready_samples(arrived) if self._pending else []
        if enough := self._messages_to_restart(reading.stamp, arrived):
            self._suspects.append((topic, arrived, reading))
            self._count_late(reading.stamp)
            if len(self._suspects) < enough:
                return []
            return self._restart(arrived)
        self._suspects.clear()
        self._place(stream, arrived, reading)
        return self.ready_samples(arrived)

    def ready_samples(self, now: int, end: bool = False) -> list[Sample]:
        """Return the pending samples that are complete because no earlier data can arrive; at the source's `end`, all.

        `now` is the present time (ns, by the clock of arrivals).
        """
        found = self._begin() if end and self._waiting else []
        while self._pending:
            head = self._pending[0]
            complete = head.there == self._needed
            if not (end or now - head.arrived >= self._budget or (complete and self._is_next(head.stamp))):
                break
            del self._pending[0]
            self._due = max(self._due, min(now, head.arrived + self._budget))
            invalid = not all(map(math.isfinite, map(head.row.__getitem__, head.there)))
            self.counts.invalid += invalid
            if not complete:
                if self._base is not None:
                    self.counts.incomplete += not invalid
                elif not invalid:
                    # until the periods are known, topics cannot be matched
                    self._unmatched[head.there] += 1
                    self.counts.unmatched = max(self._unmatched.values())
                self.lacking = self._needed - head.there
            elif not invalid:
                found.append(self._sample(head))
        return found

    def _stream(self, key: tuple[str, tuple[int, ...]]) -> _ReadingStream:
        stream = self._streams.get(key)
        if stream is None:
            stream = self._streams[key] = _ReadingStream(self._needed.intersection(key[1]))
        return stream

    def _place(self, stream: _ReadingStream, arrived: int, reading: Reading) -> None:
        self.clocks.add(reading.stamp, arrived)
        there = stream.there
        partial = self._partial(reading.stamp, there, stream.period) if self._pending else None
        if partial is not None and partial.there & there:
            self.counts.duplicates += 1
            return
        self.counts.out_of_order += reading.stamp < stream.newest
        stream.add(reading.stamp)
        if partial is None:
            partial = _PartialSample(reading.stamp, [math.nan] * self._width, NO_COLUMNS, arrived)
            insort(self._pending, partial)
        for column, value in zip(reading.columns, reading.values, strict=True):
            partial.row[column] = value
        if partial.stamp != reading.stamp and min(self._needed) in there:
            # a sample has the stamp of its first column
            partial.stamp = reading.stamp
            self._pending.sort()
        partial.there |= there
        partial.arrived = arrived

    def _partial(self, stamp: int, there: frozenset[int], period: float) -> _PartialSample | None:
        """Find the pending sample of a reading: of equal stamp, or of a near one with the reading's columns missing."""
        nearest = None
        for one in self._pending:
            if one.stamp == stamp:
                return one
            near = abs(one.stamp - stamp) < 0.5 * period < math.inf
            if near and there != self._needed and not one.there & there:
                nearest = one
        return nearest

    def _is_next(self, stamp: int) -> bool:
        """Check whether the sample at `stamp` is next in sequence and all its other readings have arrived."""
        # the sequence is unknown at first
        if self._learnt < MIN_INTERVALS or (self._last >= 0 and stamp - self._last > GAP_RATIO * self.period):
            return False
        for key in self._sides:
            stream = self._streams[key]
            # without a period any later reading is possible
            if stream.newest + 0.5 * stream.period <= stamp:
                return False
        return True

    def _sample(self, head: _PartialSample) -> Sample:
        for readings in self._sides.values():
            newest = None
            while readings and readings[0].stamp <= head.stamp:
                newest = readings.popleft()
            if newest is not None:
                for column, value in zip(newest.columns, newest.values, strict=True):
                    head.row[column] = value
        if self._base is None:
            # after a restart time continues by arrivals
            self._base = head.stamp - (self._after_restart or 0)
        elif self._last >= 0:
            self._note_interval(head.stamp)
        self._last, self._last_arrived = head.stamp, head.arrived
        self._recent.append(head.stamp)
        self.counts.samples += 1
        self.lacking = NO_COLUMNS
        return Sample(head.stamp - self._base, head.row, head.arrived, self._due)

    def _note_interval(self, stamp: int) -> None:
        assert self._base is not None
        length = stamp - self._last
        self._intervals.append(_Interval(length, None if math.isinf(self.period) else 0))
        if length > GAP_RATIO * self.period:
            self._count(self._intervals[-1], self._missing_in(length))
            self.gaps.append((self._last - self._base, stamp - self._base))
            self._gap, self._gap_start, self._after_gap = self._intervals[-1], self._last, 0
            self._watched_after_gap = 2 * self._missing_in(length) + 2
        elif self._after_gap < self._watched_after_gap:
            # a robot that stamps when it sends makes up for a stall: nothing was lost
            self._after_gap += 1
            lost = round((stamp - self._gap_start) / self.period) - 1 - self._after_gap
            self._count(self._gap, max(0, min(lost, self._gap.missing or 0)))
        self._learnt += 1
        if self._learnt % MIN_INTERVALS == 0:
            self._learn_period()

    def _learn_period(self) -> None:
        before, self.period = self.period, _period(one.length for one in self._intervals)
        if math.isinf(self.period) or abs(self.period - before) <= MIN_PERIOD_CHANGE * before < math.inf:
            return
        for one in self._intervals:
            # losses before the period was known, and losses counted with the previous period
            missing = self._missing_in(one.length)
            self._count(one, missing if one.missing is None else min(one.missing, missing))

    def _missing_in(self, length: int) -> int:
        """Compute the number of samples missing in an interval of `length` (ns)."""
        return max(1, round(length / self.period) - 1) if length > GAP_RATIO * self.period else 0

    def _count(self, interval: _Interval, missing: int) -> None:
        before = interval.missing or 0
        self.counts.missing += missing - before
        self.counts.gaps += (missing > 0) - (before > 0)
        interval.missing = missing

    def _messages_to_restart(self, stamp: int, arrived: int) -> int:
        """Return how many successive messages like this one make a restart of the robot's clock; 0 if it fits."""
        if self._last < 0:
            return 0
        if stamp > self._last:
            known = (
                self._learnt >= MIN_INTERVALS and arrived - stamp < (self.clocks.offset - MIN_KNOWN_ADVANCE) * NS_PER_S
            )
            jumped = (stamp - self._last) - (arrived - self._last_arrived) > MIN_ADVANCE * NS_PER_S
            return RESTART_MESSAGES if known or jumped else 0
        back = max(MAX_OVERTAKING * NS_PER_S, MAX_OVERTAKING_PERIODS * self.period if self.period < math.inf else 0.0)
        # a delay this long means another clock
        if stamp < self._last - back and arrived - stamp > (self.clocks.offset + MAX_CLOCK_DIFFERENCE) * NS_PER_S:
            return RESTART_MESSAGES
        # overtaken messages arrive between newer ones and out of order
        return SET_BACK_MESSAGES if not self._suspects or stamp > self._suspects[-1][2].stamp else 2 * SET_BACK_MESSAGES

    def _count_late(self, stamp: int, by: int = 1) -> None:
        """Count a late message, at or before the last sample."""
        if stamp <= self._last:
            known = stamp in self._recent
            self.counts.duplicates += by * known
            self.counts.late += by * (not known)

    def _restart(self, arrived: int) -> list[Sample]:
        """Complete the samples of the robot's previous clock, begin with the new clock's messages; return samples."""
        found = self.ready_samples(arrived, end=True)
        suspects, self._suspects = self._suspects, []
        for _, _, reading in suspects:
            # undo the count: they were not late, but of another clock
            self._count_late(reading.stamp, -1)
        self.clock_step = self.clocks.offset - (suspects[0][1] - suspects[0][2].stamp) / NS_PER_S
        assert self._base is not None
        passed = max(suspects[0][1] - self._last_arrived, 1)
        self._after_restart = self._last - self._base + passed
        self._base, self._last = None, -1
        self._streams.clear()
        self._sides.clear()
        self.clocks.restart()
        self.counts.restarts += 1
        for topic, when, reading in suspects:
            self._place(self._stream((topic, reading.columns)), when, reading)
        return found + self.ready_samples(arrived)


def stack_samples(samples: Sequence[Sample]) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Stack samples into arrays: times (n,), ns, and rows (n, width)."""
    times = np.array([sample.t for sample in samples], dtype=np.int64)
    return times, np.array([sample.row for sample in samples], dtype=np.float64)
