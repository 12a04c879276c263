import math

import pytest

from twin.errors import InputRefused
from twin.studies.tune.goals import Goals, stiffness_range


@pytest.mark.parametrize(
    ("goals", "sentence"),
    [
        ({"sensitivity": 1.0}, "--margin 1: no loop keeps"),
        ({"sensitivity": math.nan}, "--margin nan"),
        ({"overshoot": -0.1}, "--overshoot-percent -10: expected 0 to 100"),
        ({"bandwidth": 0.0}, "--bandwidth-Hz 0: expected more than 0"),
    ],
)
def test_goals_that_nothing_meets_are_refused(goals, sentence):
    with pytest.raises(InputRefused, match=sentence):
        Goals(**goals)


def test_a_bandwidth_beyond_half_the_controllers_rate_is_refused():
    Goals(bandwidth=2.0 * math.pi * 249.0).refuse_period(2e-3)
    with pytest.raises(InputRefused, match="beyond half the controller's rate of 500 Hz"):
        Goals(bandwidth=2.0 * math.pi * 251.0).refuse_period(2e-3)


@pytest.mark.parametrize("text", ["300", "soft:hard", "5000:300", "0:100", "-1:1", "1:inf", "1:nan", "1:2:3", "1:"])
def test_a_stiffness_that_is_no_range_is_refused(text):
    with pytest.raises(InputRefused, match="expected two numbers above 0"):
        stiffness_range(text)


def test_a_range_of_one_stiffness_is_a_range():
    assert stiffness_range("300:300") == (300.0, 300.0)
