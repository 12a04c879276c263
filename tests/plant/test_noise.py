import numpy as np
from scipy import stats

from twin.plant.noise import normal, random_word, uniform


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
