"""Signals over time in CSV, as FMUs carry them for inputs and results: the first column is the time in s."""

import io
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from twin.errors import InputRefused
from twin.recording.logs.csv_file import CsvTable, table_of
from twin.studies.metrics.response import Curve

TRUTH = re.compile(rb"(?<=[,;\t])(?:true|false)(?=[,;\t\r\n]|$)", re.IGNORECASE)
"""Fields of the time series of Boolean variables, as some tools write them."""


@dataclass(frozen=True)
class Series:
    """Signals over time.

    Attributes:
        where: the file, for sentences.
        t: s, never descending, (rows,); the same time twice is a jump.
        signals: by column, (rows,).
        others: columns that are not of single numbers.
    """

    where: str
    t: Curve
    signals: dict[str, Curve]
    others: tuple[str, ...] = ()

    def held(self, name: str, t: Curve) -> Curve:
        """A signal at the times `t`: the value of the last row until then, of the first one before that."""
        return self.signals[name][self._last(t)]

    def linear(self, name: str, t: Curve) -> Curve:
        """A signal at the times `t`, on lines between rows; at a jump what comes after it."""
        values, last = self.signals[name], self._last(t)
        following = np.minimum(last + 1, len(self.t) - 1)
        span = self.t[following] - self.t[last]
        share = np.clip(np.divide(t - self.t[last], span, out=np.zeros(len(t)), where=span > 0.0), 0.0, 1.0)
        return np.asarray(values[last] + share * (values[following] - values[last]))

    def _last(self, t: Curve) -> np.ndarray:
        # a tick's time is a product and may lie below the row's by its rounding
        near = t + 1e-9 * max(1.0, float(np.abs(self.t).max()))
        return np.maximum(np.searchsorted(self.t, near, side="right") - 1, 0)


def series_of(content: bytes, where: str) -> Series:
    """The signals in the CSV `content`.

    Raises:
        InputRefused: no table of numbers, a time that is missing, no number or descends, a field that is no number
            among numbers.
    """
    numbers = TRUTH.sub(lambda field: b"1" if field[0].lower() == b"true" else b"0", content)
    table = table_of(Path(where), io.BytesIO(numbers))
    time = table.head[0]
    if wrong := table.mistakes(time):
        raise InputRefused(f"{where} line {wrong.line}: time '{wrong.text}'; expected seconds in the first column")
    t = table.column(time)
    if len(back := np.flatnonzero(np.diff(t) < 0.0)):
        k = back[0] + 1
        raise InputRefused(
            f"{where} line {table.lines[k]}: time falls from {t[k - 1]:g} to {t[k]:g} s; expected rising"
        )
    return Series(where, t, *_signals(table, where))


def _signals(table: CsvTable, where: str) -> tuple[dict[str, Curve], tuple[str, ...]]:
    signals, others = {}, []
    for name in table.head[1:]:
        wrong = table.mistakes(name)
        if wrong is None:
            signals[name] = table.column(name)
        elif wrong.count == len(table.values) and wrong.texts:
            others.append(name)
        else:
            raise InputRefused(f"{where} line {wrong.line}: {name} is '{wrong.text}'; expected a finite number")
    return signals, tuple(others)
