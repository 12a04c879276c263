"""Samples that are estimated at once, how long that takes, and what comes of messages that cannot be read."""

import os
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest

from tests.conftest import ROOT
from tests.studies.replay.logs import FIG4, ran
from tests.studies.shadow.test_following import EXPERIMENT, MODEL, said
from twin.kernel.cosim.port import width
from twin.kernel.errors import InputRefused
from twin.kernel.recording.logs.log import LogError
from twin.kernel.recording.reader import read
from twin.kernel.recording.sources.arrival import Arrival, SteadyClock
from twin.kernel.recording.sources.signals import Reading
from twin.kernel.recording.sources.stamps import Aligner, Sample, stack_samples
from twin.studies.replay.sample_columns import INPUTS
from twin.studies.replay.samples import RobotSamples
from twin.studies.shadow.ahead import SessionBranches
from twin.studies.shadow.following import Twin, twin_of
from twin.studies.shadow.mapping import ENCODER_COLUMNS, NS_PER_SECOND
from twin.studies.shadow.receiving import Receiver
from twin.studies.shadow.session import Session
from twin.studies.shadow.verdict import SessionSummary

MS = 1_000_000


def readings(n: int, period: int = 2 * MS) -> list[Reading]:
    """What the robot of Fig. 4 says, with a command in every other message."""
    robot = said(ran(FIG4)).rows(slice(n))
    robot.only("omega_ref")[1::2] = np.nan
    return [Reading(k * period, tuple(range(width(INPUTS))), tuple(row)) for k, row in enumerate(robot.u.tolist())]


class Robot:
    """Says `said`, each at its time on a clock that the test moves, or on the wall."""

    name, drop_count, has_messages = "robot", 0, False

    def __init__(self, told: list[Reading], live: bool = False):
        self.told, self.live, self.at, self.next = told, live, 0, 0
        self.clock = SteadyClock()
        # starts with the first message: a session that takes long to begin must not find them waiting
        self.begun: int | None = None

    @property
    def at_end(self) -> bool:
        return self.next == len(self.told)

    def now_ns(self) -> int:
        if not self.live:
            return self.at
        return 0 if self.begun is None else self.clock.now_ns() - self.begun

    def receive(self, wait: float) -> list[Arrival]:
        if self.live:
            if self.begun is None:
                self.begun = self.clock.now_ns()
            time.sleep(max(0.0, (self.told[self.next].stamp - self.now_ns()) / 1e9))
        else:
            self.at = max(self.at, self.told[self.next].stamp)
        self.next += 1
        return [Arrival("encoders", self.now_ns(), self.told[self.next - 1])]

    def topic_types(self) -> dict[str, str]:
        return {}

    def subscribe(self, topic: str) -> None:
        raise AssertionError(topic)

    def publisher_count(self, topic: str) -> int:
        return 1

    def close(self) -> None:
        """Nothing to leave."""


def receiver(robot: Robot, estimate: Callable[[Sample], None]) -> Receiver:
    return Receiver(robot, {}, Aligner(width(INPUTS), ENCODER_COLUMNS, 0.03), estimate)


def test_a_sample_that_is_estimated_at_once_gives_the_row_that_it_gives_in_a_slice():
    made: list[Sample] = []
    with ExitStack() as stack:
        ahead = [stack.enter_context(SessionBranches(EXPERIMENT)) for _ in range(2)]
        at_once, sliced = (twin_of(EXPERIMENT, MODEL, "robot", ahead=one.predicting_part) for one in ahead)
        compare_at_once_with_slices(at_once, sliced, made)


def compare_at_once_with_slices(at_once: Twin, sliced: Twin, made: list[Sample]) -> None:
    robot = Robot(readings(500))

    def estimate(sample: Sample) -> None:
        made.append(sample)
        at_once.state.estimate_at_once(sample)

    one = receiver(robot, estimate)
    while not robot.at_end:
        one.receive_once()
    # more of them than the first slice takes
    stamps, rows_made = stack_samples(made)
    found = RobotSamples(stamps / NS_PER_SECOND, rows_made)
    halves = [found.rows(part) for part in (slice(200), slice(200, None))]
    rows, expected = [at_once.feed(half) for half in halves], [sliced.feed(half) for half in halves]
    assert len(made) == 500
    for topic in ("shadow", "ahead"):
        assert not np.all(np.isnan(expected[1][topic]))
        assert [row[topic].tobytes() for row in rows] == [row[topic].tobytes() for row in expected]


def test_the_time_in_hand_counts_from_when_a_sample_is_due_and_a_late_estimate_is_an_event(tmp_path: Path):
    taken = iter(range(400))
    robot = Robot([one for k, one in enumerate(readings(400)) if k != 300])

    def estimate(sample: Sample) -> None:
        robot.at += 5 * MS if next(taken) == 200 else MS // 10

    one = receiver(robot, estimate)
    late = []
    while not robot.at_end:
        one.receive_once()
        late += one.drain().late
    # the first samples, and the one behind the gap, wait for what may come before them: that is no time in hand
    assert one.in_hand.largest == pytest.approx(5e-3)
    assert one.in_hand.quantile(0.9) == pytest.approx(1e-4, rel=0.02)
    assert (one.missed, late) == (1, [pytest.approx(5e-3)])


def followed(robot: Robot, folder: Path, slow: float = 0.0) -> SessionSummary:
    """A session beside `robot`, whose 300th estimate takes so long (s)."""
    twin, count = twin_of(EXPERIMENT, MODEL, "robot"), iter(range(10**6))
    at_once = twin.state.estimate_at_once

    def delayed(sample: Sample) -> None:
        time.sleep(slow if next(count) == 300 else 0.0)
        at_once(sample)

    twin.state.estimate_at_once = delayed  # type: ignore[method-assign]
    session = Session(robot, {}, {}, twin, MODEL, 0.03, np.inf, True, lambda text: None)
    session.wait_for_topics()
    return session.follow(lambda: folder / "run.mcap")


def test_a_session_says_how_punctual_it_was_and_which_deadlines_it_missed(tmp_path: Path):
    told = followed(Robot(readings(500), live=True), tmp_path, slow=0.012)
    assert told.counts.samples == 500 and told.counts.missing == 0
    # the first ones have no period yet, of which to be late; those that come in one go are not counted either
    assert 200 <= told.in_hand.count < 490
    # how many more are late depends on what else this machine does
    assert told.missed >= 1 and told.in_hand.largest >= 0.012
    events = [str(event) for event in read(tmp_path / "run.mcap").events]
    assert any("later than a period after the sample, by 1" in event for event in events), events


def test_what_fails_where_messages_are_received_ends_the_session(tmp_path: Path):
    class Unplugged(Robot):
        def receive(self, wait: float) -> list[Arrival]:
            if self.next == 100:
                raise InputRefused("robot: the cable is out")
            return super().receive(wait)

    with pytest.raises(InputRefused, match="the cable is out"):
        followed(Unplugged(readings(200), live=True), tmp_path)


def test_a_message_that_cannot_be_read_ends_a_session_before_its_first_sample_only():
    class Reader:
        stamped = True

        def read_message(self, data: bytes, arrived: int) -> Reading:
            raise LogError("no such message")

    robot = Robot(readings(100))
    one = receiver(robot, lambda sample: None)
    one._readers = {"bad": Reader()}  # type: ignore[dict-item]
    bad = Arrival("bad", 0, b"")
    with pytest.raises(LogError, match="no such message"):
        one._read_message(bad)
    while not robot.at_end:
        one.receive_once()
    assert one._read_message(bad).columns == () and one.drain().unread == ["no such message"]


REAL = """
import os, sys
from twin.kernel.process.real_time import real_time
{before}
with real_time() as refused:
    print(os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK == os.SCHED_FIFO, sys.getswitchinterval() < 1e-3)
    print(any(line.startswith("VmLck") and int(line.split()[1]) for line in open("/proc/self/status")))
    print(refused)
print(os.sched_getscheduler(0) == os.SCHED_OTHER, sys.getswitchinterval())
"""


def real(before: str) -> list[str]:
    words = [sys.executable, "-c", REAL.format(before=before)]
    return subprocess.run(words, capture_output=True, text=True, check=True, cwd=ROOT).stdout.splitlines()


def test_where_it_may_a_process_goes_first_and_stays_in_memory():
    if os.geteuid():
        pytest.skip("only root may")
    first, locked, refused, after = real("")
    if refused:
        pytest.skip(f"even root may not here: {refused}")
    assert (first, locked, after) == ("True True", "True", "True 0.005")


def test_where_it_may_not_it_says_so_and_goes_on():
    drop = "import resource; resource.setrlimit(resource.RLIMIT_MEMLOCK, (65536, 65536)); os.setuid(65534)"
    first, locked, refused, after = real(drop if not os.geteuid() else "")
    assert (first, locked, after) == ("False True", "False", "True 0.005")
    assert refused.startswith("not in real time: SCHED_FIFO is not allowed (CAP_SYS_NICE or ulimit -r 20); memory")
