import math

import numpy as np
import pytest

from tests.laws.runs import shipped
from tests.studies.tune.corners import fig4_corners
from twin.studies.tune.corner import at_stiffness
from twin.studies.tune.gains import LawGains
from twin.studies.tune.prediction import predicted
from twin.studies.tune.trial import can_be_tried, lasting_swing, step_bandwidth, step_trial, whole_run

FAST = LawGains(5.0, 1.5e-3, 3.5e-3)


@pytest.mark.parametrize("i", [1, 5])
def test_the_co_simulation_answers_a_step_as_predicted_in_spite_of_backlash_and_counts(i):
    corner = fig4_corners()[i]
    trial = step_trial(corner, FAST)
    assert trial is not None
    (found,) = predicted(corner, FAST).answers.values()
    # backlash and encoder counts: 0.05 N of 2 N, 0.02 mm of 1 mm
    assert trial.answer.overshoot == pytest.approx(found.overshoot, abs=0.03)
    assert trial.answer.bandwidth == pytest.approx(found.bandwidth, rel=0.15)
    # it comes to rest within what backlash and counts leave open
    assert trial.swing < 0.03
    # where the answer creeps into the band such a difference is much time
    assert trial.answer.settling == pytest.approx(found.settling, rel=0.2)


def test_a_corner_is_co_simulated_on_its_own_stiffness_at_its_own_height():
    corner = fig4_corners()[5]
    contact, p = at_stiffness(corner).contact, corner.point.parameters
    assert (contact.stiffness, contact.height) == (5000.0, p.z_s)


def test_gains_that_shake_in_the_co_simulation_never_settle():
    # docs/analysis.md: the limit of kp in air is 19.4 1/s
    trial = step_trial(fig4_corners()[1], LawGains(30.0, 0.0, 0.0))
    assert trial is None or (trial.answer.overshoot > 1.0 and math.isinf(trial.answer.settling))


def test_the_bandwidth_of_a_first_order_lag_is_that_of_its_pole():
    t = np.linspace(0.0, 8.0, 8000, endpoint=False)
    # the spectrum is taken every 0.02 rad/s, and the lag is sampled
    assert step_bandwidth(1.0 - np.exp(-5.0 * t), 1e-3) == pytest.approx(5.0, abs=0.05)


def test_a_swing_is_told_from_creeping():
    t = np.linspace(0.0, 8.0, 8000, endpoint=False)
    creeping = 1.0 - 0.1 * t
    assert lasting_swing(t, creeping) == pytest.approx(0.0, abs=1e-9)
    # 40 periods in the last quarter: the line through them is level but for a share of 1/40
    assert lasting_swing(t, creeping + 0.2 * np.sin(2.0 * np.pi * 20.0 * t)) == pytest.approx(0.4, rel=0.03)


def test_the_position_law_is_tried_in_air_and_the_force_law_pressing():
    assert all(can_be_tried(corner) for corner in fig4_corners())


def test_the_experiment_itself_comes_to_what_twin_run_says():
    whole = whole_run(shipped(), "drive", LawGains(1.5, 2e-3, 0.5e-3))
    assert whole.outcome is not None and whole.trip == ""
    # its own gains: final true force 4.88 N, docs/physics.md
    assert whole.outcome.end == pytest.approx(4.88, abs=0.1)
    assert math.isfinite(whole.outcome.force_error or math.nan)
