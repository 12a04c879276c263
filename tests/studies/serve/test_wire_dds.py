"""The wire on the loopback: messages by DDS, controllers of several kinds, and a simulation that only counts."""

import os
import time
from collections.abc import Callable, Iterator
from itertools import count
from threading import Thread
from typing import Any

import numpy as np
import pytest

from tests.studies.serve.test_wire_lockstep import Notes
from tests.studies.serve.test_wire_messages import JOINTS, MOTORS, array
from tests.studies.shadow.conftest import LOOPBACK
from twin.kernel.cosim.port import width
from twin.kernel.errors import InputRefused
from twin.kernel.process.mailbox import IGNORED_TAG, OBEYED_TAG, Mailbox
from twin.kernel.recording.sources.ros_types import TYPE_STORE
from twin.robot.remote import COMMAND_PORTS, SAMPLE_PORTS
from twin.studies.serve import exchange, messages, wire
from twin.studies.serve.messages import CLOCK, JOINT_STATE, NS_PER_SECOND, SPEED_ARRAY, WRENCH

pytest.importorskip("cyclonedds")
COUNTS_M, COUNTS_L, PERIOD = 4096, 16384, 0.002
COMMANDS, ARRAYS = "/robot_joint_command", "/velocity_controller/commands"
MOVED = np.array([10.0, -20.0, 5000.0, 1.0, 2.0, 40000.0])
"""Counts of motors and joints, more than a turn too."""
TIMEOUT = 20.0
_TESTS = count()


@pytest.fixture(scope="module", autouse=True)
def loopback() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CYCLONEDDS_URI", LOOPBACK)
        yield


@pytest.fixture
def domain(worker_id: str) -> int:
    """One for each test, since nodes of the last one may still be known."""
    worker = int(worker_id.removeprefix("gw")) if worker_id.startswith("gw") else 0
    return 110 + 12 * (worker % 10) + next(_TESTS) % 12


def until(holds: Callable[[], Any]) -> None:
    end = time.monotonic() + TIMEOUT
    while not holds():
        assert time.monotonic() < end
        time.sleep(0.005)


class Node:
    """A node of the other side, in a participant of its own.

    Args:
        reliable: whether its reader is reliable.
    """

    def __init__(self, domain: int, reliable: bool = True):
        from cyclonedds.core import Policy, Qos
        from cyclonedds.domain import DomainParticipant
        from cyclonedds.util import duration

        kind = Policy.Reliability.Reliable(duration(seconds=1)) if reliable else Policy.Reliability.BestEffort
        self._qos = Qos(kind, Policy.Durability.Volatile, Policy.History.KeepLast(1000))
        self._participant = DomainParticipant(domain)
        self._ends: dict[str, Any] = {}

    def reader(self, topic: str, kind: str) -> Callable[[], list[Any]]:
        """Subscribe; return a function that takes the decoded messages."""
        from cyclonedds.sub import DataReader

        reader: Any = DataReader(self._participant, wire.raw_topic(self._participant, topic, kind), qos=self._qos)
        self._ends[topic] = reader
        return lambda: [
            TYPE_STORE.deserialize_cdr(one.data, kind) for one in reader.take(1000) if isinstance(one, wire.RawMessage)
        ]

    def writer(self, topic: str = COMMANDS, kind: str = JOINT_STATE) -> Callable[[bytes], None]:
        """Publish; return a function that writes bytes."""
        from cyclonedds.pub import DataWriter

        writer: Any = DataWriter(self._participant, wire.raw_topic(self._participant, topic, kind), qos=self._qos)
        self._ends[topic] = writer

        def write(data: bytes) -> None:
            message = object.__new__(writer.data_type)
            message.serialize = lambda **_: data
            writer.write(message)

        until(writer.get_matched_subscriptions)
        return write

    def close(self) -> None:
        self._ends.clear()
        del self._participant


class Robot:
    """The wire in a thread, and the simulation's side of its mailbox."""

    def __init__(self, domain: int, **changed: Any):
        self.notes = Notes()
        sizes = width(SAMPLE_PORTS), width(COMMAND_PORTS)
        self.mailbox = Mailbox(self.notes.box, *sizes)
        settings = {
            "lockstep": False, "answer_s": 10.0, "names": list(JOINTS), "commands": "joint", "command_topic": "",
            "domain": domain, "tick_s": 0.001, "period_ticks": 2, "counts_m": COUNTS_M, "counts_l": COUNTS_L,
            "has_effort": True, "has_scale": True, "watchdog": 0.01,
        } | changed  # fmt: skip
        self.summary: dict[str, Any] = {}
        reporter: Any = self.notes
        self._thread = Thread(target=lambda: self.summary.update(exchange.exchange(reporter, settings)))
        self._thread.start()

    def put(self, tick: int, counts: np.ndarray, speeds: tuple[float, ...] = (0, 0, 0), applied: int = 0) -> None:
        values = [*counts, tick, 5.0, 0.1, 0.2, 0.3, *speeds, 0.0]
        self.mailbox.samples.put(tick, values, applied)

    def close(self) -> dict[str, Any]:
        self.mailbox.close()
        self._thread.join(10.0)
        assert not self._thread.is_alive()
        return self.summary


@pytest.fixture
def started(domain: int) -> Iterator[Callable[..., Robot]]:
    robots: list[Robot] = []

    def start(**changed: Any) -> Robot:
        robots.append(Robot(domain, **changed))
        return robots[-1]

    yield start
    for one in robots:
        one.close()


def stamp_of(message: Any) -> int:
    return int(message.header.stamp.sec * NS_PER_SECOND + message.header.stamp.nanosec)


def test_in_real_time_a_robot_publishes_what_ros_calls_a_joint_state(started: Callable[..., Robot], domain: int):
    robot = started()
    node = Node(domain, reliable=False)
    joints, forces, applied = (
        node.reader("/joint_states", JOINT_STATE),
        node.reader("/scale/wrench", WRENCH),
        node.reader("/commands_applied", JOINT_STATE),
    )
    write = node.writer()
    until(lambda: node._ends["/joint_states"].get_matched_publications())
    until(lambda: node._ends["/commands_applied"].get_matched_publications())
    until(lambda: node._ends["/scale/wrench"].get_matched_publications())
    begun = time.time_ns()
    robot.put(0, np.zeros(6))
    robot.put(2, MOVED)
    # a sample between was lost
    robot.put(6, np.zeros(6), (1, 2, 3), applied=1)
    found: list[Any] = []

    def all_there() -> bool:
        found.extend(joints())
        return len(found) == 3

    until(all_there)
    angles = MOVED * 2 * np.pi / np.repeat([COUNTS_M, COUNTS_L], 3)
    assert found[0].name == list(JOINTS) and found[0].header.frame_id == "base"
    assert found[1].position.tolist() == angles.tolist()
    assert not found[0].velocity.any()
    np.testing.assert_allclose(found[1].velocity, angles / PERIOD)
    np.testing.assert_allclose(found[2].velocity, -angles / (2 * PERIOD))
    assert found[0].effort[:3].tolist() == [0.1, 0.2, 0.3] and np.isnan(found[0].effort[3:]).all()
    stamps = [stamp_of(one) for one in found]
    assert stamps == sorted(stamps) and abs(stamps[0] - begun) < 1e9
    assert [one.wrench.force.z for one in forces()] == [-5.0] * 3
    (effect,) = applied()
    assert (stamp_of(effect), effect.name, effect.velocity.tolist()) == (stamps[2], list(MOTORS), [1, 2, 3])
    write(messages.joint_state(stamps[2], MOTORS, velocity=(4, 5, 6)))
    command = robot.mailbox.commands.pop(TIMEOUT)
    assert command is not None and command.values.tolist() == [4, 5, 6] and command.tag == OBEYED_TAG
    summary = robot.close()
    assert summary["samples"] == 3 and summary["commands"] == 1 and summary["unanswered"] == 0


def obeyed(robot: Robot, wanted: int) -> list[list[float]]:
    """The first commands that are obeyed."""
    found: list[list[float]] = []
    while len(found) < wanted:
        one = robot.mailbox.commands.pop(TIMEOUT)
        assert one is not None
        if one.tag == OBEYED_TAG:
            found.append(one.values.tolist())
    return found


def test_commands_older_than_the_newest_and_of_the_second_publisher_are_recorded_and_not_obeyed(
    started: Callable[..., Robot], domain: int
):
    robot = started()
    write = Node(domain).writer()

    def send(stamp: int, speed: float, write: Callable[[bytes], None]) -> int:
        write(messages.joint_state(stamp, MOTORS, velocity=(speed, speed, speed)))
        one = robot.mailbox.commands.pop(TIMEOUT)
        assert one is not None and one.values[0] == speed
        return one.tag

    other = Node(domain)
    second: Callable[[bytes], None] | None = None
    assert send(10, 1.0, write) == OBEYED_TAG
    second = other.writer()
    assert send(9, 2.0, write) == IGNORED_TAG
    assert send(11, 3.0, write) == OBEYED_TAG
    assert send(99, 4.0, second) == IGNORED_TAG
    # not mixed: its stamp does not make others old
    assert send(12, 5.0, write) == OBEYED_TAG
    assert robot.close()["ignored"] == {"old": 1, "other publisher": 1}
    assert any("a second publisher" in text for text in robot.notes.texts("event"))


def test_a_node_that_comes_back_is_obeyed_whether_it_left_or_was_killed(
    started: Callable[..., Robot], domain: int, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(wire, "SILENCE_TIMEOUT", 0.2)
    robot, first = started(), Node(domain)
    write = first.writer()
    write(messages.joint_state(1000, MOTORS, velocity=(1, 1, 1)))
    assert obeyed(robot, 1) == [[1, 1, 1]]
    del write
    first.close()
    second = Node(domain)
    write = second.writer()
    time.sleep(0.3)
    # its clock has begun anew
    write(messages.joint_state(5, MOTORS, velocity=(2, 2, 2)))
    assert obeyed(robot, 1) == [[2, 2, 2]]
    # silent and still matched, as after a kill
    third = Node(domain).writer()
    third(messages.joint_state(4, MOTORS, velocity=(3, 3, 3)))
    time.sleep(0.3)
    third(messages.joint_state(5, MOTORS, velocity=(4, 4, 4)))
    assert obeyed(robot, 1) == [[4, 4, 4]]
    assert robot.close()["publishers"] == 3
    assert any("another one is obeyed from now on" in text for text in robot.notes.texts("event"))


def test_a_publisher_keeps_its_place_as_long_as_the_watchdog_accepts_its_silence(
    started: Callable[..., Robot], domain: int, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(wire, "SILENCE_TIMEOUT", 0.2)
    robot, first = started(watchdog=0.0), Node(domain).writer()
    first(messages.joint_state(1, MOTORS, velocity=(1, 1, 1)))
    assert obeyed(robot, 1) == [[1, 1, 1]]
    second = Node(domain).writer()
    time.sleep(0.4)
    second(messages.joint_state(2, MOTORS, velocity=(2, 2, 2)))
    ignored = robot.mailbox.commands.pop(TIMEOUT)
    assert ignored is not None and ignored.tag == IGNORED_TAG
    first(messages.joint_state(3, MOTORS, velocity=(3, 3, 3)))
    assert obeyed(robot, 1) == [[3, 3, 3]]
    assert robot.close()["ignored"] == {"other publisher": 1}


def test_the_publisher_that_matched_first_is_obeyed_also_if_another_sends_first(
    started: Callable[..., Robot], domain: int, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(wire, "SILENCE_TIMEOUT", TIMEOUT)
    robot = started()
    # several, since DDS may list few in the order of matching by chance
    ends = [Node(domain).writer()]
    time.sleep(2 * wire.WAIT_TIMEOUT + 0.1)
    ends += [Node(domain).writer() for _ in range(5)]
    time.sleep(2 * wire.WAIT_TIMEOUT + 0.1)
    for number, write in reversed(list(enumerate(ends))):
        write(messages.joint_state(1, MOTORS, velocity=(number, 0, 0)))
        one = robot.mailbox.commands.pop(TIMEOUT)
        assert one is not None and (one.values[0], one.tag) == (number, IGNORED_TAG if number else OBEYED_TAG)


def test_joints_and_commands_may_have_other_names_and_drives_no_torque(started: Callable[..., Robot], domain: int):
    names = [f"joint_{k}" for k in range(6)]
    robot, node = started(names=names, command_topic="/lab/speeds", has_effort=False), Node(domain)
    joints, write = node.reader("/joint_states", JOINT_STATE), node.writer("/lab/speeds")
    until(lambda: node._ends["/joint_states"].get_matched_publications())
    robot.put(0, MOVED)
    found: list[Any] = []

    def is_there() -> bool:
        found.extend(joints())
        return bool(found)

    until(is_there)
    assert found[0].name == names and len(found[0].effort) == 0 and len(found[0].velocity) == 6
    write(messages.joint_state(1, MOTORS, velocity=(9, 9, 9)))
    write(messages.joint_state(2, names[:3], velocity=(4, 5, 6)))
    assert obeyed(robot, 1) == [[4, 5, 6]]
    assert robot.close()["ignored"] == {"invalid": 1}


@pytest.mark.parametrize("leaves", [True, False])
def test_a_node_that_comes_back_in_lockstep_answers_the_sample_that_waits(
    started: Callable[..., Robot], domain: int, monkeypatch: pytest.MonkeyPatch, leaves: bool
):
    monkeypatch.setattr(wire, "SILENCE_TIMEOUT", 0.5)
    monkeypatch.setattr("twin.studies.serve.lockstep.REPEAT_PERIOD", 0.1)
    robot, first, second = started(lockstep=True), Node(domain), Node(domain)
    states, write = first.reader("/joint_states", JOINT_STATE), first.writer()
    until(lambda: robot.notes.texts("ready"))
    robot.put(0, MOVED)
    until(states)
    write(messages.joint_state(NS_PER_SECOND, MOTORS, velocity=(1, 1, 1)))
    assert obeyed(robot, 1) == [[1, 1, 1]]
    del write
    if leaves:
        first.close()
    robot.put(2, MOVED)
    joints, write = second.reader("/joint_states", JOINT_STATE), second.writer()
    answers: list[int] = []
    commands: list[Any] = []

    def is_answered() -> bool:
        for one in joints():
            answers.append(stamp_of(one))
            write(messages.joint_state(answers[-1], MOTORS, velocity=(2, 2, 2)))
        commands.extend(iter(robot.mailbox.commands.pop, None))
        return any(one.tag == OBEYED_TAG for one in commands)

    until(is_answered)
    assert (commands[-1].tick, commands[-1].values.tolist()) == (2, [2, 2, 2])
    assert set(answers) == {NS_PER_SECOND + 2_000_000}
    assert robot.close()["deterministic"]
    assert any("another one is obeyed" in text for text in robot.notes.texts("event")) != leaves


@pytest.mark.parametrize("kind", ["joint", "array"])
def test_in_lockstep_every_sample_is_answered_by_its_stamp_or_its_place(
    started: Callable[..., Robot], domain: int, monkeypatch: pytest.MonkeyPatch, kind: str
):
    robot = started(lockstep=True, commands=kind)
    node, n = Node(domain), 200
    joints, times = node.reader("/joint_states", JOINT_STATE), node.reader("/clock", CLOCK)
    write = node.writer(ARRAYS, SPEED_ARRAY) if kind == "array" else node.writer()
    stamps: list[int] = []
    written: list[str] = []
    alive, write_one = True, wire.Wire._write

    def note_topic(it: wire.Wire, writer: Any, data: bytes) -> None:
        written.append(writer.topic.name.removeprefix("rt"))
        write_one(it, writer, data)

    monkeypatch.setattr(wire.Wire, "_write", note_topic)

    def answer() -> None:
        while alive:
            for one in joints():
                stamps.append(stamp_of(one))
                speeds = one.position[:3] * 2.0
                write(array(*speeds) if kind == "array" else messages.joint_state(stamps[-1], MOTORS, velocity=speeds))
            time.sleep(0.0002)

    controller = Thread(target=answer)
    controller.start()
    try:
        until(lambda: robot.notes.texts("ready"))
        for k in range(n):
            robot.put(2 * k, np.full(6, k))
            one = robot.mailbox.commands.pop(TIMEOUT)
            assert one is not None and (one.tick, one.tag) == (2 * k, OBEYED_TAG)
            assert one.values[0] == 2.0 * k * 2 * np.pi / COUNTS_M
    finally:
        alive = False
        controller.join()
    assert stamps == [1_000_000_000 + 2_000_000 * k for k in range(n)]
    assert len(times()) >= 1
    # a controller that has the joint states has force and time, too
    assert written == ["/scale/wrench", "/clock", "/joint_states", "/commands_applied"] * n
    summary = robot.close()
    assert summary["deterministic"] and summary["samples"] == summary["commands"] == n and not summary["ignored"]


def test_the_wait_names_both_sides_and_the_topics_that_are_there(started: Callable[..., Robot], domain: int):
    robot = started(lockstep=True)
    node = Node(domain)
    node.reader("/joint_states", JOINT_STATE)
    # a topic of another name
    from cyclonedds.pub import DataWriter

    other: Any = DataWriter(node._participant, wire.raw_topic(node._participant, "/robot_joint_commands", JOINT_STATE))
    until(lambda: any("/robot_joint_commands" in text for text in robot.notes.texts("waiting")))
    text = robot.notes.texts("waiting")[-1]
    assert "/joint_states has 1 reader (participant " in text
    assert "/robot_joint_command (sensor_msgs/msg/JointState) has 0 writers" in text
    assert text.endswith("other topics here: /robot_joint_commands (sensor_msgs/msg/JointState)")
    assert other is not None and os.environ["CYCLONEDDS_URI"] == LOOPBACK


def settings_of(domain: int, topic: str = "") -> dict[str, Any]:
    return {
        "lockstep": True, "names": JOINTS, "commands": "joint", "command_topic": topic, "domain": domain,
        "tick_s": 1e-3, "counts_m": COUNTS_M, "counts_l": COUNTS_L, "has_effort": False, "has_scale": False,
        "watchdog": 0.01,
    }  # fmt: skip


def test_a_topic_that_the_robot_publishes_takes_no_commands(domain: int):
    events: Any = None
    with pytest.raises(InputRefused, match="--command-topic /joint_states: twin serve publishes it"):
        wire.Wire(settings_of(domain, "/joint_states"), events)


def test_an_unusable_network_is_refused_by_its_setting(domain: int, monkeypatch: pytest.MonkeyPatch):
    events: Any = None
    monkeypatch.setenv("CYCLONEDDS_URI", "<Cyclo")
    with pytest.raises(InputRefused, match=f"DDS cannot begin on domain {domain}; check CYCLONEDDS_URI"):
        wire.Wire(settings_of(domain), events)


def test_a_wait_reports_why_a_writer_of_commands_does_not_match(started: Callable[..., Robot], domain: int):
    from cyclonedds.pub import DataWriter

    robot, node = started(lockstep=True), Node(domain, reliable=False)
    topic = wire.raw_topic(node._participant, COMMANDS, JOINT_STATE)
    node._ends[COMMANDS] = DataWriter(node._participant, topic, qos=node._qos)
    until(lambda: any("is best effort, expected reliable" in text for text in robot.notes.texts("waiting")))
    node.close()
    other = Node(domain)
    topic = wire.raw_topic(other._participant, COMMANDS, SPEED_ARRAY)
    other._ends[COMMANDS] = DataWriter(other._participant, topic, qos=other._qos)
    until(lambda: any(f"does not match sends {SPEED_ARRAY}" in text for text in robot.notes.texts("waiting")))
    other.close()
