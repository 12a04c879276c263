"""A log in memory: series in SI units by the product's own names."""

import re
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from twin.errors import nearest
from twin.recording.logs.errors import LogRefused
from twin.recording.logs.sampling import Sampling, sampling


@dataclass(frozen=True)
class LogSeries:
    """One quantity over time.

    Attributes:
        t: times of the samples, s, strictly ascending, (n,).
        values: in `unit`, (n,), or (n, k) from `Log.vector`.
        unit: SI, as recordings write it: `N`, `rad/s`, `1`.
    """

    t: NDArray[np.float64]
    values: NDArray[np.float64]
    unit: str

    @cached_property
    def sampling(self) -> Sampling:
        """How it is sampled and what is missing; n >= 2."""
        return sampling(self.t)


@dataclass(frozen=True, repr=False)
class Log:
    """What a file holds: `log["controller.F_z"]`, `log.vector("plant.p_B")`.

    Attributes:
        path: of the file.
        series: scalar series by name; a component of a vector is `plant.p_B[2]`.
        notes: sentences on what is incomplete: samples that are missing, an end that is cut off.
        comments: lines of the file's head that start with #, without it.
    """

    path: Path
    series: dict[str, LogSeries]
    notes: tuple[str, ...] = ()
    comments: tuple[str, ...] = ()

    def __getitem__(self, name: str) -> LogSeries:
        """The scalar series `name`.

        Raises:
            LogRefused: there is none; it names the nearest ones.
        """
        if name not in self.series:
            raise LogRefused(f"{self.path}: '{name}' is not there; {nearest(name, self.series, 'it has {}', 3)}")
        return self.series[name]

    def vector(self, name: str) -> LogSeries:
        """The components `name[0]`, `name[1]`, ... as one series of values (n, k).

        Raises:
            LogRefused: there are none, one is left out, or they differ in times or unit.
        """
        indices = sorted(int(m[1]) for key in self.series if (m := re.fullmatch(re.escape(name) + r"\[(\d+)\]", key)))
        if not indices:
            # the sentence about the nearest names is the same as for a scalar
            self[f"{name}[0]"]
        if indices != list(range(len(indices))):
            raise LogRefused(f"{self.path}: '{name}' has components {indices}, expected all from 0 on")
        parts = [self.series[f"{name}[{i}]"] for i in indices]
        if any(part.unit != parts[0].unit or not np.array_equal(part.t, parts[0].t) for part in parts):
            raise LogRefused(f"{self.path}: the components of '{name}' differ in unit or in times")
        return LogSeries(parts[0].t, np.stack([part.values for part in parts], axis=1), parts[0].unit)
