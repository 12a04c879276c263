"""Recording of a session: the robot's messages as they arrived, and the twin's rows."""

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from twin.kernel.atomic_write import json_text
from twin.kernel.cosim.port import Port
from twin.kernel.recording.messages import Topic
from twin.kernel.recording.recorder import port_fields, versions
from twin.kernel.recording.sources.arrival import Arrival
from twin.kernel.recording.writer import ForeignTopic, Writer
from twin.studies.replay.model import RobotModel
from twin.studies.replay.parts import Happening, Rows
from twin.studies.replay.recording import NANOSECOND_TICK


class ShadowRecording:
    """Growing recording of a session with a robot; times count from the first sample.

    The robot's messages have their arrival times relative to the first sample's, so that delays are visible.

    Args:
        topics: ports of the twin's topics.
        others: topics of the robot.
        first: stamp and arrival of the first sample, ns.
    """

    def __init__(
        self,
        path: Path,
        topics: Mapping[str, tuple[Port, ...]],
        others: Sequence[ForeignTopic],
        model: RobotModel,
        source: str,
        first: tuple[int, int],
    ):
        _, self._arrived_0 = first
        self._others = {other.name for other in others}
        declared = [Topic(name, port_fields(ports), 1) for name, ports in topics.items()]
        metadata = {
            "experiment": {"name": model.name, "title": f"shadow of {source}", "values": json.dumps(model.values)},
            "versions": versions(),
            "shadow": {"source": source, "stamp_0_ns": str(first[0]), "arrived_0_ns": str(first[1])},
        }
        self._writer = Writer(path, declared, NANOSECOND_TICK, metadata, others=others)

    def write(self, arrivals: Iterable[Arrival], times: NDArray[np.int64], rows: Rows) -> None:
        """Write robot messages, and the twin's `rows` for samples at `times` (n,), ns, to the recording."""
        messages: dict[str, tuple[list[int], list[bytes]]] = {}
        for one in arrivals:
            if one.topic in self._others:
                when, data = messages.setdefault(one.topic, ([], []))
                when.append(max(0, one.arrived - self._arrived_0))
                data.append(one.data)
        for topic, (when, data) in messages.items():
            self._writer.write_messages(topic, when, data)
        for topic, own in rows.items():
            there = ~np.all(np.isnan(own), axis=1)
            self._writer.write_at(topic, times[there], own[there])
        self._writer.end_slice()

    def event(self, happening: Happening) -> None:
        self._writer.write_event(max(0, round(happening.t / NANOSECOND_TICK)), "WARNING", happening.text, "shadow")

    def flush(self) -> None:
        """Flush the recording to the operating system, so that the data survive a crash of this process."""
        self._writer.flush()

    def finish(self, facts: Mapping[str, object]) -> Path:
        """Finish the recording with the session's facts in its metadata, see `recorded_facts`; return its path."""
        self._writer.write_metadata("followed", {"facts": json_text(facts)})
        return self._writer.finish()

    def abandon(self) -> Path:
        return self._writer.abandon()
