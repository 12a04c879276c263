"""Paced runs: deadlines, what is said of them, and that nobody sees them in a recording."""

import json
from pathlib import Path
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from twin.robot.assembly.load import load_experiment
from twin.robot.run import viewer as pacing
from twin.robot.run.run import SLICE_TICKS, SUMMARY, execute
from twin.robot.run.viewer import SLICE, Pace

FIG4 = "experiments/fig4_force_position.toml"


class Clock:
    """A clock that only sleeping and work move; it oversleeps by `late` (s)."""

    def __init__(self, late: float = 0.0):
        self.now, self.late = 100.0, late

    def monotonic(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        self.now += seconds + self.late


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr(pacing, "time", SimpleNamespace(monotonic=clock.monotonic, sleep=clock.sleep))
    return clock


def kept(pace: Pace, clock: Clock, work: list[float], ticks: int = 10) -> None:
    """One slice of `ticks` for each time in `work` (s)."""
    pace.ready(0)
    for k, seconds in enumerate(work, start=1):
        clock.now += seconds
        pace.keep(k * ticks)


@given(factor=st.floats(1e-3, 1e4), tick=st.floats(1e-5, 1e-1))
def test_slices_end_where_blocks_do_and_last_ten_milliseconds_at_most_or_one_tick(factor: float, tick: float):
    ticks = Pace(factor, tick).slice_ticks(SLICE_TICKS)
    assert SLICE_TICKS % ticks == 0
    # 1e-6: the quotient of two decimal fractions may be just below the whole number that it means
    assert ticks == 1 or ticks * tick / factor <= SLICE * (1 + 1e-6)


def test_simulated_time_follows_the_clock_by_the_factor(clock: Clock):
    kept(Pace(2.0, 1e-3), clock, [0.001] * 50)
    # 50 slices of 10 ticks of 1 ms at twice real time; sums of 50 rounded sleeps
    assert clock.now - 100.0 == pytest.approx(0.25, abs=1e-9)


def test_a_run_that_keeps_its_deadlines_has_neither_misses_nor_jitter(clock: Clock):
    pace = Pace(1.0, 1e-3)
    kept(pace, clock, [0.004] * 20)
    told = pace.punctuality()
    assert (told.deadlines, told.misses, told.worst) == (20, 0, 0.0)
    # rounding of times near 100 s
    assert (told.achieved, told.jitter, told.jitter_99) == pytest.approx((1.0, 0.0, 0.0), abs=1e-12)
    assert told.sentence == "1 x real time; 0 of 20 deadlines missed; jitter 0.00 ms"


def test_a_run_that_was_held_up_catches_up_and_says_how_late_it_was(clock: Clock):
    pace = Pace(1.0, 1e-3)
    # 35 ms for the third slice of 10 ms: 25, 16 and 7 ms late, then in time again
    kept(pace, clock, [0.001, 0.001, 0.035, 0.001, 0.001, 0.001, 0.001])
    told = pace.punctuality()
    assert (told.misses, told.deadlines) == (3, 7)
    assert told.worst == pytest.approx(0.025, abs=1e-9)
    assert clock.now - 100.0 == pytest.approx(0.07, abs=1e-9)
    assert told.sentence.endswith("3 of 7 deadlines missed, by 25.0 ms at most; jitter 9.26 ms")


def test_oversleeping_is_jitter_and_no_miss(clock: Clock):
    clock.late = 0.0005
    pace = Pace(1.0, 1e-3)
    kept(pace, clock, [0.001] * 9)
    told = pace.punctuality()
    assert told.misses == 0
    # always the same lateness is none of jitter's business; the percentile tells it
    assert (told.jitter, told.jitter_99) == pytest.approx((0.0, 0.0005), abs=1e-9)


def test_a_factor_that_cannot_be_reached_is_not_claimed(clock: Clock):
    pace = Pace(1000.0, 1e-3)
    kept(pace, clock, [0.1] * 10, ticks=100)
    told = pace.punctuality()
    assert told.misses == told.deadlines == 10
    # 1 s simulated in 1 s
    assert told.achieved == pytest.approx(1.0)


def test_pacing_leaves_no_trace_in_a_recording(root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    # slices of 10 ticks at ten times real time, so that a block is made of ten
    monkeypatch.setattr(pacing, "SLICE", 1e-3)
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
    # 201 ticks of 2 ms in slices of 5
    assert told is not None
    assert told.deadlines == 41
    # never early; how late depends on what else this machine does
    assert 0.0 < told.achieved <= 0.5
    assert json.loads((tmp_path / SUMMARY).read_text())["punctuality"]["misses"] == told.misses
