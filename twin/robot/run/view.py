"""Read access to a run as rows (in memory, recorded, or a log), and its outcome."""

import re
from collections.abc import Mapping
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from twin.kernel.recording.messages import Field
from twin.kernel.recording.scan import NS_PER_S
from twin.robot.run.hold import HOLD_SIGNALS, SIGNAL_SUBSTITUTES, HoldRequest
from twin.robot.run.outcome import BLOCK_ROWS, DEVIATION_SIGNALS, RunOutcome, Tally


class RunView(Protocol):
    """Interface of a readable run: in memory, recorded, or a log through its adapter."""

    @property
    def metadata(self) -> Mapping[str, Mapping[str, str]]:
        """Metadata of the recording, by name and key; empty for a run in memory and a log."""

    def __getitem__(self, key: str) -> NDArray:
        """Return the values of the signal `topic.field`: (n,) or (n, size)."""

    def time(self, topic: str) -> NDArray:
        """Return the times of the messages of a topic (s), (n,)."""

    def fields(self) -> Mapping[str, Field]:
        """Return the description of every signal of the run by `topic.field`."""


class LogView:
    """Adapter that reads a log as a run: values by `topic.field`, (n,) or (n, size), and times (s) by topic, (n,)."""

    def __init__(self, series: Mapping[str, NDArray], times: Mapping[str, NDArray[np.float64]]):
        self.metadata: Mapping[str, Mapping[str, str]] = {}
        self._series, self._times = series, times

    def __getitem__(self, key: str) -> NDArray:
        return self._series[key]

    def time(self, topic: str) -> NDArray[np.float64]:
        return self._times[topic]

    def fields(self) -> Mapping[str, Field]:
        return {
            key: Field(key.rpartition(".")[2], values[:1].size, "double", "", "")
            for key, values in self._series.items()
        }


def held_samples(times: NDArray[np.float64], t: NDArray[np.float64]) -> NDArray[np.intp]:
    """Return the index of the newest sample at each of the times `t` (s), (n,); 0 before the first sample."""
    # half a nanosecond, because recorded times are rounded
    return (times.searchsorted(t + 5e-10, side="right") - 1).clip(min=0)


def sample_and_hold(run: RunView, key: str, t: NDArray[np.float64]) -> NDArray:
    """Return the newest values of the signal `topic.field` at each of the times `t` (s).

    The shape is (n,) or (n, size). Times before the first sample get its value.
    """
    values: NDArray = run[key][held_samples(run.time(key.rpartition(".")[0]), t)]
    return values


class BelievedRun:
    """View of a run with the controller's estimated pressing force in place of the true one."""

    def __init__(self, run: RunView):
        self._run, self.time, self.fields, self.metadata = run, run.time, run.fields, run.metadata

    def __getitem__(self, key: str) -> NDArray:
        if key != "plant.F_ee_B":
            return self._run[key]
        F_z = sample_and_hold(self._run, "controller.F_z", self.time("plant"))
        return np.column_stack([np.zeros((len(F_z), 2)), -F_z])


class _Rows:
    """The signals that the measures of a recorded run need, as rows at the times of the plant."""

    def __init__(self, run: RunView):
        t, known = run.time("plant"), run.fields()
        self.tick = round((t[-1] - t[0]) / max(1, len(t) - 1) * NS_PER_S) / NS_PER_S
        others = [name for names in SIGNAL_SUBSTITUTES.values() for name in names]
        drives = [
            f"{drive}.{name.rpartition('.')[2]}"
            for name in HOLD_SIGNALS
            if name.startswith("drive.")
            for drive in ("drive", "drive/1", "drive/2", "drive/3")
        ]
        self._columns: dict[str, slice] = {}
        held: dict[str, NDArray[np.intp]] = {}
        blocks: list[NDArray[np.float64]] = []
        width = 0
        for key in dict.fromkeys([*HOLD_SIGNALS, *DEVIATION_SIGNALS, *others, *drives]):
            if key not in known:
                continue
            topic = key.rpartition(".")[0]
            if topic not in held:
                held[topic] = held_samples(run.time(topic), t)
            values = np.asarray(run[key][held[topic]], dtype=float).reshape(len(t), -1)
            blocks.append(values)
            self._columns[re.sub("^drive/", "drive_", key)] = slice(width, width + values.shape[1])
            width += values.shape[1]
        self.rows = np.hstack(blocks)

    def has_output(self, end: str) -> bool:
        return end in self._columns

    def columns(self, end: str) -> slice:
        return self._columns[end]


def outcome_of(run: RunView, request: HoldRequest) -> RunOutcome | None:
    """Compute the summary numbers of a recorded run; None if it has no true force. The request's `every` is ignored."""
    if "plant.F_ee_B" not in run.fields() or not len(run.time("plant")):
        return None
    rows = _Rows(run)
    tally = Tally(rows, request._replace(every=1))
    for first in range(0, len(rows.rows), BLOCK_ROWS):
        tally.on_rows(first, rows.rows[first : first + BLOCK_ROWS], [])
    return tally.outcome
