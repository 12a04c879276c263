import numpy as np

from twin.robot.faults import first_state, next_uniform

MEMORY = np.dtype([("random", "u8")], align=True)


def stream(state: int, count: int) -> np.ndarray:
    memory = np.array([(state,)], dtype=MEMORY).view(np.recarray)
    return np.array([next_uniform(memory[0]) for _ in range(count)])


def test_the_generator_is_splitmix64():
    # the first outputs for seed 1234567, published with many implementations; of each the upper 53 bits
    published = [6457827717110365317, 3203168211198807973, 9817491932198370423, 4593380528125082431]
    expected = [(z >> 11) * 2.0**-53 for z in published]
    np.testing.assert_array_equal(stream(1234567, 4), expected)


def test_numbers_are_uniform_from_0_to_1():
    numbers = stream(first_state(7, 1), 20_000)
    assert np.all((numbers >= 0.0) & (numbers < 1.0))
    # five standard deviations of counts in ten bins
    assert np.abs(np.histogram(numbers, 10, (0.0, 1.0))[0] - 2000).max() < 5.0 * np.sqrt(1800.0)
    # and of the correlation of neighbours
    assert abs(np.corrcoef(numbers[1:], numbers[:-1])[0, 1]) < 5.0 / np.sqrt(20_000)


def test_seeds_and_numbers_of_faults_give_streams_of_their_own():
    states = [first_state(seed, number) for seed in range(50) for number in range(1, 50)]
    assert len(set(states)) == len(states)
    assert all(0 <= state < 2**64 for state in [*states, first_state(2**64 - 1, 9), first_state(-1, 1)])
