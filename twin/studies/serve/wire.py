"""DDS side of a served robot: publishes its samples as ROS 2 topics and receives the commands of a controller.

It runs in a process of its own and talks to the simulation by a mailbox. In real time two threads share it: one sleeps
until a sample is there and publishes it, the other sleeps until a command arrives. In lockstep see `lockstep`.
"""

import math
import time
from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.kernel.cosim.port import port_slices
from twin.kernel.errors import InputRefused
from twin.kernel.process.mailbox import MailboxEntry
from twin.kernel.process.reporter import PipeReporter
from twin.kernel.recording.sources.dds import RawMessage, TopicDiscovery, domain_id, raw_topic
from twin.robot.remote import SAMPLE_PORTS
from twin.studies.result import count_text
from twin.studies.serve import messages
from twin.studies.serve.messages import MOTOR_COUNT, MessageTemplate, MotorCommand

PUBLISHED_TOPICS = JOINT_STATES_TOPIC, WRENCH_TOPIC, APPLIED_TOPIC, CLOCK_TOPIC = (
    "/joint_states", "/scale/wrench", "/commands_applied", "/clock",
)  # fmt: skip
COMMAND_TOPICS = {
    "joint": ("/robot_joint_command", messages.JOINT_STATE),
    "array": ("/velocity_controller/commands", messages.SPEED_ARRAY),
}
"""Form of commands -> default topic and type."""
QUEUE_DEPTH = 100
"""Number of messages that writers, and readers of commands, keep."""
HANDLE_MASK = 2**64 - 1
"""Mask that makes a DDS handle an unsigned number."""
MAX_BLOCKING_TIME = 0.1
"""Maximum time (s) that a reliable writer waits for a slow reader."""
SILENCE_TIMEOUT = 1.0
"""Minimum time (s) without a command of the obeyed publisher after which another one that sends is obeyed."""
WAIT_TIMEOUT = 0.05
"""Maximum time (s) of a wait, after which the end of the run is checked."""
REPORT_PERIOD = 1.0
"""Time (s) between two reports of a wait for a controller."""
FOREIGN_TEXT = "a second publisher; its command is not obeyed"
MAX_EVENTS = 10
"""Maximum number of recorded events per reason; later ones are only counted."""

_PLACES = port_slices(SAMPLE_PORTS)
"""Slices of a sample's values by port."""
_COUNTS = slice(_PLACES["count_m"].start, _PLACES["count_l"].stop)


class WireEvents:
    """Events of the wire as notes to `reporter`, a limited number of each reason, and their counts by reason."""

    def __init__(self, reporter: PipeReporter):
        self._reporter, self.counts = reporter, Counter[str]()

    def add(self, reason: str, text: str, tick: int = -1) -> None:
        """Count an event, and report it unless many of the same reason have been reported."""
        self.counts[reason] += 1
        if (count := self.counts[reason]) <= MAX_EVENTS:
            more = "; more of this kind are only counted" if count == MAX_EVENTS else ""
            self._reporter.note(event=text + more, tick=tick)


class Publishers:
    """Choice of the obeyed publisher: the first that matched, until it leaves or is silent while another one sends.

    DDS takes 10 s and more to notice a process that was killed; its successor must not wait for that.

    Args:
        silence: time (s) without a command after which a publisher that has been obeyed is replaced.

    Attributes:
        matched: DDS handles of the present publishers; the first is obeyed, the others are in order of matching.
        seen: number of publishers so far.
    """

    def __init__(self, events: WireEvents, silence: float):
        self._events, self._silence = events, silence
        self.matched: list[int] = []
        self.seen = 0
        self._heard, self._heard_publisher = 0.0, -1

    def update(self, present: Sequence[int]) -> None:
        """Replace the present publishers; known ones keep their order."""
        new = [one for one in present if one not in self.matched]
        if not self.matched:
            self._heard = time.monotonic()
        self.matched = [one for one in self.matched if one in present] + new
        self.seen += len(new)

    def is_obeyed(self, publisher: int) -> bool:
        """Whether a publisher that has just sent a command is the obeyed one."""
        now = time.monotonic()
        if publisher not in self.matched:
            # within a process a message may come before its publisher is listed
            self.update([*self.matched, publisher])
        limit = self._silence if self.matched[0] == self._heard_publisher else SILENCE_TIMEOUT
        if publisher in self.matched[1:] and now - self._heard > limit:
            silence = f"the publisher of commands was silent for {limit:g} s"
            self._events.add("publisher replaced", f"{silence}; another one is obeyed from now on")
            self.matched.remove(publisher)
            self.matched.insert(0, publisher)
        obeyed = self.matched[:1] == [publisher]
        if obeyed:
            self._heard, self._heard_publisher = now, publisher
        return obeyed


class Wire:
    """DDS participant of the served robot: writers of its topics and a reader of commands.

    Args:
        settings: see `exchange`.

    Raises:
        InputRefused: the command topic or the network is unusable.

    Attributes:
        publishers: publishers of commands.
        unwritten: number of messages that were not written since a reader was too slow.
    """

    def __init__(self, settings: dict[str, Any], events: WireEvents):
        from cyclonedds import core
        from cyclonedds.core import Policy, Qos
        from cyclonedds.domain import DomainParticipant
        from cyclonedds.pub import DataWriter
        from cyclonedds.sub import DataReader
        from cyclonedds.util import duration

        names, self._lockstep = list(settings["names"]), settings["lockstep"]
        self._turns = 2.0 * np.pi / np.repeat([settings["counts_m"], settings["counts_l"]], MOTOR_COUNT)
        self._tick = settings["tick_s"]
        self._motors = names[:MOTOR_COUNT]
        self._effort = np.full(len(names), np.nan)
        self._joint_template = MessageTemplate(
            lambda stamp, *arrays: messages.joint_state(stamp, names, *arrays),
            len(names), len(names), len(names) if settings["has_effort"] else 0,
        )  # fmt: skip
        self._applied_template = MessageTemplate(
            lambda stamp, speeds: messages.joint_state(stamp, self._motors, velocity=speeds), MOTOR_COUNT
        )
        self._wrench_template = MessageTemplate(lambda stamp, force: messages.wrench(stamp, -force[0]), 1)
        topic, self.command_type = COMMAND_TOPICS[settings["commands"]]
        self.command_topic = settings["command_topic"] or topic
        if self.command_topic in PUBLISHED_TOPICS:
            raise InputRefused(f"--command-topic {self.command_topic}: twin serve publishes it; expected another topic")
        domain = domain_id() if settings["domain"] is None else settings["domain"]
        try:
            self._participant = DomainParticipant(domain)
        except core.DDSException:
            hint = "check CYCLONEDDS_URI and the network interfaces"
            raise InputRefused(f"DDS cannot begin on domain {domain}; {hint}") from None
        self._discovery = TopicDiscovery(self._participant)
        reliable = Policy.Reliability.Reliable(duration(seconds=MAX_BLOCKING_TIME))
        volatile, queue = Policy.Durability.Volatile, Policy.History.KeepLast(QUEUE_DEPTH)

        def writer(name: str, kind: str, history: Any = queue) -> Any:
            topic = raw_topic(self._participant, name, kind)
            return DataWriter(self._participant, topic, Qos(reliable, volatile, history))

        self._joint_states = writer(JOINT_STATES_TOPIC, messages.JOINT_STATE)
        self._applied = writer(APPLIED_TOPIC, messages.JOINT_STATE)
        self._wrench = writer(WRENCH_TOPIC, messages.WRENCH) if settings["has_scale"] else None
        self._clock = writer(CLOCK_TOPIC, messages.CLOCK, Policy.History.KeepLast(1)) if self._lockstep else None
        wanted = Qos(reliable if self._lockstep else Policy.Reliability.BestEffort, volatile, queue)
        commands = raw_topic(self._participant, self.command_topic, self.command_type)
        self._reader: Any = DataReader(self._participant, commands, qos=wanted)
        self._waiting = core.WaitSet(self._participant)
        unread = core.SampleState.NotRead | core.ViewState.Any | core.InstanceState.Any
        self._condition = core.ReadCondition(self._reader, unread)
        self._waiting.attach(self._condition)
        # in real time a command is valid until the watchdog's time has passed; lockstep has no watchdog
        valid = 0.0 if self._lockstep else settings["watchdog"] or math.inf
        self.publishers = Publishers(events, max(SILENCE_TIMEOUT, valid))
        self.unwritten = 0
        self._last: tuple[int, NDArray[np.float64]] | None = None

    def write_sample(self, stamp: int, entry: MailboxEntry) -> None:
        """Publish wrench, clock and joint states of a sample with the stamp `stamp` (ns)."""
        values = entry.values
        position = values[_COUNTS] * self._turns
        before, last = self._last or (entry.tick, position)
        ticks = entry.tick - before
        velocity = (position - last) / (self._tick * ticks) if ticks else np.zeros(len(position))
        self._last = entry.tick, position
        self._effort[:MOTOR_COUNT] = values[_PLACES["tau_motor"]]
        self._sample = (
            self._wrench_template.encode(stamp, -values[_PLACES["F_z"]]),
            messages.clock(stamp) if self._lockstep else b"",
            self._joint_template.encode(stamp, position, velocity, self._effort),
        )
        self.repeat_sample()

    def repeat_sample(self) -> None:
        """Publish the messages of the last sample again."""
        for writer, data in zip((self._wrench, self._clock, self._joint_states), self._sample, strict=True):
            if writer is not None:
                self._write(writer, data)

    def write_applied(self, stamp: int, speeds: NDArray[np.float64]) -> None:
        """Publish the motor speeds (rad/s) that are in effect from `stamp` (ns) on."""
        self._write(self._applied, self._applied_template.encode(stamp, speeds))

    def receive(self, wait: float) -> list[MotorCommand]:
        """Return the commands received since the last call; wait up to `wait` (s) for the first one."""
        if wait > 0.0:
            self._waiting.wait(round(wait * 1e9))
        taken, found = self._reader.take(QUEUE_DEPTH), []
        if wait > 0.0 and not taken:
            # publishers are listed by their handles; only a regular update shows which matched first
            self._update_publishers()
        for one in taken:
            # without data a writer has left
            if isinstance(one, RawMessage):
                publisher = one.sample_info.publication_handle
                if self.publishers.matched[:1] != [publisher]:
                    self._update_publishers()
                command = messages.read_command(one.data, self.command_type, self._motors)
                found.append(command._replace(obeyed=self.publishers.is_obeyed(publisher)))
        return found

    @property
    def has_controller(self) -> bool:
        """Whether a reader of joint states and a writer of commands are connected."""
        self._update_publishers()
        return bool(self.publishers.matched and self._joint_states.get_matched_subscriptions())

    def waiting_text(self) -> str:
        """Describe the missing controller: readers of joint states, writers of commands, and the topics that exist."""
        readers = self._joint_states.get_matched_subscriptions()
        ends = [self._joint_states.get_matched_subscription_data(one) for one in readers]
        writers = [self._reader.get_matched_publication_data(one) for one in self._reader.get_matched_publications()]
        kinds = self._discovery.topic_types()
        ours = {*PUBLISHED_TOPICS, self.command_topic}
        others = ", ".join(f"{name} ({kind})" for name, kind in kinds.items() if name not in ours)
        unmatched = ""
        if not writers and (kind := kinds.get(self.command_topic)):
            why = f"sends {kind}" if kind != self.command_type else "is best effort, expected reliable"
            unmatched = f" (one that does not match {why})"
        return (
            f"waiting for a controller: {JOINT_STATES_TOPIC} has {_end_list('reader', ends)}, {self.command_topic} "
            f"({self.command_type}) has {_end_list('writer', writers)}{unmatched}; "
            f"other topics here: {others or 'none'}"
        )

    def ends(self) -> dict[str, int]:
        """Return the numbers of present readers of joint states, and of writers of commands so far."""
        return {"readers": len(self._joint_states.get_matched_subscriptions()), "publishers": self.publishers.seen}

    def _update_publishers(self) -> None:
        # cyclonedds returns them as signed numbers here, and as unsigned ones with a message
        self.publishers.update([one & HANDLE_MASK for one in self._reader.get_matched_publications()])

    def _write(self, writer: Any, data: bytes) -> None:
        from cyclonedds.core import DDSException

        # an instance of the topic's class without its fields, since `data` is encoded already
        message = object.__new__(writer.data_type)
        message.serialize = lambda **_: data
        try:
            writer.write(message)
        except DDSException:
            # a reader that is too slow must not stop the robot
            self.unwritten += 1


def _end_list(what: str, ends: Sequence[Any]) -> str:
    there = ", ".join(str(one.participant_key)[:8] for one in ends if one is not None)
    return count_text(len(ends), what) + (f" (participant {there})" if there else "")
