"""Where the numbers of an array are in memory.

Numpy makes an object of Python to tell, which takes as long as compiled code takes to fill fifty records; the same
number stands in the array's own memory, behind what every object of the interpreter begins with.
"""

import ctypes
from collections.abc import Callable

import numpy as np

_HEAD = object.__basicsize__
_number_at = ctypes.c_ssize_t.from_address


def _read(array: np.ndarray) -> int:
    return _number_at(id(array) + _HEAD).value


def _asked(array: np.ndarray) -> int:
    return array.ctypes.data


def _way() -> Callable[[np.ndarray], int]:
    probe = np.empty(2)
    # an interpreter or a numpy whose objects are laid out otherwise
    return _read if all(_read(a) == _asked(a) for a in (probe, probe[1:])) else _asked


address = _way()
"""Of the first number of an array."""
