"""All samples of a run as one text that a browser turns back into numbers fast."""

import math

import numpy as np
from numpy.typing import NDArray

from twin.studies.metrics.response import Curve
from twin.studies.packing import text_of


class DataBlock:
    """The samples of one run, in the order in which they were added."""

    def __init__(self) -> None:
        self._parts: list[NDArray[np.float32]] = []
        self._length = 0

    def add(self, values: Curve) -> list[int]:
        """[where they begin, how many there are] of `values`, of any shape, row by row."""
        part = np.ravel(values).astype("<f4")
        place = [self._length, part.size]
        self._parts.append(part)
        self._length += part.size
        return place

    def text(self) -> str:
        """Everything added, as `twin.studies.packing` writes it."""
        return text_of(np.concatenate([np.empty(0, "<f4"), *self._parts]))


def thinned(values: Curve, factor: int) -> Curve:
    """Every `factor`-th part as many samples (n,) in which every peak remains: the extremes of every 2 `factor`.

    Of each pair the one that comes first stands first. Sample j lies within 2 `factor` samples of j times `factor`.
    """
    if factor == 1:
        return values
    width = 2 * factor
    padded = np.pad(values, (0, -len(values) % width), mode="edge").reshape(-1, width)
    pair = np.sort(np.column_stack([padded.argmin(axis=1), padded.argmax(axis=1)]), axis=1)
    return np.take_along_axis(padded, pair, axis=1).ravel()


def thinning(samples: int, most: int) -> int:
    """The factor by which `samples` have to be thinned so that about `most` are left."""
    return max(1, math.ceil(samples / most))
