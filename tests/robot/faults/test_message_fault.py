import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.robot.faults.robot import PERIOD, TICK, Run, run
from twin.robot.experiment.fault import Fault

ONSET, END, LAST = 1000, 3000, 4000
SENDER = [("sample_delay", "encoder"), ("controller_overrun", "controller")]


def late(kind: str, target: str, magnitude: float, onset: int = ONSET, end: int = END, seed: int = 0) -> Run:
    return run(Fault(kind, target, onset, end, magnitude, seed=seed), last_tick=LAST)


def sent_and_had(done: Run, target: str) -> tuple[np.ndarray, np.ndarray]:
    """What the sender puts out and what its readers have, one row per tick, (ticks, values)."""
    ends = ["omega_ref"] if target == "controller" else ["count_m", "count_l", "sample"]
    return tuple(np.hstack([done[f"{name}.{end}"] for end in ends]) for name in (target, "fault_1"))  # type: ignore


@pytest.mark.parametrize("ticks", [1, 2, 3, 10, 37])
@pytest.mark.parametrize(("kind", "target"), SENDER)
def test_messages_of_the_window_arrive_so_much_later_and_before_that_the_last_one_is_held(kind, target, ticks):
    sent, had = sent_and_had(late(kind, target, ticks * TICK), target)
    k = np.arange(ONSET, END)
    delayed = np.maximum(k - ticks, ONSET)
    newest = delayed - delayed % PERIOD
    # nothing sent in the window has arrived yet: the message before it
    newest[k - ticks < ONSET] = ONSET - PERIOD
    np.testing.assert_array_equal(had[ONSET:END], sent[newest])
    np.testing.assert_array_equal(had[:ONSET], sent[:ONSET])
    np.testing.assert_array_equal(had[END:], sent[END:])


@given(st.integers(0, 60), st.integers(1, 60), st.integers(1, 20), st.integers(0, 2**63))
def test_whatever_is_late_never_goes_back_in_time_and_is_never_from_the_future(onset, length, ticks, seed):
    fault = Fault("sample_jitter", "encoder", onset, onset + length, ticks * TICK, seed=seed)
    done = run(fault, last_tick=130)
    had, sent = done["fault_1.sample"][:, 0], done["encoder.sample"][:, 0]
    assert np.all(np.diff(had) >= 0.0)
    age = (sent - had) * PERIOD
    assert np.all(age >= 0.0)
    # a message older than the longest delay has been overtaken; the sender's own period comes on top
    assert np.all(age <= ticks + PERIOD)


def test_jitter_is_spread_evenly_up_to_its_magnitude():
    done = late("sample_jitter", "encoder", 1 * TICK)
    sent, had = done["encoder.sample"][ONSET:END, 0], done["fault_1.sample"][ONSET:END, 0]
    # 0 or 1 tick of delay, half of 1000 messages each: five standard deviations
    assert abs(np.sum(sent != had) - 500) <= 5.0 * np.sqrt(250.0)


def test_a_message_is_late_as_a_whole():
    done = late("sample_jitter", "encoder", 20 * TICK)
    sent, had = sent_and_had(done, "encoder")
    whole = {tuple(message) for message in sent}
    assert all(tuple(message) in whole for message in had)


@pytest.mark.parametrize("share", [0.1, 0.5, 1.0])
def test_the_stated_share_of_messages_is_lost_and_the_counter_stands_still(share):
    done = late("sample_loss", "encoder", share)
    sample = done["fault_1.sample"][ONSET - PERIOD : END : PERIOD, 0]
    stands = np.sum(np.diff(sample) == 0.0)
    # five standard deviations of 1000 messages
    assert abs(stands - 1000 * share) <= 5.0 * np.sqrt(1000 * share * (1.0 - share))


def test_a_late_command_changes_only_the_command():
    done = late("controller_overrun", "controller", 10 * TICK)
    assert [port.name for port in done.system.component("fault_1").outputs] == ["omega_ref", "active"]
