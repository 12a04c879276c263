"""What says what is normal may begin later than the log."""

import numpy as np
import pytest

from twin.errors import InputRefused
from twin.studies.replay.normal import normal_time
from twin.studies.replay.replay import _indicator


def test_a_time_is_the_beginning_and_two_times_leave_out_what_is_before():
    assert normal_time("2.5") == (0.0, 2.5) and normal_time("1:3") == (1.0, 3.0)


@pytest.mark.parametrize("text", ["0", "-1", "3:1", "1:1", "-1:2", "a", "1:", ":2", "1:2:3", "nan", "inf", ""])
def test_what_is_no_time_is_refused_with_an_example(text: str):
    with pytest.raises(InputRefused, match=r"^--baseline .*: expected a time > 0 s, or FROM:TO .* for example 1:3$"):
        normal_time(text)


def test_a_start_that_is_not_normal_is_an_alarm_only_if_it_is_taken_for_normal():
    t = np.arange(0.0, 20.0, 0.01)
    r = np.where(t < 1.0, 5.0, 0.0) + 0.01 * np.random.default_rng(0).normal(size=len(t))
    (taken,) = _indicator("force", "N", t, r, (0.0, 1.0), 0.1, 0.01)
    (left_out,) = _indicator("force", "N", t, r, (1.0, 3.0), 0.1, 0.01)
    assert not taken.drift.matches and left_out.drift.matches
    assert left_out.t[0] == 1.0 and abs(left_out.drift.baseline) < 0.01
