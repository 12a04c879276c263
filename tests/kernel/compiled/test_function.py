"""Three numbers in one register are what each of them would be alone, to the last bit."""

import math
import struct

from hypothesis import given
from hypothesis import strategies as st

from twin.kernel.compiled.function import njit, three

NUMBER = st.floats(allow_nan=True, allow_infinity=True, allow_subnormal=True)
TRIPLE = st.tuples(NUMBER, NUMBER, NUMBER)


@njit(cache=False, error_model="numpy")
def alone(a, b, plain):
    """Every operation once; `a` and `b` are numbers or lanes."""
    plainly = plain - a, a - plain, plain / a, a / plain, plain * a, a + plain
    return a + b, a - b, a * b, a / b, -a, math.sqrt(a), *plainly


@njit(cache=False, error_model="numpy")
def at_once(a, b, plain):
    found = alone(three(a[0], a[1], a[2]), three(b[0], b[1], b[2]), plain)
    return tuples(found, 0), tuples(found, 1), tuples(found, 2)


@njit(cache=False)
def tuples(f, k):
    return f[0][k], f[1][k], f[2][k], f[3][k], f[4][k], f[5][k], f[6][k], f[7][k], f[8][k], f[9][k], f[10][k], f[11][k]


def bits(values: tuple[float, ...]) -> list[bytes]:
    """Any NaN is NaN: which one a processor gives is nobody's promise."""
    return [b"NaN" if math.isnan(value) else struct.pack("<d", value) for value in values]


@given(TRIPLE, TRIPLE, NUMBER)
def test_each_is_rounded_as_it_would_be_alone(
    a: tuple[float, float, float], b: tuple[float, float, float], plain: float
) -> None:
    for k, found in enumerate(at_once(a, b, plain)):
        assert bits(found) == bits(alone(a[k], b[k], plain)), k
