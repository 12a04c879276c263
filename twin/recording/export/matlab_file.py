"""Signals as a MATLAB file (level 5): one struct per topic, with its own times."""

import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from twin.errors import InputRefused
from twin.recording.export.table import NANOSECONDS, message_times, row_times, topics_of
from twin.recording.recording import Recording
from twin.writing import write_bytes

HEADER_BYTES = 116
"""Of descriptive text at the front of the file; scipy would write the date into it."""
LONGEST_NAME = 63
"""Letters that MATLAB reads of a name."""


def write_matlab(path: Path, recording: Recording, signals: Sequence[str], rate: float | None = None) -> None:
    """Write `signals` to `path`: `plant.t` (n, 1) in s, `plant.p_B` (n, 3); `units.plant.p_B` is 'm'.

    Topic drive/1 becomes drive_1. Without a rate every topic keeps its own times; with one all have the rows of
    `table.table`.

    Args:
        path: of the file. recording: a run's. signals: names `topic.field`, each with at least one message.
        rate: rows per second of simulated time (Hz).

    Raises:
        InputRefused: a rate that `table` refuses, or a name that MATLAB would cut.
        NotWritten: it cannot be written.
    """
    from scipy.io import savemat

    times = {topic: message_times(recording, topic) for topic in topics_of(signals)}
    common = None if rate is None else row_times(list(times.values()), rate)
    structs: dict[str, dict[str, object]] = {}
    units: dict[str, dict[str, str]] = {}
    fields = recording.fields()
    for topic, own in times.items():
        rows = own if common is None else common
        structs[_variable(topic)] = {"t": rows / NANOSECONDS}
        units[_variable(topic)] = {"t": "s"}
        picked = np.searchsorted(own, rows, side="right") - 1
        for name in (name for name in signals if name.rpartition(".")[0] == topic):
            field = fields[name]
            structs[_variable(topic)][_variable(field.name)] = recording[name][picked]
            units[_variable(topic)][field.name] = field.unit
    file = io.BytesIO()
    savemat(file, {**structs, "units": units}, long_field_names=True, do_compression=True, oned_as="column")
    text = f"MATLAB 5.0 MAT-file, written by twin from {recording.path.name}".encode("ascii", "replace")
    write_bytes(path, text[:HEADER_BYTES].ljust(HEADER_BYTES) + file.getvalue()[HEADER_BYTES:])


def _variable(name: str) -> str:
    variable = name.replace("/", "_")
    if len(variable) > LONGEST_NAME:
        raise InputRefused(f"--mat: {name} is longer than the {LONGEST_NAME} letters MATLAB reads; leave it out")
    return variable
