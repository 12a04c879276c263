"""Arguments that hold three numbers per pose, checked once at the package's public functions."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twin.errors import InputRefused


def triples(values: ArrayLike, name: str) -> NDArray[np.float64]:
    """The argument as a float array of shape (..., 3).

    Raises:
        InputRefused: the last axis is not 3 long, or a number is not finite.
    """
    array = np.asarray(values, dtype=np.float64)
    if array.ndim == 0 or array.shape[-1] != 3:
        raise InputRefused(f"{name} has shape {array.shape}; expected (..., 3)")
    if not np.isfinite(array).all():
        first = int(np.argmin(np.isfinite(array).all(axis=-1)))
        raise InputRefused(f"{name}{place(array, first)} = {array.reshape(-1, 3)[first]} is not finite")
    return array


def place(array: NDArray[np.float64], row: int) -> str:
    """Index of a flattened row of a (..., 3) array, written ``[i, j]``; empty where there is only one row."""
    if array.ndim == 1:
        return ""
    return str([int(i) for i in np.unravel_index(row, array.shape[:-1])])
