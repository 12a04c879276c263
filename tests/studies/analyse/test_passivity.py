"""Fig. 4's robot in the hand, judged once."""

import numpy as np
import pytest

from tests.laws.runs import shipped
from twin.studies.analyse.linear.hand import DRIFT
from twin.studies.analyse.passivity import Passivity, passivity
from twin.studies.analyse.passivity_text import passivity_text
from twin.studies.analyse.z_width import largest_passive
from twin.studies.steps import silent


@pytest.fixture(scope="module")
def fig4() -> Passivity:
    return passivity(shipped(), True, silent)


def test_the_force_loop_is_passive_along_z_and_the_position_law_nowhere(fig4: Passivity):
    for point in fig4.points:
        assert point.stable
        assert (point.bands["z"] is None) == point.point.force_on
        for axis in ("x", "y", "all"):
            found = point.bands[axis]
            # a spring behind a position law turns back what it gets below the robot's own swing
            assert found is not None and found.low < 0.03 and 2.0 < found.high < 12.0


def test_no_more_than_the_springs_is_rendered_passively_and_nearly_that_is(fig4: Passivity):
    assert fig4.width is not None
    rendered, virtual, damping = fig4.width.largest
    assert 0.9 * fig4.width.spring < rendered <= fig4.width.spring
    # the droop of the drives takes some of what is asked for
    assert virtual > rendered and damping > 0.0


def test_soft_and_damped_is_passive_and_stiff_with_little_damping_unstable(fig4: Passivity):
    assert fig4.width is not None
    least = fig4.width.least
    assert least[-1, 0] > 0.0 and np.isnan(least[0, -1]) and least[-1, -1] < 0.0


def test_it_swings_with_a_mass_and_the_co_simulation_agrees_just_inside_and_just_outside(fig4: Passivity):
    assert all(point.worst.growth > DRIFT and point.worst.mass > 1.0 for point in fig4.points)
    trial = fig4.trial
    assert trial is not None and trial.confirmed
    assert trial.predicted[0] < 0.0 < trial.predicted[1]
    # encoders, drives and coupling are the same; the nudge is not infinitely small
    np.testing.assert_allclose(trial.simulated, trial.predicted, atol=0.04)


def test_the_text_fits_80_columns_and_says_the_verdict_first(fig4: Passivity):
    lines = passivity_text(fig4).splitlines()
    assert lines[0] == "fig4_force_position  passive in the hand at 0 of 5 operating points"
    assert max(map(len, lines)) <= 80
    assert "the co-simulation agrees" in " ".join(line.strip() for line in lines)


def test_the_largest_passive_stiffness_is_bisected_from_the_map():
    row = np.array([1.0] * 10 + [-1.0] * 18)
    found = largest_passive(lambda stiffness: 300.0 - stiffness, row)
    assert found == pytest.approx(300.0, rel=1e-3)
    assert largest_passive(lambda stiffness: 1.0, np.full(28, np.nan)) == 0.0
