"""What becomes of readings that come in any order, twice, late, in parts, or by another clock."""

import math
import random

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.conftest import examples
from twin.kernel.recording.sources.signals import Reading
from twin.kernel.recording.sources.stamps import Aligner, Clocks, Histogram, Sample, stack_samples

MS = 1_000_000
PERIOD = 2 * MS
NEEDED = (0, 1)
BUDGET = 0.03
Arrived = tuple[int, Reading]


def reading(k: int, columns: tuple[int, ...] = NEEDED, start: int = 10**18) -> Reading:
    return Reading(start + k * PERIOD, columns, tuple(float(10 * k + column) for column in columns))


def on_time(n: int) -> list[Arrived]:
    return [(reading(k).stamp, reading(k)) for k in range(n)]


def aligned(arrivals: list[Arrived], aligner: Aligner | None = None) -> tuple[Aligner, list[Sample]]:
    """RobotSamples of all `arrivals`, in order of arrival."""
    aligner = aligner or Aligner(3, NEEDED, BUDGET)
    found: list[Sample] = []
    for arrived, one in sorted(arrivals, key=lambda pair: pair[0]):
        found += aligner.add("/joints", arrived, one)
    return aligner, found + aligner.ready_samples(10**19, end=True)


def numbers(samples: list[Sample]) -> list[tuple[int, float, float]]:
    return [(sample.t, sample.row[0], sample.row[1]) for sample in samples]


@examples(30)
@given(st.integers(0, 2**32), st.floats(0.0, 0.025), st.integers(0, 20))
def test_what_comes_within_the_budget_gives_the_same_samples_in_whatever_order(seed: int, jitter: float, twice: int):
    drawn = random.Random(seed)
    plain = on_time(200)
    mixed = [(arrived + round(drawn.random() * jitter * 1e9), one) for arrived, one in plain]
    mixed += [(arrived + 3 * MS, one) for arrived, one in drawn.sample(mixed, twice)]
    aligner, samples = aligned(mixed)
    assert numbers(samples) == numbers(aligned(plain)[1])
    assert (aligner.counts.missing, aligner.counts.late) == (0, 0)
    assert aligner.counts.duplicates == twice
    assert aligner.period == PERIOD


@examples(30)
@given(st.sets(st.integers(30, 190), max_size=30))
def test_every_message_that_is_lost_is_counted(lost: set[int]):
    kept = [one for k, one in enumerate(on_time(200)) if k not in lost]
    aligner, samples = aligned(kept)
    assert len(samples) == 200 - len(lost)
    assert aligner.counts.missing == len(lost)
    runs = [k for k in lost if k - 1 not in lost]
    assert aligner.counts.gaps == len(runs)
    assert sum(round((end - start) / PERIOD) - 1 for start, end in aligner.gaps) == len(lost)


def test_losses_before_the_period_is_known_are_counted_too():
    aligner, _ = aligned([one for k, one in enumerate(on_time(200)) if k not in (3, 4, 9)])
    assert (aligner.counts.missing, aligner.counts.gaps) == (3, 2)


@pytest.mark.parametrize(("delay", "jitter"), [(5.0, 0.03), (20.0, 0.01), (50.0, 0.0)])
def test_what_a_network_overtakes_and_a_transport_drops_unsaid_is_told_by_the_stamps(delay: float, jitter: float):
    drawn, newest, handed_on = random.Random(1), -1, []
    for arrived, k in sorted((k * PERIOD + drawn.random() * delay * MS, k) for k in range(3500)):
        if k > newest:
            stamp = 10**18 + k * PERIOD + round(drawn.gauss(0.0, jitter * PERIOD))
            handed_on.append((10**18 + round(arrived), Reading(stamp, NEEDED, (1.0, 2.0))))
            newest = k
    # of single intervals there are few
    assert len(handed_on) < 3500 * {5.0: 0.9, 20.0: 0.5, 50.0: 0.3}[delay]
    aligner, samples = aligned(handed_on)
    assert aligner.period == pytest.approx(PERIOD, rel=0.01)
    assert len(samples) + aligner.counts.missing == pytest.approx(3500, rel=5e-3)


@pytest.mark.parametrize("seed", range(3))
def test_stamps_at_random_have_no_period_and_nothing_is_missing_between_two_publishers(seed: int):
    drawn, stamp, at_random = random.Random(seed), 10**18, []
    for _ in range(300):
        stamp += round(drawn.expovariate(1.0 / PERIOD))
        at_random.append((stamp, Reading(stamp, NEEDED, (1.0, 2.0))))
    assert aligned(at_random)[0].counts.missing == 0
    two = [
        (one.stamp + lag, one._replace(stamp=one.stamp + lag)) for _, one in on_time(150) for lag in (0, PERIOD // 4)
    ]
    assert aligned(two)[0].counts.missing == 0


def test_a_sample_after_a_gap_waits_for_the_budget_and_no_longer():
    aligner, _ = Aligner(3, NEEDED, BUDGET), None
    start = on_time(101)
    for arrived, one in start[:100]:
        aligner.add("/joints", arrived, one)
    aligner.ready_samples(start[99][0] + 50 * MS)
    late = reading(105)
    assert aligner.add("/joints", late.stamp, late) == []
    assert aligner.ready_samples(late.stamp + 29 * MS) == []
    assert [sample.row[0] for sample in aligner.ready_samples(late.stamp + 30 * MS)] == [1050.0]
    # its place is taken
    assert aligner.add("/joints", late.stamp + 31 * MS, reading(103)) == []
    assert (aligner.counts.late, aligner.counts.missing) == (1, 5)


def test_a_burst_after_a_stall_is_neither_lost_nor_a_gap():
    burst = [(max(arrived, 10**18 + 2_300 * MS), one) if 150 <= k < 1150 else (arrived, one)
             for k, (arrived, one) in enumerate(on_time(2000))]  # fmt: skip
    aligner, samples = aligned(burst)
    assert len(samples) == 2000
    assert (aligner.counts.missing, aligner.counts.restarts, aligner.counts.out_of_order) == (0, 0, 0)
    assert aligner.clocks.lateness.largest == pytest.approx(2.0, abs=0.01)


def test_no_number_is_no_sample_and_is_told():
    bad = Reading(reading(100).stamp, NEEDED, (math.nan, 1.0))
    aligner, samples = aligned([(bad.stamp, bad) if k == 100 else one for k, one in enumerate(on_time(200))])
    assert (len(samples), aligner.counts.invalid) == (199, 1)


@pytest.mark.parametrize("apart", [0, 300_000])
def test_two_publishers_of_half_the_joints_make_one_sample(apart: int):
    arrivals = []
    for k in range(200):
        first, second = reading(k, (0,)), reading(k, (1,))
        arrivals += [(second.stamp, second._replace(stamp=second.stamp + apart)), (first.stamp + 1000, first)]
    aligner, samples = aligned(arrivals)
    # whose stamps differ: what belongs together has to be learnt first
    expected = 200 if not apart else 160
    assert len(samples) >= expected
    assert all(row[1] - row[0] == 1.0 for row in (sample.row for sample in samples))
    times = stack_samples(samples)[0]
    assert set(np.diff(times).tolist()) == {PERIOD}
    assert aligner.counts.incomplete == 0


def test_what_is_measured_beside_goes_with_the_first_sample_at_or_after_it_and_with_no_other():
    aligner = Aligner(3, NEEDED, BUDGET)
    found: list[Sample] = []
    for k in range(100):
        arrived, one = on_time(100)[k]
        if k % 10 == 5:
            # between two samples, and it comes after the second of them
            found += aligner.add("/force", arrived + MS, Reading(one.stamp - MS, (2,), (float(k),)))
        found += aligner.add("/joints", arrived, one)
    found += aligner.ready_samples(10**19, end=True)
    measured = {k: sample.row[2] for k, sample in enumerate(found) if not math.isnan(sample.row[2])}
    assert measured == {k: float(k) for k in range(5, 100, 10)}


def test_a_clock_that_starts_anew_goes_on_by_the_arrivals():
    before = on_time(500)
    pause = 700 * MS
    after = [(before[-1][0] + pause + k * PERIOD, reading(k, start=0)) for k in range(500)]
    aligner, samples = aligned(before + after)
    times = stack_samples(samples)[0]
    assert aligner.counts.restarts == 1
    assert np.all(np.diff(times) > 0)
    assert len(samples) == 1000
    assert times[500] - times[499] == pytest.approx(pause, abs=BUDGET * 1e9)


@pytest.mark.parametrize("drift", [0.0, 5e-5, -2e-4])
def test_offset_and_drift_of_the_clock_are_found_behind_jitter(drift: float):
    drawn, clocks = random.Random(3), Clocks()
    for k in range(30_000):
        true = k * PERIOD
        stamp = round(true * (1.0 - drift)) - 300 * MS
        clocks.add(stamp, true + round(drawn.expovariate(1 / 2.0) * MS) + MS // 5)
    # at the end; the way takes 0.2 ms at least
    assert clocks.offset == pytest.approx(0.3 + 60.0 * drift + 0.0002, abs=2e-3)
    assert clocks.drift == pytest.approx(drift, abs=1e-6)


@given(st.lists(st.floats(2e-6, 10.0), min_size=1, max_size=300), st.floats(0.01, 1.0))
def test_quantiles_of_little_memory_are_right_to_two_percent(times: list[float], share: float):
    histogram = Histogram()
    for one in times:
        histogram.add(one)
    exact = sorted(times)[max(0, math.ceil(share * len(times)) - 1)]
    assert exact / 1.021 <= histogram.quantile(share) <= exact * 1.021
    assert histogram.largest == max(times)


def test_a_sample_is_due_with_the_message_that_completes_it_or_when_what_may_come_before_it_is_too_late():
    lost = 100
    aligner, samples = aligned([(arrived + 10**18, one) for arrived, one in on_time(150) if one != reading(lost)])
    waited = {sample.t // PERIOD: sample.due - sample.arrived for sample in samples if sample.t >= 60 * PERIOD}
    # behind the gap they wait together
    budget = round(BUDGET * 1e9)
    assert waited[lost - 1] == 0 and waited[lost + 1] == budget and waited[lost + 2] == budget - PERIOD
    assert waited[lost + 20] == 0 and aligner.due is None


def sent(stamps: list[float]) -> list[Arrived]:
    """Messages stamped when they were sent, `stamps` in periods; each arrives at once."""
    whole = [10**18 + round(k * PERIOD) for k in stamps]
    return [(stamp, Reading(stamp, NEEDED, (1.0, 2.0))) for stamp in whole]


def test_readings_beside_that_no_sample_takes_push_out_the_oldest_and_the_newest_go_with_the_next_sample():
    aligner, _ = aligned(on_time(100))
    for k in range(100, 1600):
        assert aligner.add("/force", reading(k).stamp, Reading(reading(k).stamp, (2,), (float(k),))) == []
    found = aligner.add("/joints", reading(1600).stamp, reading(1600)) + aligner.ready_samples(10**19, end=True)
    assert [sample.row[2] for sample in found] == [1599.0]


@pytest.mark.parametrize("late", [0.5, 0.9])
def test_one_late_message_of_a_robot_that_stamps_when_it_sends_changes_neither_period_nor_loss(late: float):
    aligner, samples = aligned(sent([k + late * (k == 700) for k in range(5000)]))
    assert (len(samples), aligner.counts.missing, aligner.counts.gaps) == (5000, 0, 0)
    assert aligner.period == PERIOD


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("jitter", [0.01, 0.05])
def test_a_robot_that_makes_up_for_stalls_of_up_to_10_ms_has_lost_nothing_and_what_is_lost_is_counted(
    seed: int, jitter: float
):
    drawn, free, stamps = random.Random(seed), 0.0, []
    for k in range(3000):
        # a loop that is late runs at once until it has caught up; 5 periods are 10 ms
        free = max(k + drawn.gauss(0.0, jitter), free + 0.02) + (drawn.uniform(0.0, 5.0) if k % 400 == 399 else 0.0)
        stamps.append(free)
    whole, _ = aligned(sent(stamps))
    assert whole.period == pytest.approx(PERIOD, rel=0.02)
    assert whole.counts.missing <= 1
    kept, _ = aligned(sent([stamp for k, stamp in enumerate(stamps) if k % 10]))
    assert kept.counts.missing == pytest.approx(300, abs=6)


@pytest.mark.parametrize("factor", [0.5, 2.0, 1.1])
def test_a_rate_that_changes_is_learnt_and_costs_no_sample(factor: float):
    stamps = [float(k) for k in range(1000)] + [999.0 + factor * k for k in range(1, 1001)]
    aligner, _ = aligned(sent(stamps))
    assert aligner.period == pytest.approx(factor * PERIOD)
    assert (aligner.counts.missing, aligner.counts.gaps) == (0, 0)


@pytest.mark.parametrize("step", [-0.05, -3.0, 1.0, 20.0])
def test_a_clock_that_is_set_is_a_restart_and_no_loss(step: float):
    arrivals = [(stamp, one if k < 1000 else one._replace(stamp=one.stamp + round(step * 1e9)))
                for k, (stamp, one) in enumerate(on_time(2000))]  # fmt: skip
    aligner, samples = aligned(arrivals)
    assert aligner.counts.restarts == 1 and aligner.clock_step == pytest.approx(step, abs=1e-3)
    assert (aligner.counts.missing, aligner.counts.late, aligner.counts.duplicates) == (0, 0, 0)
    assert len(samples) == 2000
    assert set(np.diff(stack_samples(samples)[0])) == {PERIOD}


def test_a_burst_that_comes_too_late_is_counted_and_is_no_clock_that_was_set():
    late = [(arrived + 45 * MS if 500 <= k < 520 else arrived, one) for k, (arrived, one) in enumerate(on_time(1000))]
    aligner, samples = aligned(late)
    assert aligner.counts.restarts == 0
    assert (len(samples), aligner.counts.missing) == (1000 - aligner.counts.late, aligner.counts.late)
    assert aligner.counts.late > 0


def test_rows_of_two_topics_before_their_periods_are_known_are_counted():
    later = 40_000
    streams = {"/motors": (0,), "/joints": (1,)}
    aligner, found = Aligner(3, NEEDED, BUDGET), list[Sample]()
    for k in range(100):
        for place, (topic, columns) in enumerate(streams.items()):
            stamp = 10**18 + k * PERIOD + place * later
            found += aligner.add(topic, stamp, Reading(stamp, columns, (float(k),)))
    found += aligner.ready_samples(10**19, end=True)
    assert 0 < aligner.counts.unmatched < 25
    assert len(found) + aligner.counts.unmatched == 100
    assert aligner.counts.incomplete == aligner.counts.missing == 0


def test_what_is_before_the_first_sample_of_one_topic_is_not_counted():
    assert aligned(on_time(100))[0].counts.unmatched == 0
