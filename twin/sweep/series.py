"""A run in memory, read like a recording."""

import numpy as np

from twin.cosim.system import System
from twin.recording.series import NANOSECONDS


class RunSeries:
    """The rows of a finished run: `series["plant.p_B"]`, `series.time("plant")`.

    Args:
        system: whose outputs they are. values: (ticks, outputs), one row per tick from tick 0 on.

    Attributes:
        metadata: none.
    """

    def __init__(self, system: System, values: np.ndarray):
        self._system, self._values = system, values
        self._periods = {component.name: component.period for component in system.components}
        self.metadata: dict[str, dict[str, str]] = {}

    def __getitem__(self, key: str) -> np.ndarray:
        """Values of `component.port` when it was due: (n,) or, of a port of several, (n, size)."""
        columns = self._values[:: self._period(key.partition(".")[0]), self._system.columns(key)]
        return columns[:, 0] if columns.shape[1] == 1 else columns

    def time(self, topic: str) -> np.ndarray:
        """When the component was due (s), (n,); rounded to nanoseconds as in a recording."""
        period = self._period(topic)
        ticks = np.arange(0, len(self._values), period)
        return np.round(ticks * (self._system.tick * NANOSECONDS)) / NANOSECONDS

    def _period(self, component: str) -> int:
        return self._periods[component]
