"""White noise from a generator whose whole state is one word in a component's memory: same seed, same bytes."""

import math

import numpy as np

from twin.compiled.function import njit

# Steele, Lea and Flood (2014), Fast splittable pseudorandom number generators, OOPSLA; the constants of splitmix64
_STRIDE = np.uint64(0x9E3779B97F4A7C15)
_MIX_1, _MIX_2 = np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)
_30, _27, _31, _11 = np.uint64(30), np.uint64(27), np.uint64(31), np.uint64(11)


@njit(cache=True)
def random_word(state):
    """The next 64 bits of the generator `state`, an array (1,) of uint64 that is moved on: splitmix64."""
    state[0] += _STRIDE
    word = state[0]
    word = (word ^ (word >> _30)) * _MIX_1
    word = (word ^ (word >> _27)) * _MIX_2
    return word ^ (word >> _31)


@njit(cache=True)
def uniform(state):
    """A number in (0, 1] with 53 random bits."""
    return float((random_word(state) >> _11) + np.uint64(1)) * 2.0**-53


@njit(cache=True)
def normal(state):
    """A normally distributed number with mean 0 and variance 1: Box and Muller (1958), Ann Math Stat 29:610."""
    radius = math.sqrt(-2.0 * math.log(uniform(state)))
    return radius * math.cos(2.0 * math.pi * uniform(state))
