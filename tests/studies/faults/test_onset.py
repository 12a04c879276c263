import numpy as np
import pytest

from twin.errors import InputRefused
from twin.studies.faults.onset import default_onsets, touching
from twin.studies.faults.trial import FaultTrial


def healthy(force, z) -> FaultTrial:
    return FaultTrial(np.array(force, dtype=float), np.array(z, dtype=float), None, None, "", "")


def test_onsets_are_the_middles_of_the_descent_and_of_the_longest_contact():
    # rests for 4 ticks, falls from tick 3 on, touches from tick 9 to 11 and from 14 to 20
    z = [5, 5, 5, 5, 4, 3, 2, 1, 0, -1, -1, -1, 0, 0, -1, -1, -1, -1, -1, -1, -1, 0]
    force = [0] * 9 + [1] * 3 + [0] * 2 + [1] * 7 + [0]
    free, contact = default_onsets(healthy(force, z))
    assert free == (3 + 9) // 2
    assert contact == (14 + 21) // 2


def test_a_robot_that_touches_from_the_start_has_both_onsets_too():
    assert default_onsets(healthy([2, 2, 2, 0], [0, 0, 0, 1])) == (0, 1)


def test_a_lighter_touch_than_half_a_newton_is_none():
    assert not touching(healthy([0.4, 0.49], [0, 0])).any()


def test_a_run_without_contact_asks_for_an_onset():
    with pytest.raises(InputRefused, match=r"touches nothing.*--onset S"):
        default_onsets(healthy([0, 0], [1, 0]))
