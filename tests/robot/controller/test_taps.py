"""Taps that learn from their force, on a soft floor, without robot and drives."""

from itertools import pairwise

import numpy as np
import pytest

from tests.robot.controller.soft_floor import (
    APPROACH,
    FORCE_GAINS,
    FORWARD,
    LAW,
    TAP,
    UNDAMPED,
    World,
    carried_out,
    phases_of,
)
from tests.robot.controller.soft_floor import TOUCH as NOT_LEARNING
from twin.robot.controller.adaptive import AdaptiveOptions
from twin.robot.controller.machine import MACHINE_RECORD
from twin.robot.controller.program import PHASE_RECORD
from twin.robot.controller.program import PhaseKind as Kind
from twin.robot.controller.taps import TAPS_RECORD, _update_tap
from twin.robot.controller.tissue import Sensing

SENSING = Sensing(5.0, 0.5, 0.0, 0.1, 0.2, 0.3, 0.0, 0.0, 4.0, 1e-4, 1e-4)
"""Of a platform without mass, as the soft floor's is."""


def peaks(rows):
    """Largest force of each tap (N)."""
    raw = 1000.0 * np.maximum(0.0, -0.1 - rows["z"])
    begins = [k for _, kind, k in phases_of(rows) if kind == Kind.TAP] + [len(raw)]
    return np.array([raw[a:b].max() for a, b in pairwise(begins)])


def tapped(learning, late=10, turn=0.0, drag=0.0):
    tap = TAP.model_copy(update={"times": 8, "force": 4.0})
    touch = NOT_LEARNING.model_copy(update={"turn": turn})
    adapting = AdaptiveOptions(SENSING, tap_learning=learning) if learning else None
    return peaks(carried_out([tap], 8.0, World("velocity", late, drag=drag), touch=touch, adapting=adapting))


def test_taps_of_a_drive_that_is_late_are_too_hard_and_stay_so_without_learning():
    # 20 ms late at 100 mm/s on 1000 N/m: 2 N
    assert tapped(0.0) == pytest.approx(6.0, abs=0.3)


@pytest.mark.parametrize("late", [3, 10])
def test_taps_that_learn_come_to_the_force_that_was_asked_for(late):
    learnt = tapped(0.5, late)
    # what is left: one call at 100 mm/s is 0.2 N, the low-pass takes some of the peak
    assert learnt[-3:] == pytest.approx(4.0, abs=0.35)
    assert abs(learnt[3] - 4.0) < 0.6 * abs(learnt[0] - 4.0) or abs(learnt[3] - 4.0) < 0.35


def test_what_the_estimate_makes_of_speed_is_learnt_in_the_air():
    # 1 N at the speed of the touch, three times what is left as above
    assert tapped(0.5, 3, drag=10.0)[-3:] == pytest.approx(4.0, abs=0.35)


def test_nothing_of_it_is_on_by_default():
    assert UNDAMPED.gain == 0.0 and FORWARD.lag == 0.0
    plain = carried_out([TAP], 5.0, law=LAW, force=FORCE_GAINS, approach=APPROACH)
    assert "k_hat" not in plain


@pytest.mark.parametrize(("F_before", "surface"), [(0.5, -0.101), (2.0, -0.105 + 2.0 / 400.0)])
def test_the_surface_is_where_the_force_of_its_touch_was_or_as_far_up_as_the_stiffness_says(F_before, surface):
    """From 0.5 N at -0.1 m to 3.0 N at -0.105 m; 1 N was felt where the probe began, at a fifth of the way."""
    taps, machine, phase = (np.zeros(1, kind)[0] for kind in (TAPS_RECORD, MACHINE_RECORD, PHASE_RECORD))
    taps["kind"], taps["k"], taps["depth"] = Kind.TAP, 400.0, 0.004
    taps["F_begun"], taps["z_before"], taps["F_before"] = 1.0, -0.1, F_before
    _update_tap(taps, machine, phase, 0.1, -0.105, 3.0)
    assert machine["z_turn"] == pytest.approx(surface - 0.004, rel=1e-12)
