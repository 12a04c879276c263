"""A random generator small enough to live in a component's memory: the same seed gives the same bytes.

SplitMix64: Steele, Lea, Flood, "Fast splittable pseudorandom number generators", OOPSLA 2014, with the constants of
Vigna's public-domain splitmix64.c.
"""

import numpy as np

from twin.compiled.function import njit

_GAMMA, _MIX_1, _MIX_2 = (np.uint64(n) for n in (0x9E3779B97F4A7C15, 0xBF58476D1CE4E5B9, 0x94D049BB133111EB))
_27, _30, _31, _11 = (np.uint64(n) for n in (27, 30, 31, 11))
_UNIT = 2.0**-53


@njit(cache=True)
def mixed(z):
    """SplitMix64's scrambling of a uint64."""
    z = (z ^ (z >> _30)) * _MIX_1
    z = (z ^ (z >> _27)) * _MIX_2
    return z ^ (z >> _31)


@njit(cache=True)
def drawn(memory):
    """The next number of the generator in `memory.random` (uint64): uniform in [0, 1)."""
    memory.random += _GAMMA
    return (mixed(memory.random) >> _11) * _UNIT


def first_state(seed: int, number: int) -> int:
    """State of the generator of the fault with this number: the same `seed` serves them all, and each draws its own."""
    # modulo 2**64, which is what is meant
    with np.errstate(over="ignore"):
        return int(mixed(np.uint64((seed + number * int(_GAMMA)) % 2**64)))
