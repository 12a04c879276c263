"""Tables of signals on one time base, written as CSV, Apache Parquet or MATLAB files.

CSV as in RFC 4180, but lines end with a line feed; MATLAB level 5.
"""

import csv
import io
import json
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from twin.kernel.atomic_write import atomic_write, write_bytes
from twin.kernel.errors import InputRefused, escape_controls
from twin.kernel.recording.logs.csv_file import heading
from twin.kernel.recording.reader import Recording

NS_PER_S = 10**9
MAX_RATE = 1e6
"""Maximum rate (Hz). Times are whole nanoseconds, and sampling faster than once a microsecond is a typing error."""
MAX_ROWS = 50_000_000
"""Maximum number of rows. No recording needs more, but a wrong time in a file may demand any number."""
MAX_NUMBERS = 200_000_000
"""Maximum number of values in a table at a given rate, unless more were recorded: 1.6 GB in memory."""
UNCHECKED_ROWS, MAX_SAMPLE_REPEATS = 100_000, 1000
"""A table of more than `UNCHECKED_ROWS` rows is refused if it repeats each sample more than `MAX_SAMPLE_REPEATS` times:
a time in the file or the rate is wrong, and the table would fill the memory."""
BLOCK_ROWS = 10_000
HEADER_BYTES = 116
"""Length of the descriptive text at the front of the file (bytes); scipy would write the date into it."""
MAX_NAME_LENGTH = 63
"""Maximum length of a MATLAB name (characters)."""


@dataclass(frozen=True)
class SignalColumn:
    """A column of a table of signals: SI unit ("1" for pure numbers), frame and sign, (n,) float64, int64 or bool.

    The name is `topic.field`, with `[i]` (from 0) for an element of a vector field.
    """

    name: str
    unit: str
    meaning: str
    values: np.ndarray


@dataclass(frozen=True)
class SignalTable:
    """Recorded signals at the times `t` (n,), s; columns in the order of the recording."""

    t: np.ndarray
    columns: tuple[SignalColumn, ...]


def signal_table(recording: Recording, signals: Sequence[str], rate: float | None = None) -> SignalTable:
    """Resample recorded `signals` onto one time base; each value is the newest at or before the row's time.

    Nothing is interpolated or filtered: every number was recorded, and a sampled component also keeps its value between
    samples. Rows begin when every signal `topic.field` has a value; each needs a message. `rate` is in rows per second
    of simulated time (Hz); None for the times of the selected topic with most messages.
    """
    fields = recording.fields()
    times, rows = time_base(recording, signals, rate)
    columns: list[SignalColumn] = []
    for name in signals:
        topic = name.rpartition(".")[0]
        values = recording[name][np.searchsorted(times[topic], rows, side="right") - 1]
        parts = [(name, values)] if values.ndim == 1 else [(f"{name}[{i}]", v) for i, v in enumerate(values.T)]
        field = fields[name]
        columns += [SignalColumn(label, field.unit, field.meaning, np.ascontiguousarray(part)) for label, part in parts]
    return SignalTable(rows / NS_PER_S, tuple(columns))


def time_base(
    recording: Recording, signals: Sequence[str], rate: float | None
) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Return the message times of each topic of `signals`, and the times of a table's rows (ns); see `signal_table`."""
    topics = dict.fromkeys(name.rpartition(".")[0] for name in signals)
    times = {topic: recording.streams[topic].head["log_time"].astype(np.int64) for topic in topics}
    fields = recording.fields()
    return times, row_times(list(times.values()), rate, sum(fields[name].size for name in signals))


def row_times(times: Sequence[np.ndarray], rate: float | None, numbers: int = 1) -> np.ndarray:
    """Compute the times of a signal table's rows, ns, (n,) int64, from ascending message times (ns) of each topic.

    No topic is empty. `rate` is in rows per second (Hz), see `signal_table`. `numbers` are the values in a row.
    """
    first = max(t[0] for t in times)
    if rate is None:
        densest = max(times, key=len)
        return densest[densest >= first]
    if not (math.isfinite(rate) and 0.0 < rate <= MAX_RATE):
        raise InputRefused(f"rate {rate:g} Hz: expected more than 0 and at most {MAX_RATE:g} Hz")
    last = max(t[-1] for t in times)
    # each time is computed from its own index, so that errors do not accumulate
    count = int((last - first) * rate / NS_PER_S + 1e-9) + 1
    if count > MAX_ROWS:
        raise InputRefused(f"rate {rate:g} Hz: makes {count} rows, more than {MAX_ROWS}; choose a lower one")
    samples = max(map(len, times))
    if count > max(UNCHECKED_ROWS, MAX_SAMPLE_REPEATS * samples):
        raise InputRefused(
            f"rate {rate:g} Hz: makes {count} rows out of {samples} samples, over {(last - first) / NS_PER_S:g} s; "
            "choose a lower one"
        )
    if count * numbers > max(MAX_NUMBERS, samples * numbers):
        raise InputRefused(
            f"rate {rate:g} Hz: makes {count} rows of {numbers} numbers, {8e-9 * count * numbers:.3g} GB; choose a "
            "lower one, or fewer signals"
        )
    return first + np.rint(np.arange(count) * (NS_PER_S / rate)).astype(np.int64)


def write_csv(path: Path, table: SignalTable) -> None:
    """Write a table of signals to `path` as CSV; names carry the unit, numbers restore the same float64.

    A name with a comma or a quote is quoted, a name that spreadsheets would take for a formula begins with an
    apostrophe. Booleans are 0 and 1, NaN is `nan`.
    """
    heads = ["t_s", *(heading(column.name, column.unit) for column in table.columns)]
    if twice := [head for head, count in Counter(heads).items() if count > 1]:
        raise InputRefused(f"{path}: two columns would be named {escape_controls(twice[0])}; leave one of them out")
    columns = [table.t, *(column.values for column in table.columns)]
    with atomic_write(path) as beside, beside.open("w", encoding="utf-8", newline="\n") as file:
        csv.writer(file, lineterminator="\n").writerow(heads)
        # in blocks: a number takes eight times the memory as text
        for start in range(0, len(table.t), BLOCK_ROWS):
            texts = [_texts(values[start : start + BLOCK_ROWS]) for values in columns]
            file.writelines(",".join(row) + "\n" for row in zip(*texts, strict=True))


def write_parquet(path: Path, table: SignalTable, metadata: Mapping[str, Mapping[str, str]]) -> None:
    """Write a table of signals to `path` as Parquet: column `t` in s, then one per number with `unit` and `meaning`.

    Each name of the recording's metadata (name -> key -> text) becomes one JSON text in the file's.
    """
    try:
        import pyarrow as pa
        import pyarrow.parquet as pq
    except ImportError:
        raise InputRefused("Parquet needs pyarrow; install it with: pip install 'pyarrow>=17'") from None
    fields = [pa.field("t", pa.float64(), False, {"unit": "s", "meaning": "simulation time"})]
    arrays = [pa.array(table.t)]
    for column in table.columns:
        array = pa.array(column.values)
        fields.append(pa.field(column.name, array.type, False, {"unit": column.unit, "meaning": column.meaning}))
        arrays.append(array)
    origin = {name: json.dumps(dict(entries)) for name, entries in metadata.items()}
    with atomic_write(path) as beside:
        pq.write_table(pa.Table.from_arrays(arrays, schema=pa.schema(fields, origin)), beside, compression="zstd")


def write_matlab(path: Path, recording: Recording, signals: Sequence[str], rate: float | None = None) -> int:
    """Write `signals` to `path` as a MATLAB file; return the number of rows of the common time base.

    `arm.t` is (n, 1) in s, `arm.tip` (n, 3), `units.arm.tip` is 'm'; topic drive/1 becomes drive_1. Without a rate
    every topic keeps its own times; with one (Hz) all have the rows of `signal_table`. Every signal needs a message.
    """
    from scipy.io import savemat

    times, common = time_base(recording, signals, rate)
    structs: dict[str, dict[str, object]] = {}
    units: dict[str, dict[str, str]] = {}
    fields = recording.fields()
    for topic, own in times.items():
        rows = own if rate is None else common
        structs[_variable(topic)] = {"t": rows / NS_PER_S}
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
    return len(common)


def _texts(values: np.ndarray) -> list[str]:
    return [repr(value) for value in (values.astype(int) if values.dtype == bool else values).tolist()]


def _variable(name: str) -> str:
    variable = name.replace("/", "_")
    if len(variable) > MAX_NAME_LENGTH:
        raise InputRefused(f"{name} is longer than the {MAX_NAME_LENGTH} letters MATLAB reads; leave it out")
    return variable
