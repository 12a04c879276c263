"""Topics of a log, and the series that a column map takes from them."""

from array import array
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from twin.errors import nearest
from twin.recording.logs.clocks import clock_note, restart
from twin.recording.logs.column_map import TIME, MappedColumn, split_unit
from twin.recording.logs.errors import LogRefused
from twin.recording.logs.log import Log, LogSeries
from twin.recording.logs.topic import LoggedTopic, NoField, Numbers, numbers_of
from twin.recording.logs.units import unit
from twin.units import Dimension

NANOSECONDS = 1e9
STAMP = "header.stamp"
"""Of a message of ROS 2 that has one."""
SAME_CLOCK = 1.0
"""Log times and stamps that are further apart (s) are not taken for those of one clock."""


def wanted(topic: str, columns: Mapping[str, MappedColumn]) -> bool:
    """Whether one of `columns` may be of `topic`."""
    return any(column.name.startswith(f"{topic}.") for column in columns.values())


def merged(found: Iterable[LoggedTopic]) -> dict[str, LoggedTopic]:
    """Topics by name; the messages of several publishers of a topic come in order of time."""
    topics: dict[str, LoggedTopic] = {}
    for topic in found:
        same = topics.setdefault(topic.channel.topic, topic)
        if same is not topic:
            times, data = np.concatenate([same.times, topic.times]), [*same.data, *topic.data]
            order = np.argsort(times, kind="stable")
            same.times = array("Q", times[order].tobytes())
            same.data = [data[k] for k in order] if data else []
    return topics


def log_of(
    path: Path, topics: Mapping[str, LoggedTopic], columns: Mapping[str, MappedColumn], notes: Sequence[str] = ()
) -> Log:
    """The series that `columns` take from `topics`.

    Args:
        path: of the log.
        columns: by signal; `/TOPIC.FIELD.FIELD[INDEX]`. `time` is a field of the mapped messages; without it the log
            time.
        notes: on what is missing of the log.

    Raises:
        LogRefused: no map, a topic or field that is not there, an encoding that is not read, values that are no finite
            numbers, times that do not ascend or start anew; every mistake, each in one sentence.
    """
    there = ", ".join(f"{name} ({topic.kind})" for name, topic in topics.items())
    if not any(topic.times for topic in topics.values()):
        raise LogRefused(
            f"{path}: no messages{f' on {there}' if there else ''}; {'; '.join(notes) or 'expected a log'}"
        )
    if not set(columns) - {TIME}:
        raise LogRefused(f"{path}: another tool's recording, with {there}; choose with --map NAME=/TOPIC.FIELD[UNIT]")
    mistakes: list[str] = []
    sources: dict[str, dict[str, str]] = {}
    for signal, column in columns.items():
        if signal != TIME:
            name = max((n for n in topics if column.name.startswith(f"{n}.")), key=len, default=None)
            if name is None:
                hint = nearest(column.name.partition(".")[0], topics, "it has {}")
                mistakes.append(f"{path}: no topic of '{column.name}' for {signal}; {hint}")
            else:
                sources.setdefault(name, {})[signal] = column.name.removeprefix(f"{name}.")
    readings, said = _readings(path, topics, columns.get(TIME), sources, mistakes)
    series: dict[str, LogSeries] = {}
    for name, reading in readings.items():
        for signal, field_path in sources[name].items():
            try:
                series[signal] = reading.series(field_path, columns[signal])
            except LogRefused as problem:
                mistakes.append(str(problem))
    if mistakes:
        raise LogRefused("\n".join(dict.fromkeys(mistakes)))
    return Log(path, {name: series[name] for name in columns if name != TIME}, (*notes, *said))


def _readings(
    path: Path,
    topics: Mapping[str, LoggedTopic],
    time: MappedColumn | None,
    sources: Mapping[str, Mapping[str, str]],
    mistakes: list[str],
) -> tuple[dict[str, "TopicReading"], list[str]]:
    """Every topic of `sources` read, and notes on their clocks; what is wrong is added to `mistakes`.

    A topic whose messages have no field of time beside topics that do goes by its log times, if that is one clock.
    """
    readings: dict[str, TopicReading] = {}
    timeless: dict[str, NoField] = {}
    notes: list[str] = []
    for name, signals in sources.items():
        try:
            readings[name] = TopicReading(path, name, topics[name], time, tuple(signals.values()))
            notes += readings[name].notes
        except NoField as problem:
            timeless[name] = problem
        except LogRefused as problem:
            mistakes.append(str(problem))
    furthest = max(readings.items(), key=lambda one: abs(one[1].delay), default=None)
    for name, lacking in timeless.items():
        assert time is not None
        if furthest is None:
            mistakes.append(str(lacking))
        elif abs(furthest[1].delay) > SAME_CLOCK:
            mistakes.append(
                f"{lacking}; its log times will not do, they are {abs(furthest[1].delay):.6g} s off the stamps of "
                f"{furthest[0]}: leave out --map time=... to take log times for all"
            )
        else:
            try:
                readings[name] = TopicReading(path, name, topics[name], None, tuple(sources[name].values()))
                notes.append(f"{name} has no {time.name}: its log times are used")
            except LogRefused as problem:
                mistakes.append(str(problem))
    return readings, notes


class TopicReading:
    """The messages of one topic as numbers over time.

    Attributes:
        notes: on its clocks.
        delay: by which its log times are later than its stamps, s; 0 without stamps.
    """

    def __init__(
        self, path: Path, name: str, topic: LoggedTopic, time: MappedColumn | None, field_paths: Sequence[str]
    ) -> None:
        """Decode every message of `topic` once.

        Args:
            time: the field that holds the times; None: log times.
            field_paths: what is wanted of the messages.

        Raises:
            LogRefused: the encoding is not read, a message cannot be decoded, or times that are none.
        """
        self._path, self._name = path, name
        logged = np.array(topic.times, dtype=np.uint64) / NANOSECONDS
        if len(logged) < 2:
            many = "s" * (len(logged) != 1)
            raise LogRefused(f"{path}: {name} has {len(logged)} message{many}, expected at least 2")
        stamp_path = time.name if time else STAMP
        found = numbers_of(path, name, topic, tuple(dict.fromkeys((*field_paths, stamp_path))))
        self._found = found
        stamps = found[stamp_path]
        self.notes: list[str] = []
        self._by_stamp = time is not None
        self._t = logged if time is None else self._stamped(time, stamps)
        self.delay = 0.0
        if isinstance(stamps, Numbers) and len(stamps.rows) == len(logged) and np.any(stamps.values):
            stamped = stamps.values if time is None else self._t
            self.delay = float(np.median(logged - stamped))
            note = clock_note(name, logged, stamped, by_stamp=time is not None)
            self.notes += [note] if note else []

    def series(self, field_path: str, column: MappedColumn) -> LogSeries:
        """What the messages say in a field, in SI and in order of time.

        Raises:
            LogRefused: no such field or unit, not a finite number, times that are the same or start anew.
        """
        where = f"{self._path}: {self._name}"
        numbers = self._found[field_path]
        if isinstance(numbers, LogRefused):
            raise numbers
        text = column.unit or numbers.unit or split_unit(field_path)[1] or "1"
        factor = unit(text, f"{self._path}: {column.name}")
        t = self._t[numbers.rows]
        if len(t) < 2:
            raise LogRefused(f"{where}.{field_path} is in {len(t)} message, expected at least 2")
        if again := restart(t):
            instead = "leave out --map time=... to take log times" if self._by_stamp else "choose --map time=FIELD"
            raise LogRefused(
                f"{where}: its {'stamps' if self._by_stamp else 'log times'} start anew at message "
                f"{numbers.rows[again] + 1} of {len(self._t)}: from {t[again - 1]:.6f} s back to {t[again]:.6f} s; cut "
                f"the log there, or {instead}"
            )
        # writers need not order messages by time
        order = np.argsort(t, kind="stable")
        t, values = t[order], column.sign * factor.in_si(numbers.values)[order]
        repeated = np.flatnonzero(np.diff(t) <= 0.0)
        if len(repeated):
            hint = "" if self._by_stamp else "; choose the messages' own stamp with --map time=FIELD"
            raise LogRefused(f"{where} has two messages at {t[repeated[0]] - t[0]:.9g} s after its first{hint}")
        return LogSeries(t, values, factor.si)

    def _stamped(self, time: MappedColumn, stamps: "Numbers | LogRefused") -> NDArray[np.float64]:
        if isinstance(stamps, LogRefused):
            raise stamps
        factor = unit(time.unit or split_unit(time.name)[1] or "s", f"{self._path}: {time.name}")
        if factor.dimension != Dimension(s=1):
            raise LogRefused(f"{self._path}: time '{time.name}' is in {time.unit}; expected s, ms, us, ns or min")
        if not np.any(stamps.values):
            raise LogRefused(
                f"{self._path}: {self._name}.{time.name} is 0 in all messages: whoever publishes them sets none; leave "
                "out --map time=... to take log times"
            )
        return factor.in_si(stamps.values)
