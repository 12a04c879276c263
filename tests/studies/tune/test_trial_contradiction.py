import math
from dataclasses import replace

import numpy as np
import pytest

from tests.studies.tune.corners import fig4_corners
from twin.studies.tune.gains import LawGains
from twin.studies.tune.goals import Goals
from twin.studies.tune.prediction import predicted
from twin.studies.tune.trial import StepTrial, contradiction

FAST = predicted(fig4_corners()[5], LawGains(5.0, 1.5e-3, 3.5e-3))
LINEAR = FAST.answers["force"]
GOALS = Goals(overshoot=0.05)


def trial(swing: float = 0.0, **different: float) -> StepTrial:
    """A step that is as predicted but for what is `different`."""
    return StepTrial(FAST.corner, "force", np.zeros(1), np.zeros(1), replace(LINEAR, **different), swing)


def test_a_step_as_predicted_contradicts_nothing():
    assert contradiction(trial(), FAST, GOALS) == ""


@pytest.mark.parametrize(
    ("simulated", "sentence"),
    [
        (trial(swing=0.3), "never comes to rest, it swings by 30 % of the step"),
        (trial(overshoot=0.2), "overshoots by 20 %"),
        (trial(settling=math.inf, bandwidth=math.nan), "not within 5 % of its end after 8 s"),
    ],
)
def test_what_the_goals_forbid_and_the_model_does_not_foresee_is_a_contradiction(simulated, sentence):
    assert sentence in contradiction(simulated, FAST, GOALS)


def test_a_step_that_is_predicted_to_creep_may_creep():
    creeping = replace(FAST, answers={"force": replace(LINEAR, settling=math.inf)})
    assert contradiction(trial(settling=math.inf, bandwidth=math.nan), creeping, GOALS) == ""


def test_a_bandwidth_that_only_the_model_has_is_a_contradiction():
    goals = replace(GOALS, bandwidth=0.95 * LINEAR.bandwidth)
    slow = trial(bandwidth=0.7 * LINEAR.bandwidth)
    assert "bandwidth of" in contradiction(slow, FAST, goals)
    assert contradiction(slow, FAST, GOALS) == ""
    # that 10 times as much is not to be had is told as a goal that is missed
    assert contradiction(trial(), FAST, replace(GOALS, bandwidth=10.0 * LINEAR.bandwidth)) == ""
