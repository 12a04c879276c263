"""Signals of several rates on one time base."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twin.errors import InputRefused
from twin.recording.recording import Recording

NANOSECONDS = 10**9
LARGEST_RATE = 1e6
"""Hz; times are whole nanoseconds, and a faster sampling than a microsecond's is a slip of the pen."""
MOST_ROWS = 50_000_000
"""Nothing has been recorded for so long that more were needed; a wrong time in a file may ask for any number."""
MOST_NUMBERS = 200_000_000
"""In a table at a rate, unless as many have been recorded: 1.6 GB in memory."""
FEW_ROWS, MOST_REPEATED = 100_000, 1000
"""More rows than `FEW_ROWS` have to come from samples: with each of them repeated more than `MOST_REPEATED` times, a
time in the file is wrong or the rate is. Nobody reads such a table, and it fills the memory."""


@dataclass(frozen=True)
class Column:
    """One number per row.

    Attributes:
        name: `topic.field`, with `[i]` (from 0) for an element of a field of several.
        unit: SI, "1" for pure numbers.
        meaning: frame and sign.
        values: (n,) float64, int64 or bool.
    """

    name: str
    unit: str
    meaning: str
    values: np.ndarray


@dataclass(frozen=True)
class Table:
    """Columns that share their rows' times.

    Attributes:
        t: simulation time of the rows (n,), s.
        columns: in the order of the recording.
    """

    t: np.ndarray
    columns: tuple[Column, ...]


def table(recording: Recording, signals: Sequence[str], rate: float | None = None) -> Table:
    """`signals` on one time base, each value the newest one at or before the row's time.

    Nothing is interpolated and nothing filtered: every number is one that was recorded, which is also what a sampled
    component holds between its samples. Rows begin when every signal has a value.

    Args:
        signals: names `topic.field`, each with at least one message.
        rate: rows per second of simulated time (Hz); without it, the times of the selected topic with most messages.

    Raises:
        InputRefused: no positive rate, or one too fast for times of whole nanoseconds or for the samples there are.
        UnknownSeries: no such signal.
    """
    fields = recording.fields()
    times = {topic: message_times(recording, topic) for topic in topics_of(signals)}
    rows = row_times(list(times.values()), rate, numbers_of(recording, signals))
    columns: list[Column] = []
    for name in signals:
        topic = name.rpartition(".")[0]
        values = recording[name][np.searchsorted(times[topic], rows, side="right") - 1]
        parts = [(name, values)] if values.ndim == 1 else [(f"{name}[{i}]", v) for i, v in enumerate(values.T)]
        field = fields[name]
        columns += [Column(label, field.unit, field.meaning, np.ascontiguousarray(part)) for label, part in parts]
    return Table(rows / NANOSECONDS, tuple(columns))


def topics_of(signals: Sequence[str]) -> tuple[str, ...]:
    """Topics of `signals`, each once, in their order."""
    return tuple(dict.fromkeys(name.rpartition(".")[0] for name in signals))


def numbers_of(recording: Recording, signals: Sequence[str]) -> int:
    """How many `signals` are at a time, elements counted."""
    fields = recording.fields()
    return sum(fields[name].size for name in signals)


def message_times(recording: Recording, topic: str) -> np.ndarray:
    """Times of the messages of `topic`, ns, (n,) int64."""
    return recording.streams[topic].head["log_time"].astype(np.int64)


def row_times(times: Sequence[np.ndarray], rate: float | None, numbers: int = 1) -> np.ndarray:
    """Times of the rows, ns, (n,) int64.

    Args:
        times: of the messages of each topic, ns, ascending, not empty.
        rate: see `table`.
        numbers: in a row.

    Raises:
        InputRefused: see `table`.
    """
    first = max(t[0] for t in times)
    if rate is None:
        densest = max(times, key=len)
        return densest[densest >= first]
    if not (math.isfinite(rate) and 0.0 < rate <= LARGEST_RATE):
        raise InputRefused(f"--rate {rate:g}: expected rows per second, more than 0 and at most {LARGEST_RATE:g} Hz")
    last = max(t[-1] for t in times)
    # each from its own number, so that nothing accumulates
    count = int((last - first) * rate / NANOSECONDS + 1e-9) + 1
    if count > MOST_ROWS:
        raise InputRefused(f"--rate {rate:g}: makes {count} rows, more than {MOST_ROWS}; choose a lower one")
    samples = max(map(len, times))
    if count > max(FEW_ROWS, MOST_REPEATED * samples):
        raise InputRefused(
            f"--rate {rate:g}: makes {count} rows out of {samples} samples, over {(last - first) / NANOSECONDS:g} s; "
            "choose a lower one"
        )
    if count * numbers > max(MOST_NUMBERS, samples * numbers):
        raise InputRefused(
            f"--rate {rate:g}: makes {count} rows of {numbers} numbers, {8e-9 * count * numbers:.3g} GB; choose a "
            "lower one, or fewer signals with --signals"
        )
    return first + np.rint(np.arange(count) * (NANOSECONDS / rate)).astype(np.int64)
