"""Provenance of a digitised curve, parsed from the head of its file and checked."""

import datetime
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from pydantic import ValidationError

from twin.kernel.errors import InputRefused
from twin.kernel.files import parse_toml
from twin.kernel.recording.logs.column_map import TIME_NAMES, require_unit, split_unit
from twin.kernel.recording.logs.log import Log, LogError
from twin.kernel.settings import Settings
from twin.robot.experiment.mistakes import error_messages

Points = tuple[tuple[float, float], tuple[float, float]]


class Figure(Settings):
    number: str
    panel: str
    curve: str
    image: str


class Digitisation(Settings):
    by: str
    on: datetime.date
    tool: str


class FileHead(Settings):
    """Head of a digitised curve's file: points (pixel, value) of each column's axis, and uncertainties."""

    figure: Figure
    digitised: Digitisation
    calibration: dict[str, Points]
    uncertainty: dict[str, float]


@dataclass(frozen=True)
class Provenance:
    """Origin of a digitised curve, its signal in the log, and uncertainties of value (SI) and time (s)."""

    head: FileHead
    signal: str
    value: float
    time: float

    @property
    def text(self) -> str:
        figure, done = self.head.figure, self.head.digitised
        return f"Fig. {figure.number} {figure.panel}, {figure.curve}: digitised by {done.by} on {done.on}, {done.tool}"


def provenance(log: Log) -> Provenance | None:
    """Parse the origin of a digitised curve from its log; None if the log is not a digitised curve."""
    if "[figure]" not in log.comments:
        return None
    try:
        head = FileHead.model_validate(_by_column(parse_toml("\n".join(log.comments), str(log.path))))
    except InputRefused as problem:
        raise LogError(f"{problem}; its head is not TOML behind #") from None
    except ValidationError as error:
        raise LogError("\n".join(f"{log.path}: {text}" for text in error_messages(error, FileHead, "head"))) from None
    if len(log.series) != 1:
        raise LogError(f"{log.path}: {len(log.series)} curves, expected one in a file of a digitised figure")
    signal = next(iter(log.series))
    found = {}
    for column, width in head.uncertainty.items():
        name, spelled = split_unit(column)
        _check(log, column, width, head.calibration)
        found[name] = require_unit(spelled or "1", f"{log.path}: [uncertainty] {column}").in_si(width)
    time = next((found[name] for name in TIME_NAMES if name in found), None)
    if time is None or signal not in found:
        missing = "the time" if time is None else signal
        raise LogError(f"{log.path}: [uncertainty] lacks {missing}; it has {', '.join(head.uncertainty)}")
    return Provenance(head, signal, found[signal], time)


def _check(log: Log, column: str, width: float, calibration: dict[str, Points]) -> None:
    if column not in calibration:
        raise LogError(f"{log.path}: [calibration] {column} is missing; expected two points [pixel, value]")
    (first, low), (second, high) = calibration[column]
    if first == second or low == high:
        raise LogError(f"{log.path}: [calibration] {column}: two points of one pixel or value make no axis")
    half = 0.5 * abs((high - low) / (second - first))
    if not half <= width:
        raise LogError(f"{log.path}: [uncertainty] {column} = {width:g} is less than half a pixel, {half:.3g}")


def _by_column(content: dict[str, Any]) -> dict[str, Any]:
    """Return the head's entries by column name; TOML parses the dot in `controller.F_z_N` as a nested table."""
    tables = {key: content[key] for key in ("calibration", "uncertainty") if isinstance(content.get(key), dict)}
    return content | {key: dict(_columns("", table)) for key, table in tables.items()}


def _columns(prefix: str, table: dict[str, Any]) -> Iterator[tuple[str, Any]]:
    for key, value in table.items():
        if isinstance(value, dict):
            yield from _columns(f"{prefix}{key}.", value)
        else:
            points = isinstance(value, list) and all(isinstance(point, list) for point in value)
            # a strict model expects tuples
            yield f"{prefix}{key}", tuple(map(tuple, value)) if points else value
