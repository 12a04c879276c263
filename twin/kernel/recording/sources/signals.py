"""Readings from messages: the numbers selected by a column map, by the decoder, units and signs of logs."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from itertools import product
from operator import attrgetter
from typing import Any, NamedTuple

from mcap.records import Channel, Schema

from twin.kernel.recording.logs import decoding
from twin.kernel.recording.logs.column_map import refuse_unit
from twin.kernel.recording.logs.log import LogError, MappedColumn
from twin.kernel.recording.logs.topics import STAMP_FIELD, factor_of, message_decoder, time_factor
from twin.kernel.recording.writer import ForeignTopic

NS_PER_S = 10**9
NAMES_FIELD = "name"
"""Field with the names of a message's elements."""
MAX_UNSTAMPED = 3
"""Number of messages with stamp 0 after which a topic counts as unstamped."""


class WantedSignal(NamedTuple):
    """Conversion of a robot signal, which must have the SI `unit`, to a column of rows: (value + offset) * gain."""

    column: int
    unit: str
    offset: float = 0.0
    gain: float = 1.0


class Reading(NamedTuple):
    """Numbers read from one message, for `columns` of a row, with its stamp by the robot's clock (ns)."""

    stamp: int
    columns: tuple[int, ...]
    values: tuple[float, ...]


class _Field(NamedTuple):
    """Path of a signal in a message, and its conversion to a row's value."""

    signal: str
    parts: tuple[str | int, ...]
    column: int
    offset: float
    gain: float


class _Places(NamedTuple):
    """Positions of all mapped values in messages with arrays of numbers, valid while the names of the elements stay.

    Attributes:
        names: names of the elements.
        elements: for each signal a getter of the array, the index, offset and gain as of `WantedSignal`.
        columns: column of each signal.
        stamp: getters and factors of the numbers whose sum is the stamp (ns).
    """

    names: Sequence[str]
    elements: tuple[tuple[Callable[[Any], Any], int, float, float], ...]
    columns: tuple[int, ...]
    stamp: tuple[tuple[Callable[[Any], Any], float], ...]


class MessageReader:
    """Reader that extracts the mapped signals from the messages of one topic.

    `stamped`: whether the messages have a stamp, known from the first one on; otherwise arrival times are used.
    """

    def __init__(
        self,
        where: str,
        topic: ForeignTopic,
        columns: Mapping[str, MappedColumn],
        wanted: Mapping[str, WantedSignal],
        time: MappedColumn | None,
    ):
        """Prepare the reader and its decoder for one topic; `where` begins the error messages.

        `columns` are of this topic, by signal, `wanted` the use of at least these signals. `time` is the field with the
        time; None for `header.stamp`, if any. LogError: an unsupported encoding or definition.
        """
        self._where = f"{where}: {topic.name}"
        self._columns, self._wanted, self._time = columns, wanted, time
        self._prefix = len(topic.name) + 1
        schema = Schema(0, topic.definition, topic.schema_encoding, topic.type_name)
        self._decode = message_decoder(Channel(0, topic.name, topic.encoding, {}, 0), schema, self._where)
        self._absent: dict[str, str] = {}
        self._found: set[str] = set()
        self.stamped = False
        self._undecided = MAX_UNSTAMPED
        self._fields: list[_Field] = []
        self._stamp: tuple[tuple[tuple[str | int, ...], float], ...] = ()
        self._places: _Places | None = None

    def read_message(self, data: bytes, arrived: int) -> Reading:
        """Read the mapped signals of a message that `arrived` at a time (ns), without joints that it does not name.

        LogError: a missing field, another unit, or invalid bytes.
        """
        try:
            message = self._decode(data)
        except ValueError as problem:
            raise LogError(f"{self._where}: {problem}") from None
        if (known := self._places) and known.names == getattr(message, NAMES_FIELD, None):
            # shorter arrays, or a stamp that is not a number
            with suppress(IndexError, ValueError, OverflowError):
                return Reading(
                    sum(round(float(get(message)) * scale) for get, scale in known.stamp) if self.stamped else arrived,
                    known.columns,
                    tuple([(float(get(message)[k]) + offset) * gain for get, k, offset, gain in known.elements]),
                )
        if not self._fields:
            self._resolve_fields(message)
        columns, values = [], []
        for one in self._fields:
            try:
                value = decoding.field_value(message, one.parts)
            except decoding.UnknownElement as problem:
                self._absent.setdefault(one.signal, str(problem))
                continue
            except (LookupError, ValueError) as problem:
                # an array shorter than in the first message
                raise LogError(f"{self._where}: {self._columns[one.signal].name}: {problem.args[0]}") from None
            self._found.add(one.signal)
            columns.append(one.column)
            values.append((value + one.offset) * one.gain)
        try:
            stamp = sum(round(decoding.field_value(message, parts) * scale) for parts, scale in self._stamp)
        except (LookupError, ValueError, OverflowError):
            # a message without a time is skipped
            return Reading(arrived, (), ())
        if not self.stamped and self._undecided:
            # unset stamps stay 0; a clock may only begin at 0
            self.stamped = bool(self._stamp) and (stamp > 0 or stamp == arrived)
            self._undecided = self._undecided - 1 if self._stamp and not self.stamped else 0
            if self._undecided:
                return Reading(arrived, (), ())
        if not self._undecided and len(columns) == len(self._fields):
            self._places = self._places_in(message)
        return Reading(stamp if self.stamped else arrived, tuple(columns), tuple(values))

    def _places_in(self, message: Any) -> _Places | None:
        """Find the positions of the mapped values, as searching names is slow; None if they are not as in `_Places`."""
        names: Any = getattr(message, NAMES_FIELD, None)
        elements, paths = [], [parts for parts, _ in self._stamp]
        for one in self._fields:
            array, *rest = one.parts
            if not isinstance(names, list) or len(rest) != 1 or rest[0] not in names:
                return None
            paths.append((array,))
            elements.append((attrgetter(str(array)), names.index(rest[0]), one.offset, one.gain))
        try:
            getters = [attrgetter(".".join(map(str, path))) for path in paths]
            for get in getters:
                get(message)
        except AttributeError:
            return None
        stamp = tuple((get, scale) for get, (_, scale) in zip(getters, self._stamp, strict=False))
        return _Places(list(names), tuple(elements), tuple(one.column for one in self._fields), stamp)

    def missing_signals(self) -> list[str]:
        """List error messages for the mapped signals that no message has had so far."""
        return [
            f"{self._where} has no '{self._columns[signal].name[self._prefix :]}' for {signal}; {there}"
            for signal, there in self._absent.items()
            if signal not in self._found
        ]

    def _resolve_fields(self, message: Any) -> None:
        """Determine the units of the mapped fields, and the place of the stamp, from the first message."""
        mistakes = []
        for signal, column in self._columns.items():
            path = column.name[self._prefix :]
            parts, wanted = decoding.path_parts(path), self._wanted[signal]
            try:
                decoding.field_value(message, parts)
            except decoding.UnknownElement:
                pass
            except (LookupError, ValueError) as problem:
                mistakes.append(f"{self._where} has no number '{path}' for {signal}; {problem.args[0]}")
                continue
            factor = factor_of(column, path, decoding.unit_of(message, parts), self._where)
            refuse_unit(f"{self._where}.{path} for", signal, factor.si, wanted.unit, column.name)
            scale = float(factor.in_si(1.0)) * column.sign
            # (v * scale + offset) * gain
            self._fields.append(_Field(signal, parts, wanted.column, wanted.offset / scale, wanted.gain * scale))
        if mistakes:
            raise LogError("\n".join(mistakes))
        self._stamp = self._stamp_parts(message)

    def _stamp_parts(self, message: Any) -> tuple[tuple[tuple[str | int, ...], float], ...]:
        """Find the paths and factors of the numbers whose sum is a message's stamp (ns); empty without a stamp."""
        column = self._time or MappedColumn(STAMP_FIELD)
        parts = decoding.path_parts(column.name)
        for seconds, nanoseconds in product(decoding.SECOND_FIELDS, decoding.NANOSECOND_FIELDS):
            try:
                both = ((*parts, seconds), 1e9), ((*parts, nanoseconds), 1.0)
                for inner, _ in both:
                    decoding.field_value(message, inner)
                return both
            except (LookupError, ValueError):
                continue
        if self._time is None:
            return ()
        try:
            decoding.field_value(message, parts)
        except (LookupError, ValueError) as problem:
            raise LogError(f"{self._where} has no time '{column.name}'; {problem.args[0]}") from None
        return ((parts, float(time_factor(column, self._where).in_si(1.0)) * NS_PER_S),)
