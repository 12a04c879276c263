import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from tests.laws.runs import ComponentStepper
from twin.kernel.errors import ComponentFailed
from twin.robot.plant.encoder import Encoder, Shaft, normal, random_word, uniform


def test_the_generator_is_splitmix64():
    state = np.zeros(1, dtype=np.uint64)
    words = [int(random_word(state)) for _ in range(3)]
    # the published generator's first words from seed 0
    assert words == [0xE220A8397B1DCDAF, 0x6E789E6AA1B965F4, 0x06C45D188009454F]


def test_uniform_numbers_are_uniform():
    state = np.ones(1, dtype=np.uint64)
    numbers = [uniform(state) for _ in range(20_000)]
    # deterministic: a right generator fails for one seed of a thousand
    assert stats.kstest(numbers, "uniform").pvalue > 1e-3


def test_normal_numbers_are_normal():
    state = np.ones(1, dtype=np.uint64)
    numbers = [normal(state) for _ in range(20_000)]
    # as above
    assert stats.kstest(numbers, "norm").pvalue > 1e-3


MOTOR, JOINT = 4096, 16384
angles = st.tuples(*[st.floats(-10.0, 10.0)] * 6).map(np.array)
COUNTS_PER_RAD = np.repeat([MOTOR, JOINT], 3) / (2.0 * np.pi)


@given(angles)
def test_counts_are_whole_and_the_nearest(theta):
    counts = ComponentStepper(Encoder(Shaft(MOTOR), Shaft(JOINT)))(theta)[:6]
    np.testing.assert_array_equal(counts, np.round(counts))
    # half a count, and rounding of angles of 10 rad
    assert np.abs(counts - theta * COUNTS_PER_RAD).max() <= 0.5 + 1e-10


@given(angles, st.integers(-2000, 2000))
def test_whole_turns_are_counted(theta, turns):
    # away from the edge between two counts, where rounding of the angle decides
    theta = (np.floor(theta * COUNTS_PER_RAD) + 0.3) / COUNTS_PER_RAD
    more = theta + 2.0 * np.pi * turns
    encoder = ComponentStepper(Encoder(Shaft(MOTOR), Shaft(JOINT)))
    np.testing.assert_array_equal((encoder(more) - encoder(theta))[:6], np.repeat([MOTOR, JOINT], 3) * turns)


def test_zero_error_is_added_to_the_true_angle():
    motor_zero, joint_zero = (0.1, 0.2, -0.3), (-0.01, 0.02, 0.03)
    counts = ComponentStepper(Encoder(Shaft(MOTOR, motor_zero), Shaft(JOINT, joint_zero)))(np.zeros(6))[:6]
    # half a count
    assert counts / COUNTS_PER_RAD == pytest.approx([*motor_zero, *joint_zero], abs=0.5 / COUNTS_PER_RAD[0])
    assert counts[5] == round(0.03 * COUNTS_PER_RAD[5])


@pytest.mark.parametrize(("angle", "count"), [(0.5, 1), (0.499, 0), (-0.499, 0), (-0.501, -1), (1.5, 2)])
def test_half_a_count_rounds_up(angle, count):
    # as many counts as 2 pi, so that an angle is its own number of counts
    encoder = ComponentStepper(Encoder(Shaft(2.0 * np.pi), Shaft(2.0 * np.pi)))
    np.testing.assert_array_equal(encoder(np.full(6, angle))[:6], count)


@pytest.mark.parametrize("angle", [np.nan, np.inf, -np.inf, 1e300, -1e300, 2.0**53 / MOTOR * 2.0 * np.pi])
@pytest.mark.parametrize("shaft", range(6))
def test_an_angle_that_no_integer_counts_has_no_count(shaft, angle):
    """What an integer becomes of it is another one on each kind of processor."""
    angles = np.zeros(6)
    angles[shaft] = angle
    encoder = ComponentStepper(Encoder(Shaft(MOTOR), Shaft(JOINT)))
    with pytest.raises(ComponentFailed, match="encoder got an angle that it cannot count"):
        encoder(angles)


def test_samples_are_numbered_from_one():
    encoder = ComponentStepper(Encoder(Shaft(MOTOR), Shaft(JOINT)))
    assert [encoder.outputs_by_port(np.zeros(6))["sample"][0] for _ in range(4)] == [1.0, 2.0, 3.0, 4.0]


def read_noise(seed, samples=4000, motor_noise=0.02, joint_noise=0.01):
    """Angles (samples, 6) that encoders of very many counts read at zero, rad."""
    fine = 2.0 * np.pi * 2.0**40
    encoder = ComponentStepper(Encoder(Shaft(fine, noise=motor_noise), Shaft(fine, noise=joint_noise), seed=seed))
    return np.array([encoder(np.zeros(6))[:6] for _ in range(samples)]) / 2.0**40


def test_noise_has_the_deviation_it_was_given_and_no_memory():
    noise = read_noise(1) / np.repeat([0.02, 0.01], 3)
    # five standard errors of the mean, of the variance and of correlations: 1, sqrt(2) and 1 over sqrt(4000)
    assert np.abs(noise.mean(axis=0)).max() < 5.0 / np.sqrt(4000)
    assert np.abs(noise.var(axis=0) - 1.0).max() < 5.0 * np.sqrt(2.0 / 4000)
    between_encoders = np.corrcoef(noise.T) - np.eye(6)
    from_sample_to_sample = np.mean(noise[1:] * noise[:-1], axis=0)
    assert max(np.abs(between_encoders).max(), np.abs(from_sample_to_sample).max()) < 5.0 / np.sqrt(4000)


def test_the_same_seed_gives_the_same_noise_and_another_seed_another():
    np.testing.assert_array_equal(read_noise(7, 50), read_noise(7, 50))
    assert np.abs(read_noise(7, 50) - read_noise(8, 50)).min() > 0.0


def test_noise_is_on_the_angle_before_it_is_rounded():
    encoder = ComponentStepper(Encoder(Shaft(MOTOR, noise=1e-2), Shaft(JOINT, noise=1e-2)))
    counts = np.array([encoder(np.zeros(6))[:6] for _ in range(50)])
    np.testing.assert_array_equal(counts, np.round(counts))
    assert np.ptp(counts, axis=0).min() > 3


@given(angles)
def test_one_encoder_may_be_noisy_without_the_other(theta):
    clean, noisy = (
        ComponentStepper(Encoder(Shaft(MOTOR), Shaft(JOINT)))(theta),
        ComponentStepper(Encoder(Shaft(MOTOR, noise=0.1), Shaft(JOINT)))(theta),
    )
    np.testing.assert_array_equal(noisy[3:6], clean[3:6])


@given(st.tuples(*[st.floats(-0.05, 0.05)] * 3), st.tuples(*[st.floats(-3.0, 3.0)] * 3))
def test_an_encoder_off_its_axis_reads_wrong_once_a_turn_by_its_eccentricity(eccentricity, at):
    fine = Shaft(2.0 * np.pi * 2.0**40, eccentricity=eccentricity, eccentric_at=at)
    encoder = ComponentStepper(Encoder(fine, Shaft(MOTOR)))
    turn = 2.0 * np.pi * np.arange(16) / 16
    error = np.array([encoder(np.full(6, angle))[:3] / 2.0**40 - angle for angle in turn])
    harmonics = np.fft.rfft(error, axis=0) / 8.0
    # counts of 1e-12 rad
    expected = np.array(eccentricity) * np.exp(-1j * (np.array(at) + np.pi / 2.0))
    np.testing.assert_allclose(harmonics[1], expected, rtol=0, atol=1e-11)
    np.testing.assert_allclose(np.delete(harmonics, 1, axis=0), 0.0, atol=1e-11)
    # at the angle it is told of it is right, and grows from there
    there = encoder(np.array([*at, 0.0, 0.0, 0.0]))[:3] / 2.0**40 - np.array(at)
    np.testing.assert_allclose(there, 0.0, atol=1e-11)
