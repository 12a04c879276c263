"""The lockstep protocol without a network: each sample is answered once, by one publisher, or asked again."""

import os
from collections.abc import Iterator
from threading import Thread
from typing import Any

import numpy as np
import pytest

from twin.kernel.cosim.port import width
from twin.kernel.process.mailbox import GIVE_UP_TAG, IGNORED_TAG, OBEYED_TAG, Mailbox, MailboxEntry
from twin.robot.remote import COMMAND_PORTS, SAMPLE_PORTS
from twin.studies.serve import lockstep
from twin.studies.serve.lockstep import START_STAMP, Lockstep
from twin.studies.serve.messages import MotorCommand
from twin.studies.serve.wire import WireEvents

TICK = 1e-3
SPEEDS = np.array([1.0, 2.0, 3.0])


class Notes:
    """A reporter that keeps its notes."""

    def __init__(self) -> None:
        self.notes: list[dict[str, Any]] = []
        self.box = os.memfd_create("box")

    def note(self, **facts: Any) -> None:
        self.notes.append(facts)

    def texts(self, kind: str) -> list[str]:
        return [one[kind] for one in self.notes if kind in one]


class FakeWire:
    """A wire whose controller answers the samples with the commands that `answers` lists for each writing."""

    command_topic = "/robot_joint_command"
    batch = 1

    def __init__(self, *answers: list[MotorCommand]):
        self._answers, self._queue = list(answers), list[MotorCommand]()
        self.stamps: list[int] = []
        self.applied: list[int] = []
        self.has_controller = True

    def write_sample(self, stamp: int, entry: MailboxEntry) -> None:
        self._stamp = stamp
        self.repeat_sample()

    def repeat_sample(self) -> None:
        self.stamps.append(self._stamp)
        self._queue += self._answers.pop(0) if self._answers else []

    def write_applied(self, stamp: int, speeds: np.ndarray) -> None:
        self.applied.append(stamp)

    def receive(self, wait: float) -> list[MotorCommand]:
        if wait == 0.0:
            return []
        taken, self._queue = self._queue[: self.batch], self._queue[self.batch :]
        return taken

    def waiting_text(self) -> str:
        return "waiting"

    def ends(self) -> dict[str, int]:
        return {}


def command(tick: int | None, speeds: np.ndarray = SPEEDS, mistake: str = "", obeyed: bool = True) -> MotorCommand:
    stamp = None if tick is None else START_STAMP + tick * 1_000_000
    return MotorCommand(stamp, speeds, mistake, obeyed)


class Served:
    """The protocol in a thread, and the simulation's side of the mailbox."""

    def __init__(self, wire: FakeWire, stamped: bool = True, answer: float = 5.0):
        self.notes, self.wire = Notes(), wire
        sizes = width(SAMPLE_PORTS), width(COMMAND_PORTS)
        self.mailbox = Mailbox(self.notes.box, *sizes)
        reporter: Any = self.notes
        made: Any = wire
        settings = {"tick_s": TICK, "commands": "joint" if stamped else "array", "answer_s": answer}
        protocol = Lockstep(made, Mailbox(self.notes.box, *sizes), WireEvents(reporter), reporter, settings)
        self.summary: dict[str, Any] = {}
        self._thread = Thread(target=lambda: self.summary.update(protocol.run()))
        self._thread.start()

    def ask(self, tick: int) -> MailboxEntry:
        """Send the sample of a tick; return the first command that is no ignored one."""
        self.mailbox.samples.put(tick, np.zeros(width(SAMPLE_PORTS)))
        while (found := self.mailbox.commands.pop(5.0)) is not None:
            if found.tag != IGNORED_TAG:
                return found
        raise AssertionError("no answer")

    def close(self) -> dict[str, Any]:
        self.mailbox.close()
        self._thread.join(10.0)
        assert not self._thread.is_alive()
        return self.summary


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setattr(lockstep, "REPEAT_PERIOD", 0.02)
    monkeypatch.setattr(lockstep, "WAIT_TIMEOUT", 0.005)
    yield


def test_a_sample_is_stamped_with_its_tick_from_one_second_on_and_its_answer_acts_from_that_tick():
    served = Served(FakeWire([command(0)], [command(2)]))
    assert [(one.tick, one.tag) for one in (served.ask(0), served.ask(2))] == [(0, OBEYED_TAG), (2, OBEYED_TAG)]
    summary = served.close()
    assert served.wire.stamps == served.wire.applied == [1_000_000_000, 1_002_000_000]
    assert summary["samples"] == summary["commands"] == 2 and summary["deterministic"] and not summary["ignored"]


def test_older_newer_second_and_foreign_answers_are_counted_and_not_obeyed():
    wrong = SPEEDS * 9
    served = Served(
        FakeWire(
            [command(2)],
            # first a second answer to tick 2
            [command(2, wrong), command(0, wrong), command(6, wrong), command(4, wrong, obeyed=False), command(4)],
        )
    )
    served.ask(2)
    assert served.ask(4).values.tolist() == SPEEDS.tolist()
    ignored = served.close()["ignored"]
    assert ignored == {"second answer": 1, "older": 1, "newer": 1, "other publisher": 1}
    events = served.notes.texts("event")
    assert events[0] == "/robot_joint_command: a command 0.004 s older than the sample was ignored"
    assert "newer than the sample" in events[1] and "a second publisher" in events[2] and len(events) == 3


@pytest.mark.parametrize(
    ("bad", "expected"),
    [
        (command(0, np.array([1.0, np.nan, 3.0])), "a speed is not a finite number; asked again"),
        (command(0, np.full(3, np.nan), "2 velocities of m1, m2"), "2 velocities of m1, m2; asked again"),
    ],
)
def test_an_invalid_answer_is_an_event_and_the_sample_is_asked_again(bad: MotorCommand, expected: str):
    served = Served(FakeWire([bad], [command(0)]))
    assert served.ask(0).values.tolist() == SPEEDS.tolist()
    assert served.close()["resent"] == 1
    assert served.notes.texts("event") == [f"/robot_joint_command: {expected}"]


def test_an_unanswered_sample_is_written_again_until_it_is_answered():
    served = Served(FakeWire([], [], [command(0)]))
    served.ask(0)
    assert served.wire.stamps == [START_STAMP] * 3 and served.close()["resent"] == 2


def test_without_an_answer_the_run_is_given_up():
    served = Served(FakeWire(), answer=0.1)
    assert served.ask(0).tag == GIVE_UP_TAG
    served.close()


def test_unstamped_commands_answer_in_order_and_determinism_ends_with_a_repeated_sample():
    served = Served(FakeWire([command(None)], [command(None)]), stamped=False)
    served.ask(0)
    served.ask(1)
    assert served.close()["deterministic"]
    served = Served(FakeWire([command(None)], [], [command(None)]), stamped=False)
    served.ask(0)
    served.ask(1)
    assert not served.close()["deterministic"]
    assert any("not deterministic" in text for text in served.notes.texts("event"))


def test_second_answers_that_arrive_together_with_the_first_are_counted():
    wire = FakeWire([command(None), command(None, 9.0 * SPEEDS), command(None, obeyed=False)])
    wire.batch = 3
    served = Served(wire, stamped=False)
    assert served.ask(0).values.tolist() == SPEEDS.tolist()
    summary = served.close()
    assert not summary["deterministic"]
    assert summary["ignored"] == {"second answer": 1, "not deterministic": 1, "other publisher": 1}


def test_no_sample_is_asked_for_before_both_sides_are_connected():
    wire = FakeWire([command(0)])
    wire.has_controller = False
    served = Served(wire)
    served.mailbox.samples.put(0, np.zeros(width(SAMPLE_PORTS)))
    assert served.mailbox.commands.pop(0.1) is None and served.notes.texts("waiting") == ["waiting"]
    assert not served.notes.texts("ready")
    wire.has_controller = True
    found = served.mailbox.commands.pop(5.0)
    assert found is not None and found.tick == 0 and served.notes.texts("ready") == [True]
    served.close()
