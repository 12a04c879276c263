"""DDS side of a served robot: publishes its samples as ROS 2 topics and receives the commands of a controller.

It runs in a process of its own and talks to the simulation by a mailbox. In real time two threads share it: one sleeps
until a sample is there and publishes it, the other sleeps until a command arrives. In lockstep see `lockstep`.
"""

import contextlib
import time
from collections.abc import Callable, Sequence
from threading import Thread
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin.kernel.cosim.histogram import Histogram
from twin.kernel.cosim.port import port_slices, width
from twin.kernel.errors import InputRefused
from twin.kernel.process.mailbox import IGNORED_TAG, OBEYED_TAG, Mailbox, MailboxEntry
from twin.kernel.process.real_time import real_time
from twin.kernel.process.reporter import PipeReporter
from twin.kernel.recording.sources.dds import RawMessage, TopicDiscovery, domain_id, raw_topic
from twin.robot.remote import COMMAND_PORTS, SAMPLE_PORTS
from twin.studies.result import count_text
from twin.studies.serve import messages
from twin.studies.serve.lockstep import REPORT_PERIOD, WAIT_TIMEOUT, Lockstep
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
"""Time (s) without a command of the obeyed publisher after which another one that sends is obeyed."""
MAX_PENDING = 10_000
"""Maximum number of samples whose answers are awaited for the count of lost commands."""
MAX_EVENTS = 10
"""Maximum number of recorded events per reason; later ones are only counted."""


_PLACES = port_slices(SAMPLE_PORTS)
"""Slices of a sample's values by port."""
_COUNTS = slice(_PLACES["count_m"].start, _PLACES["count_l"].stop)


class ReceivedCommand(NamedTuple):
    """A command with its publisher.

    Attributes:
        obeyed: whether the publisher is the obeyed one.
    """

    obeyed: bool
    command: MotorCommand


class WireEvents:
    """Events of the wire, a limited number of each kind, and their counts.

    Args:
        reporter: receives the events as notes.

    Attributes:
        counts: number of events by reason.
    """

    def __init__(self, reporter: PipeReporter):
        self._reporter = reporter
        self.counts: dict[str, int] = {}

    def add(self, reason: str, text: str, tick: int = -1, level: str = "WARNING") -> None:
        """Count an event, and report it unless many of the same reason have been reported."""
        self.counts[reason] = count = self.counts.get(reason, 0) + 1
        if count <= MAX_EVENTS:
            more = "; more of this kind are only counted" if count == MAX_EVENTS else ""
            self._reporter.note(event=text + more, level=level, tick=tick)


class Publishers:
    """Choice of the obeyed publisher: the first that matched, until it leaves or is silent while another one sends.

    DDS takes 10 s and more to notice a process that was killed; its successor must not wait for that.

    Args:
        events: receives changes of the obeyed publisher.

    Attributes:
        matched: DDS handles of the present publishers; the first is obeyed, the others are in order of matching.
        seen: number of publishers so far.
    """

    def __init__(self, events: WireEvents):
        self._events = events
        self.matched: list[int] = []
        self.seen = 0
        self._heard = 0.0

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
        if publisher in self.matched[1:] and now - self._heard > SILENCE_TIMEOUT:
            silence = (
                f"the publisher of commands was silent for {SILENCE_TIMEOUT:g} s; another one is obeyed from now on"
            )
            self._events.add("publisher replaced", silence)
            self.matched.remove(publisher)
            self.matched.insert(0, publisher)
        obeyed = self.matched[:1] == [publisher]
        if obeyed:
            self._heard = now
        return obeyed


class Wire:
    """DDS participant of the served robot: writers of its topics and a reader of commands.

    Args:
        settings: see `exchange`.
        events: receives changes of the obeyed publisher.

    Raises:
        InputRefused: the command topic or the network is unusable.

    Attributes:
        names: names of motors and joints (6).
        command_topic, command_type: topic of commands, and its type.
        publishers: publishers of commands.
        unwritten: number of messages that were not written since a reader was too slow.
    """

    def __init__(self, settings: dict[str, Any], events: WireEvents):
        from cyclonedds.core import (
            DDSException,
            InstanceState,
            Policy,
            Qos,
            ReadCondition,
            SampleState,
            ViewState,
            WaitSet,
        )  # fmt: skip
        from cyclonedds.domain import DomainParticipant
        from cyclonedds.pub import DataWriter
        from cyclonedds.sub import DataReader
        from cyclonedds.util import duration

        self.names, self._lockstep = list(settings["names"]), settings["lockstep"]
        self._turns = 2.0 * np.pi / np.repeat([settings["counts_m"], settings["counts_l"]], MOTOR_COUNT)
        self._tick = settings["tick_s"]
        names, motors = self.names, self.names[:MOTOR_COUNT]
        self._effort = np.full(len(names), np.nan)
        self._joint_template = MessageTemplate(
            lambda stamp, *arrays: messages.joint_state(stamp, names, *arrays),
            len(names), len(names), len(names) if settings["has_effort"] else 0,
        )  # fmt: skip
        self._applied_template = MessageTemplate(
            lambda stamp, speeds: messages.joint_state(stamp, motors, velocity=speeds), MOTOR_COUNT
        )
        self._wrench_template = MessageTemplate(lambda stamp, force: messages.wrench(stamp, -force[0]), 1)
        topic, self.command_type = COMMAND_TOPICS[settings["commands"]]
        self.command_topic = settings["command_topic"] or topic
        if self.command_topic in PUBLISHED_TOPICS:
            raise InputRefused(f"--command-topic {self.command_topic}: twin serve publishes it; expected another topic")
        domain = domain_id() if settings["domain"] is None else settings["domain"]
        try:
            self._participant = DomainParticipant(domain)
        except DDSException:
            raise InputRefused(
                f"DDS cannot begin on domain {domain}; check CYCLONEDDS_URI and the network interfaces"
            ) from None
        self._discovery = TopicDiscovery(self._participant)
        reliable, volatile = (
            Policy.Reliability.Reliable(duration(seconds=MAX_BLOCKING_TIME)),
            Policy.Durability.Volatile,
        )
        queue = Policy.History.KeepLast(QUEUE_DEPTH)

        def writer(name: str, kind: str, history: Any = queue) -> Any:
            return DataWriter(
                self._participant, raw_topic(self._participant, name, kind), Qos(reliable, volatile, history)
            )

        self._joint_states = writer(JOINT_STATES_TOPIC, messages.JOINT_STATE)
        self._applied = writer(APPLIED_TOPIC, messages.JOINT_STATE)
        self._wrench = writer(WRENCH_TOPIC, messages.WRENCH) if settings["has_scale"] else None
        self._clock = writer(CLOCK_TOPIC, messages.CLOCK, Policy.History.KeepLast(1)) if self._lockstep else None
        wanted = Qos(reliable if self._lockstep else Policy.Reliability.BestEffort, volatile, queue)
        commands = raw_topic(self._participant, self.command_topic, self.command_type)
        self._reader: Any = DataReader(self._participant, commands, qos=wanted)
        self._waiting = WaitSet(self._participant)
        unread = SampleState.NotRead | ViewState.Any | InstanceState.Any
        self._condition = ReadCondition(self._reader, unread)
        self._waiting.attach(self._condition)
        self.publishers = Publishers(events)
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

    def receive(self, wait: float) -> list[ReceivedCommand]:
        """Return the commands received since the last call; wait up to `wait` (s) for the first one."""
        if wait > 0.0:
            self._waiting.wait(round(wait * 1e9))
        found = []
        for one in self._reader.take(QUEUE_DEPTH):
            # without data a writer has left
            if isinstance(one, RawMessage):
                publisher = one.sample_info.publication_handle
                if self.publishers.matched[:1] != [publisher]:
                    self._update_publishers()
                command = messages.read_command(one.data, self.command_type, self.names[:MOTOR_COUNT])
                found.append(ReceivedCommand(self.publishers.is_obeyed(publisher), command))
        return found

    @property
    def matched(self) -> bool:
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
            f"waiting for a controller: {JOINT_STATES_TOPIC} has {_listed('reader', ends)}, {self.command_topic} "
            f"({self.command_type}) has {_listed('writer', writers)}{unmatched}; other topics here: {others or 'none'}"
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


def _listed(what: str, ends: Sequence[Any]) -> str:
    there = ", ".join(str(one.participant_key)[:8] for one in ends if one is not None)
    return count_text(len(ends), what) + (f" (participant {there})" if there else "")


class FreeExchange:
    """Exchange in real time: samples are published as they come, commands are passed on as they arrive.

    Args:
        wire: DDS side.
        mailbox: the simulation.
        events: receives events.
        report: receives texts for the user while no command has arrived.
    """

    def __init__(self, wire: Wire, mailbox: Mailbox, events: WireEvents, report: Callable[[str], None]):
        self._wire, self._mailbox, self._events, self._report = wire, mailbox, events, report
        # stamps are wall time, by a clock that cannot be set back
        self._offset = time.time_ns() - time.monotonic_ns()
        self._newest: int | None = None
        self._obeyed: list[int] = []
        self._arrived: dict[int, int] = {}
        self._published: dict[int, int] = {}
        self._samples = self._commands = self._answers = self._first = self._last = 0
        self._latency, self._effect = Histogram(), Histogram()
        self._applied, self._speeds = 0, np.zeros(MOTOR_COUNT)
        self._failure: BaseException | None = None

    def run(self) -> dict[str, Any]:
        """Exchange samples and commands until the run has ended; return the summary."""
        reported = time.monotonic()
        threads = [
            Thread(target=self._guarded, args=(step,), name=name, daemon=True)
            for name, step in (("commands", self._receive), ("samples", self._publish_next))
        ]
        for one in threads:
            one.start()
        # existing threads get the higher priority; they are not pinned, since others of twin share the machine. Each is
        # done in less than the interval and then waits: switching in the middle doubles the processor time of both
        with real_time(switch_interval=WAIT_TIMEOUT) as refused:
            while not self._mailbox.closed and self._failure is None:
                time.sleep(WAIT_TIMEOUT)
                if not self._commands and time.monotonic() > reported + REPORT_PERIOD:
                    reported = time.monotonic()
                    self._report(self._wire.waiting_text())
            for one in threads:
                one.join(1.0)
        if self._failure is not None:
            raise self._failure
        return self._summary([refused] if refused else [])

    def _guarded(self, step: Callable[[], None]) -> None:
        try:
            while not self._mailbox.closed:
                step()
        except BaseException as problem:
            self._failure = problem

    def _publish_next(self) -> None:
        if (entry := self._mailbox.samples.pop(WAIT_TIMEOUT)) is not None:
            self._publish(entry)

    def _publish(self, entry: MailboxEntry) -> None:
        stamp = entry.time + self._offset
        self._samples += 1
        # before an answer can come
        self._published[stamp] = self._samples
        self._wire.write_sample(stamp, entry)
        written = time.monotonic_ns()
        if len(self._published) > MAX_PENDING:
            # the other thread may remove one meanwhile, which ends an iteration
            with contextlib.suppress(RuntimeError):
                self._published.pop(next(iter(self._published)), None)
        if (arrived := self._arrived.pop(self._applied, None)) is not None:
            self._latency.add(1e-9 * (written - arrived))
        speeds = entry.values[_PLACES["omega_ref"]]
        if entry.tag != self._applied or not np.array_equal(speeds, self._speeds, equal_nan=True):
            self._wire.write_applied(stamp, speeds)
        if entry.tag != self._applied:
            self._applied = entry.tag
            # older ones were superseded before a tick
            for number in [n for n in list(self._arrived) if n < entry.tag]:
                del self._arrived[number]
            if (arrived := self._arrived.get(entry.tag)) is not None:
                self._effect.add(1e-9 * (written - arrived))
        self._speeds = speeds

    def _receive(self) -> None:
        for one in self._wire.receive(WAIT_TIMEOUT):
            self._pass_on(one)

    def _pass_on(self, received: ReceivedCommand) -> None:
        arrived, command = time.monotonic_ns(), received.command
        obeyed = self._wire.publishers.matched[:1]
        if obeyed != self._obeyed:
            # another node has a clock of its own
            self._obeyed, self._newest = obeyed, None
        if self._refused(received):
            self._mailbox.commands.put(-1, command.speeds, IGNORED_TAG)
            return
        # before the simulation can have it
        self._arrived[self._mailbox.commands.number + 1] = arrived
        self._mailbox.commands.put(-1, command.speeds, OBEYED_TAG)
        self._commands += 1
        self._newest = command.stamp
        if command.stamp is not None and (sample := self._published.pop(command.stamp, 0)):
            self._answers += 1
            self._first, self._last = self._first or sample, max(self._last, sample)

    def _refused(self, received: ReceivedCommand) -> bool:
        """Whether a command is not obeyed; counts it."""
        command, topic = received.command, self._wire.command_topic
        if not received.obeyed:
            self._events.add("other publisher", f"{topic}: a second publisher; its command is not obeyed")
        elif command.mistake:
            self._events.add("invalid", f"{topic}: {command.mistake}")
        elif self._newest is not None and command.stamp is not None and command.stamp < self._newest:
            late = 1e-6 * (self._newest - command.stamp)
            self._events.add("old", f"{topic}: a command {late:.3g} ms older than the newest was dropped")
        else:
            return False
        return True

    def _summary(self, notes: list[str]) -> dict[str, Any]:
        latencies = {
            name: {"p50": 1e3 * one.quantile(0.5), "p99": 1e3 * one.quantile(0.99), "largest": 1e3 * one.largest}
            for name, one in (("latency_ms", self._latency), ("effect_ms", self._effect))
            if one.count
        }
        asked = self._last - self._first + 1 if self._answers else 0
        return {
            "samples": self._samples, "lost": self._mailbox.samples.lost, "unwritten": self._wire.unwritten,
            "commands": self._commands, "ignored": self._events.counts, "unanswered": asked - self._answers,
            **self._wire.ends(), **latencies, "notes": notes,
        }  # fmt: skip


def exchange(reporter: PipeReporter, settings: dict[str, Any]) -> dict[str, Any]:
    """Exchange messages with a controller until the simulation closes the mailbox; return a summary.

    Args:
        reporter: reporter of this process; its black box has the mailbox.
        settings: lockstep (bool), answer_s, names of motors and joints (6), commands ("joint" or "array"),
            command_topic ("" for the default), domain (None for ROS_DOMAIN_ID), tick_s, counts_m and counts_l per turn,
            has_effort, has_scale.
    """
    events = WireEvents(reporter)
    wire = Wire(settings, events)
    mailbox = Mailbox(reporter.box, width(SAMPLE_PORTS), width(COMMAND_PORTS))

    def report(text: str) -> None:
        reporter.note(waiting=text)

    if settings["lockstep"]:
        stamped = settings["commands"] == "joint"
        return Lockstep(wire, mailbox, events, report, settings["tick_s"], stamped, settings["answer_s"]).run(
            lambda: reporter.note(ready=True)
        )
    reporter.note(ready=True)
    return FreeExchange(wire, mailbox, events, report).run()
