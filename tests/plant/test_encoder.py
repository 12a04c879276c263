import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.laws.runs import Sampled
from twin.plant.encoder import Encoder

MOTOR, JOINT = 4096, 16384
angles = st.tuples(*[st.floats(-10.0, 10.0)] * 6).map(np.array)
COUNTS_PER_RAD = np.repeat([MOTOR, JOINT], 3) / (2.0 * np.pi)


@given(angles)
def test_counts_are_whole_and_the_nearest(theta):
    counts = Sampled(Encoder(MOTOR, JOINT))(theta)
    np.testing.assert_array_equal(counts, np.round(counts))
    # half a count, and rounding of angles of 10 rad
    assert np.abs(counts - theta * COUNTS_PER_RAD).max() <= 0.5 + 1e-10


@given(angles, st.integers(-2000, 2000))
def test_whole_turns_are_counted(theta, turns):
    # away from the edge between two counts, where rounding of the angle decides
    theta = (np.floor(theta * COUNTS_PER_RAD) + 0.3) / COUNTS_PER_RAD
    more = theta + 2.0 * np.pi * turns
    encoder = Sampled(Encoder(MOTOR, JOINT))
    np.testing.assert_array_equal(encoder(more) - encoder(theta), np.repeat([MOTOR, JOINT], 3) * turns)


def test_zero_error_is_added_to_the_true_angle():
    motor_zero, joint_zero = (0.1, 0.2, -0.3), (-0.01, 0.02, 0.03)
    counts = Sampled(Encoder(MOTOR, JOINT, motor_zero, joint_zero))(np.zeros(6))
    # half a count
    assert counts / COUNTS_PER_RAD == pytest.approx([*motor_zero, *joint_zero], abs=0.5 / COUNTS_PER_RAD[0])
    assert counts[5] == round(0.03 * COUNTS_PER_RAD[5])


@pytest.mark.parametrize(("angle", "count"), [(0.5, 1), (0.499, 0), (-0.499, 0), (-0.501, -1), (1.5, 2)])
def test_half_a_count_rounds_up(angle, count):
    # as many counts as 2 pi, so that an angle is its own number of counts
    encoder = Sampled(Encoder(2.0 * np.pi, 2.0 * np.pi))
    np.testing.assert_array_equal(encoder(np.full(6, angle)), count)
