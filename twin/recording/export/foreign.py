"""A log of somebody else's as a recording, so that it can be exported like one."""

import re

import numpy as np

from twin.recording.layout import FIELD_NAME, TOPIC_NAME, Field
from twin.recording.logs.log import Log, LogRefused, LogSeries
from twin.recording.messages import message_layout, message_records
from twin.recording.recording import Recording, Stream
from twin.recording.series import NANOSECONDS


def recording_of(log: Log) -> Recording:
    """`log` as a recording: `plant.p_B[0]`, `[1]`, ... are the field `p_B` of the topic `plant`.

    Raises:
        LogRefused: a signal whose name is no `TOPIC.FIELD`, signals of one topic with other times, times before 0.
    """
    topics: dict[str, list[tuple[str, LogSeries]]] = {}
    for name in dict.fromkeys(re.sub(r"\[\d+\]$", "", name) for name in log.series):
        topic, _, own = name.rpartition(".")
        if not TOPIC_NAME.fullmatch(topic) or not FIELD_NAME.fullmatch(own):
            raise LogRefused(f"{log.path}: signal '{name}' is no TOPIC.FIELD; name it like lab.{own or 'F'} with --map")
        one = log.vector(name) if name not in log.series else log[name]
        topics.setdefault(topic, []).append((own, one))
    return Recording(
        log.path, {topic: _stream(log, topic, own) for topic, own in topics.items()}, [], {}, True, "; ".join(log.notes)
    )


def _stream(log: Log, topic: str, series: list[tuple[str, LogSeries]]) -> Stream:
    t = series[0][1].t
    for name, one in series:
        if not np.array_equal(one.t, t):
            raise LogRefused(
                f"{log.path}: {topic}.{series[0][0]} and {topic}.{name} have other times; name one of them for another "
                f"topic, such as {topic}2.{name}"
            )
    if t[0] < 0.0:
        raise LogRefused(f"{log.path}: {topic} begins at {t[0]:g} s; expected times from 0 on")
    columns = [one.values.reshape(len(t), -1) for _, one in series]
    fields = tuple(
        Field(name, values.shape[1], "double", one.unit, f"as {log.path.name} has it")
        for (name, one), values in zip(series, columns, strict=True)
    )
    layout = message_layout(1, fields)
    times = np.rint(t * NANOSECONDS).astype(np.int64)
    return Stream(fields, layout, message_records(layout, fields, times, 0, np.concatenate(columns, axis=1)))
