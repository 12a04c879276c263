"""Paced runs: deadlines, what is said of them, and that nobody sees them in a recording."""

import ctypes
import json
import os
import signal
import threading
import time
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from twin.kernel.cosim.deadlines import callbacks
from twin.robot.assembly.load import load_experiment
from twin.robot.run import viewer as pacing
from twin.robot.run.run import SLICE_TICKS, SUMMARY_FILE, execute
from twin.robot.run.viewer import SLICE_TIME, Pace

FIG4 = "experiments/fig4_force_position.toml"


class Clock:
    """A clock that only sleeping and work move; it oversleeps by `late` (s)."""

    def __init__(self, late: float = 0.0):
        self.now, self.late = 100.0, late

    def sleep(self, seconds: float) -> None:
        self.now += seconds + self.late


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    functions = (*callbacks(lambda: clock.now, clock.sleep), 0)
    monkeypatch.setattr(pacing, "clock_functions", lambda: functions)
    return clock


def kept(pace: Pace, clock: Clock, work: list[float]) -> None:
    """Ticks that take the times in `work` (s), in slices of 7, and one more that takes none."""
    left = [*work, 0.0]

    @ctypes.CFUNCTYPE(*[ctypes.c_int64] * 5)
    def worked(loop: int, first: int, count: int, row: int) -> int:
        clock.now += sum(left[first : first + count])
        return count

    step = pace.deadlines.paced_advance(worked, 0)
    for first in range(0, len(left), 7):
        count = min(7, len(left) - first)
        assert step(pace.deadlines.address, first, count, 0) == count


@given(factor=st.floats(1e-3, 1e4), tick=st.floats(1e-5, 1e-1))
def test_slices_end_where_blocks_do_and_last_ten_milliseconds_at_most_or_one_tick(factor: float, tick: float):
    ticks = Pace(factor, tick).slice_ticks(SLICE_TICKS)
    assert SLICE_TICKS % ticks == 0
    # 1e-6: the quotient of two decimal fractions may be just below the whole number that it means
    assert ticks == 1 or ticks * tick / factor <= SLICE_TIME * (1 + 1e-6)


def test_simulated_time_follows_the_clock_by_the_factor(clock: Clock):
    kept(Pace(2.0, 1e-2), clock, [0.001] * 50)
    # 50 ticks of 10 ms at twice real time, to 1 ns each
    assert clock.now - 100.0 == pytest.approx(0.25, abs=1e-7)


def test_a_run_that_keeps_its_deadlines_has_neither_misses_nor_jitter(clock: Clock):
    pace = Pace(1.0, 1e-3)
    kept(pace, clock, [0.0004] * 20)
    told = pace.punctuality()
    assert (told.deadlines, told.misses, told.worst) == (20, 0, 0.0)
    # the clock's nanoseconds
    assert (told.achieved, told.jitter, told.jitter_99) == pytest.approx((1.0, 0.0, 0.0), abs=1e-7)
    assert told.sentence == "1 x real time; 0 of 20 deadlines missed; jitter 0.00 ms"


def test_a_run_that_was_held_up_catches_up_and_says_how_late_it_was(clock: Clock):
    pace = Pace(1.0, 1e-3)
    # 3.5 ms for the third tick of 1 ms: 2.5, 1.6 and 0.7 ms late, then in time again
    kept(pace, clock, [0.0001, 0.0001, 0.0035, 0.0001, 0.0001, 0.0001, 0.0001])
    told = pace.punctuality()
    assert (told.misses, told.deadlines) == (3, 7)
    assert told.worst == pytest.approx(0.0025, abs=1e-8)
    assert clock.now - 100.0 == pytest.approx(0.007, abs=1e-8)
    assert told.sentence.endswith("3 of 7 deadlines missed, by 2.5 ms at most; jitter 0.93 ms")


def test_oversleeping_is_jitter_and_no_miss(clock: Clock):
    clock.late = 0.0005
    pace = Pace(1.0, 1e-3)
    kept(pace, clock, [0.0001] * 9)
    told = pace.punctuality()
    assert told.misses == 0
    # always the same lateness is none of jitter's business; the percentile tells it, to the 2 % of its histogram
    assert told.jitter == pytest.approx(0.0, abs=1e-7)
    assert told.jitter_99 == pytest.approx(0.0005, rel=0.02)


def test_a_factor_that_cannot_be_reached_is_not_claimed(clock: Clock):
    pace = Pace(1000.0, 1e-3)
    kept(pace, clock, [0.001] * 10_000)
    told = pace.punctuality()
    # a deadline each 1 ms of wall time, of a thousand ticks
    assert told.misses == told.deadlines == 10
    # 10 s simulated in 10 s
    assert told.achieved == pytest.approx(1.0)


def test_a_second_ctrl_c_does_not_wait_for_a_tick_that_is_far_away(root: Path, tmp_path: Path):
    # ticks of 1 ms that are 20 s apart; the first Ctrl-C asks to end with the tick, the second one ends at once
    for after in (0.8, 1.2):
        threading.Timer(after, os.kill, (os.getpid(), signal.SIGINT)).start()
    began = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        execute(load_experiment(root / FIG4, ["duration_s=0.01"]), tmp_path, factor=5e-5)
    assert time.monotonic() - began < 10.0


def test_pacing_leaves_no_trace_in_a_recording(root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    # slices of 10 ticks at ten times real time, so that a block is made of ten
    monkeypatch.setattr(pacing, "SLICE_TIME", 1e-3)
    fault = "fault=[{kind='breathing', onset_s=0.333, magnitude_mm=0.5}]"
    experiment = load_experiment(root / FIG4, ["duration_s=1.987", fault, "contact.height_mm=-85.5"])
    recordings = []
    for name, factor in (("free", None), ("paced", 10.0)):
        (tmp_path / name).mkdir()
        run = execute(experiment, tmp_path / name, factor=factor)
        # the trigger and the fault, so that events are in other slices, too
        assert len(run.events) == 2
        recordings.append(run.recording.read_bytes())
    assert recordings[0] == recordings[1]


def test_a_paced_run_takes_its_time_and_says_how_it_went(root: Path, tmp_path: Path):
    run = execute(load_experiment(root / FIG4, ["duration_s=0.2"]), tmp_path, factor=0.5)
    told = run.punctuality
    # ticks of 1 ms, of which the first is when it begins
    assert told is not None
    assert told.deadlines == 200
    # never early; how late depends on what else this machine does
    assert 0.0 < told.achieved <= 0.5
    assert json.loads((tmp_path / SUMMARY_FILE).read_text())["punctuality"]["misses"] == told.misses
