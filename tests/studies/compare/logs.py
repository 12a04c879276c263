"""Logs made of arrays, for tests."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from twin.kernel.recording.logs.log import Log, LogSeries


def log_of(
    t: np.ndarray, signals: Mapping[str, np.ndarray] | None = None, path: str = "a.csv", **more: np.ndarray
) -> Log:
    """A log of `signals` and `more` (n,) in N at the times t (n,)."""
    named = {**(signals or {}), **more}
    return Log(Path(path), {name: LogSeries(t, values, "N") for name, values in named.items()})
