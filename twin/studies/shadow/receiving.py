"""Reception of messages: samples as soon as they are complete, and the state estimate of each sample at once.

With a live robot, reception has its own thread; recording and display take its results in slices.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from threading import Lock, Thread

from twin.kernel.cosim.histogram import Histogram
from twin.kernel.recording.logs.log import LogError
from twin.kernel.recording.sources.arrival import Arrival, RobotSource
from twin.kernel.recording.sources.signals import MessageReader, Reading
from twin.kernel.recording.sources.stamps import Aligner, Sample
from twin.studies.shadow.mapping import NS_PER_SECOND

SLICE_TIME = 0.05
"""Length of a slice of arrivals (s)."""


@dataclass
class ReceivedSlice:
    """Messages and samples received since the last slice.

    Attributes:
        samples: completed samples, in order.
        late: delays after their samples (s) of the estimates that missed their deadline.
    """

    arrivals: list[Arrival] = field(default_factory=list)
    samples: list[Sample] = field(default_factory=list)
    unread: list[str] = field(default_factory=list)
    late: list[float] = field(default_factory=list)


class Receiver:
    """Receiver of a source's messages, which assembles samples and has them estimated at once.

    The deadline of an estimate is one period after its sample is due: after the message that completed it or the
    previous one, or after the waiting time.

    Args:
        readers: reader by topic.
        estimate: called with each sample in the receiving thread; None if estimates are not urgent.

    Attributes:
        in_hand: times from due samples to their estimates, after the session first caught up.
        thread: receiving thread, started for a live robot.
        missed: number of estimates after their deadline.
        lock: guards the aligner and its counts.
        heard: arrival of the last message by topic, ns.
    """

    def __init__(
        self,
        source: RobotSource,
        readers: Mapping[str, MessageReader],
        aligner: Aligner,
        estimate: Callable[[Sample], None] | None,
    ):
        self._source, self._readers, self._aligner, self._estimate = source, readers, aligner, estimate
        self._received = ReceivedSlice()
        self._failure: BaseException | None = None
        self._alive, self.thread = True, Thread(target=self._receive_loop, name="receiver", daemon=True)
        self.in_hand, self.missed, self.lock = Histogram(), 0, Lock()
        self._on_time = False
        self.heard: dict[str, int] = {}

    def stop(self) -> None:
        """Stop receiving messages; the last slice can still be drained."""
        self._alive = False
        if self.thread.is_alive():
            self.thread.join()

    def drain(self, end: bool = False) -> ReceivedSlice:
        """Return all messages and samples received since the last call; `end`: whether the source has ended."""
        with self.lock:
            if self._failure is not None:
                raise self._failure
            if end:
                self._deliver(self._aligner.ready_samples(self._source.now_ns(), end=True))
            taken, self._received = self._received, ReceivedSlice()
        return taken

    def receive_once(self) -> None:
        """Wait briefly for messages, and turn them into samples."""
        wait = SLICE_TIME
        if self._aligner.due is not None:
            wait = min(wait, max(0.0, (self._aligner.due - self._source.now_ns()) / NS_PER_SECOND))
        arrivals = self._source.receive(wait)
        # messages queued before the start have no deadline
        self._on_time |= len(arrivals) < 2 and self._aligner.period < math.inf
        with self.lock:
            self._received.arrivals += arrivals
            for one in arrivals:
                self.heard[one.topic] = one.arrived
                reading = one.data if isinstance(one.data, Reading) else self._read_message(one)
                self._deliver(self._aligner.add(one.topic, one.arrived, reading))
            if self._estimate is not None:
                self._deliver(self._aligner.ready_samples(self._source.now_ns()))

    def _deliver(self, samples: list[Sample]) -> None:
        if self._estimate is not None:
            for sample in samples:
                self._estimate(sample)
                if not self._on_time:
                    continue
                taken = (self._source.now_ns() - sample.due) / NS_PER_SECOND
                self.in_hand.add(taken)
                if taken > self._aligner.period / NS_PER_SECOND:
                    self.missed += 1
                    self._received.late.append(taken)
        self._received.samples += samples

    def _read_message(self, arrival: Arrival) -> Reading:
        try:
            return self._readers[arrival.topic].read_message(arrival.data, arrival.arrived)
        except LogError as problem:
            if not self._aligner.counts.samples:
                raise
            # one bad message must not end a session
            self._received.unread.append(str(problem))
            return Reading(arrival.arrived, (), ())

    def _receive_loop(self) -> None:
        try:
            while self._alive and not self._source.at_end:
                self.receive_once()
        except BaseException as problem:
            self._failure = problem
