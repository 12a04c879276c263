import numpy as np
import pytest

from tests.studies.analyse.simulated import fig4
from twin.studies.analyse.nudge import Aftermath, aftermath, swing
from twin.studies.analyse.operating_point import operating_points

NUDGE = 1e-4


@pytest.mark.parametrize(
    ("hum", "left", "lasts"),
    [
        (0.0, 0.39e-4, False),
        (0.0, 0.41e-4, True),
        # a drive that hums by 0.2 mm may go on with it, and with a little more
        (2e-4, 5e-4, False),
        (2e-4, 7e-4, True),
        # nothing that swings by more than a millimetre is a hum
        (5e-3, 2e-3, True),
        (0.0, np.inf, True),
    ],
)
def test_a_nudge_lasts_if_much_of_it_is_left_that_was_no_hum(hum, left, lasts):
    assert Aftermath(hum, left).lasts(NUDGE) == lasts


def test_a_swing_is_told_without_the_creeping_below_it():
    t = np.linspace(0.0, 1.0, 1001)
    p_B = np.stack([0.1 * t, 2e-4 * np.sin(20.0 * np.pi * t) + 0.3 * t, 0.2 - 0.1 * t], axis=1)
    # ten whole swings tilt the line by a twelfth of themselves
    assert swing(p_B) == pytest.approx(4e-4, rel=0.1)


def test_a_run_that_fails_or_goes_far_off_leaves_a_lasting_swing():
    experiment = fig4(())
    air = operating_points(experiment)[0][1]
    assert aftermath(experiment, air, "position", 40.0, NUDGE) == Aftermath(0.0, np.inf)
    still = aftermath(experiment, air, "position", 1.0, NUDGE)
    # nothing hums in the default drive, and a tenth of the limit lets a nudge die out at once
    assert still.hum < 0.1 * NUDGE and still.left < 0.1 * NUDGE
