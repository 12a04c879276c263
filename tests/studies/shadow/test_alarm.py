"""The alarm: thresholds by the rate that is asked, sums, states; and what it finds, and when."""

from typing import Any

import numpy as np
import pytest

from twin.kernel.errors import InputRefused
from twin.studies.shadow.alarm import (
    BLOCK_LENGTH,
    CHANNELS,
    FIRST_BLOCKS,
    SETTLING_TIME,
    SUM_COUNT,
    Blocks,
    ShadowWatch,
    Tolerances,
    WatchState,
    run_length,
    threshold,
)

ONES = Tolerances(dict.fromkeys(CHANNELS, 1.0), dict.fromkeys(CHANNELS, 0.5))
QUIET = [0.0] * len(CHANNELS)
FORCE = list(CHANNELS).index("force")


def off(by: float, channel: int = FORCE) -> list[float]:
    return [by if k == channel else 0.0 for k in range(len(CHANNELS))]


def taken(watch: ShadowWatch, *means: list[float]) -> list[str]:
    """The states that the watch goes through, block by block."""
    states = []
    for k, one in enumerate([QUIET] * FIRST_BLOCKS + list(means)):
        watch.add_block(float(k + 1), one)
        states.append(str(watch.state))
    return states[FIRST_BLOCKS:]


def test_run_lengths_are_those_of_the_tables():
    # Montgomery, Introduction to Statistical Quality Control, table 9.3: 465 for two sides in control, H = 5, k = 1/2
    assert run_length(5.0) / 2 == pytest.approx(465, rel=0.02)


def test_run_lengths_are_those_of_sums_of_normal_numbers():
    random, H, lengths = np.random.default_rng(1), 4.0, []
    for _ in range(400):
        total = blocks = 0.0
        while total <= H:
            total, blocks = max(0.0, total + random.standard_normal() - 0.5), blocks + 1
        lengths.append(blocks)
    # the deviation of such a mean is a 20th of it
    assert np.mean(lengths) == pytest.approx(run_length(H), rel=0.15)


@pytest.mark.parametrize("per_hour", [100.0, 1.0, 0.01])
def test_a_threshold_gives_a_fifth_of_the_rate_that_is_asked(per_hour):
    blocks = run_length(threshold(per_hour))
    assert SUM_COUNT * 3600.0 / BLOCK_LENGTH / blocks == pytest.approx(per_hour / 5.0)


@pytest.mark.parametrize("per_hour", [0.0, -1.0, 1e9, float("nan")])
def test_a_rate_that_cannot_be_asked_is_refused(per_hour):
    with pytest.raises(InputRefused, match="false alarms an hour: expected"):
        threshold(per_hour)


def test_a_residual_within_its_tolerance_never_alarms():
    watch = ShadowWatch(ONES, 100.0)
    assert set(taken(watch, *[off(1.2)] * 500)) == {WatchState.LISTENING}


def test_a_residual_beyond_it_is_confirmed_then_an_alarm_with_evidence():
    watch = ShadowWatch(ONES, 1.0)
    states = taken(watch, *[off(-3.0)] * 6)
    assert states[0] == WatchState.LISTENING and WatchState.CONFIRMING in states and states[-1] == WatchState.GATHERING
    (alarm,) = watch.alarms
    assert (alarm.channel, alarm.since, alarm.size) == ("force", float(FIRST_BLOCKS), -3.0)
    assert alarm.level > 1.0
    assert str(alarm).startswith("robot and twin diverge: force is off by -3 N since 2.0 s")


def test_what_is_normal_is_what_the_first_blocks_were():
    watch = ShadowWatch(ONES, 1.0)
    for k in range(100):
        watch.add_block(float(k), off(50.0))
    assert not watch.alarms


def test_a_shift_that_goes_away_is_only_confirmed():
    watch = ShadowWatch(ONES, 1.0)
    assert taken(watch, *[off(3.0)] * 3, *[QUIET] * 6)[-1] == WatchState.LISTENING
    assert [change.state for change in watch.changes] == [WatchState.CONFIRMING, WatchState.LISTENING]


def test_after_an_alarm_it_gathers_asks_and_cools_down():
    asked = []

    class Answers:
        def ask(self, since: float, t: float) -> None:
            asked.append((since, t))

        def answer(self) -> str:
            return "k_s of joint 2 was 1.000, is 0.93 +- 0.02"

    answers: Any = Answers()
    watch = ShadowWatch(ONES, 1.0, gathering=3, cooling=4, reidentifier=answers)
    states = taken(watch, *[off(20.0)] * 9)
    assert states == ["gathering"] * 3 + ["cooling down"] * 4 + ["listening", "gathering"]
    # the block in which it began to grow is of both
    assert asked == [(3.0, 6.0)]
    assert "0.93 +- 0.02" in str(watch.changes[2])


def test_a_second_silence_before_the_next_block_does_not_become_the_state():
    watch = ShadowWatch(ONES, 1.0, gathering=3)
    taken(watch, *[off(20.0)])
    assert watch.state is WatchState.GATHERING
    for t in (4.0, 9.0):
        watch.lose(t, "no sample for 2 s")
    states = [watch.add_block(20.0 + k, off(20.0)) for k in range(2)]
    assert [[str(one.state) for one in changes] for changes in states] == [["gathering"], []]


def test_without_anything_that_re_identifies_it_says_so():
    watch = ShadowWatch(ONES, 1.0, gathering=1, cooling=1)
    taken(watch, *[off(20.0)] * 2)
    assert str(watch.changes[-1]) == "cooling down: which parameter is not known"


def test_a_channel_without_a_sensor_says_nothing():
    watch = ShadowWatch(ONES, 1.0)
    silent = [np.nan if k == FORCE else 0.0 for k in range(len(CHANNELS))]
    for k in range(20):
        watch.add_block(float(k), silent)
    assert watch.levels["force"] == 0.0 and not watch.alarms


def test_less_spread_is_no_news():
    watch, spread = ShadowWatch(ONES, 1.0), list(CHANNELS).index("spread")
    assert set(taken(watch, *[off(-30.0, spread)] * 9)) == {WatchState.LISTENING}
    assert taken(watch, *[off(30.0, spread)] * 9)[-1] != WatchState.LISTENING


COMMAND = list(CHANNELS).index("command")


def test_a_controller_that_leaves_the_twins_is_an_alarm_and_one_that_never_was_with_it_is_not_compared():
    watch = ShadowWatch(ONES, 1.0)
    assert taken(watch, *[off(30.0, COMMAND)] * 3)[-1] == WatchState.GATHERING
    assert watch.alarms[0].channel == "command"
    late = ShadowWatch(ONES, 1.0)
    for k in range(9):
        late.add_block(float(k), off(30.0 + 9.0 * k, COMMAND))
    (said,) = late.changes
    assert not said.alarm and "the twin's controller is not compared" in str(said)


def outputs(n: int, started: list[int], value: float = 1.0) -> dict[str, np.ndarray]:
    """Of a filter, n samples."""
    y: dict[str, np.ndarray] = {name: np.full((n, 3), value) for name in ("residual_m", "residual_l", "residual_tau")}
    y |= {
        "residual_F": np.full(n, value),
        "residual_command": np.full(n, value),
        "NIS": np.full(n, 6 * value),
        "used": np.full(n, 6.0),
    }
    y["started"] = np.isin(np.arange(n), started).astype(float)
    return y


def times(n: int) -> np.ndarray:
    """Of n samples at 500 Hz (s)."""
    return np.arange(n, dtype=float) * 2e-3


def test_blocks_are_the_same_however_the_samples_are_cut():
    t, y = times(5000), outputs(5000, [0, 2000])
    y["residual_F"] = np.sin(t)
    whole = list(Blocks().add_samples(t, y))
    cut: list[tuple[float, np.ndarray]] = []
    blocks = Blocks()
    for k in range(0, 5000, 77):
        cut += blocks.add_samples(t[k : k + 77], {name: values[k : k + 77] for name, values in y.items()})
    assert (
        [end for end, _ in whole] == [end for end, _ in cut] == pytest.approx([SETTLING_TIME + k for k in range(1, 10)])
    )
    assert np.array([means for _, means in whole]) == pytest.approx(np.array([means for _, means in cut]), nan_ok=True)


def test_of_a_gap_there_is_no_block():
    t = np.concatenate([times(2000), 1e4 + times(2000)])
    ends = [end for end, _ in Blocks().add_samples(t, outputs(4000, [0, 2000]))]
    assert len(ends) == 8 and np.all(np.diff(ends) > 0.99)


def test_after_a_gap_the_twins_controller_is_not_where_the_robots_is():
    found = [means[COMMAND] for _, means in Blocks().add_samples(times(4000), outputs(4000, [0, 2000]))]
    assert found[:3] == [1.0] * 3 and np.isnan(found[4:]).all()


def test_what_the_filter_says_while_it_settles_does_not_count():
    t, y = times(3000), outputs(3000, [0, 1000])
    y["residual_F"][1001 : 1000 + int(SETTLING_TIME / 2e-3)] = 1e9
    assert max(means[FORCE] for _, means in Blocks().add_samples(t, y)) == 1.0
    # the sample at which it gives up tells why
    y["residual_F"][1000] = 1e9
    assert max(means[FORCE] for _, means in Blocks().add_samples(t, y)) > 1e6
