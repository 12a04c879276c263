"""Exchange of a served robot with its controller: in real time, and the job of the process of the topics."""

import contextlib
import time
from collections.abc import Callable
from threading import Thread
from typing import Any

import numpy as np

from twin.kernel.cosim.histogram import Histogram
from twin.kernel.cosim.port import port_slices, width
from twin.kernel.process.mailbox import IGNORED_TAG, OBEYED_TAG, Mailbox
from twin.kernel.process.real_time import real_time
from twin.kernel.process.reporter import PipeReporter
from twin.robot.remote import COMMAND_PORTS, SAMPLE_PORTS
from twin.studies.serve.lockstep import Lockstep
from twin.studies.serve.messages import MOTOR_COUNT, MotorCommand
from twin.studies.serve.wire import FOREIGN_TEXT, REPORT_PERIOD, WAIT_TIMEOUT, Wire, WireEvents

MAX_PENDING = 10_000
"""Maximum number of samples whose answers are awaited for the count of lost commands."""
_COMMANDED_SPEEDS, _AGE = (port_slices(SAMPLE_PORTS)[name] for name in ("omega_ref", "age"))


class FreeExchange:
    """Exchange in real time: samples are published as they come, commands are passed on as they arrive."""

    def __init__(self, wire: Wire, mailbox: Mailbox, events: WireEvents, reporter: PipeReporter):
        self._wire, self._mailbox, self._events, self._reporter = wire, mailbox, events, reporter
        # stamps are wall time, by a clock that cannot be set back
        self._offset = time.time_ns() - time.monotonic_ns()
        self._newest: int | None = None
        self._obeyed: list[int] = []
        self._arrived: dict[int, int] = {}
        self._published: dict[int, int] = {}
        self._samples = self._commands = self._answers = self._first = self._last = 0
        self._latency = Histogram()
        self._applied, self._speeds = 0, np.zeros(MOTOR_COUNT)
        self._failure: BaseException | None = None

    def run(self) -> dict[str, Any]:
        """Exchange samples and commands until the run has ended; return the summary."""
        self._reporter.note(ready=True)
        reported = time.monotonic()
        threads = [
            Thread(target=self._repeat_step, args=(step,), name=name, daemon=True)
            for name, step in (("commands", self._receive), ("samples", self._publish))
        ]
        for one in threads:
            one.start()
        # existing threads get the higher priority; they are not pinned, since others of twin share the machine. Each is
        # done in less than the interval and then waits: switching in the middle doubles the processor time of both
        with real_time(switch_interval=WAIT_TIMEOUT) as refused:
            while not self._mailbox.is_closed and self._failure is None:
                time.sleep(WAIT_TIMEOUT)
                if not self._commands and time.monotonic() > reported + REPORT_PERIOD:
                    reported = time.monotonic()
                    self._reporter.note(waiting=self._wire.waiting_text())
            for one in threads:
                one.join(1.0)
        if self._failure is not None:
            raise self._failure
        return self._summary([refused] if refused else [])

    def _repeat_step(self, step: Callable[[], None]) -> None:
        try:
            while not self._mailbox.is_closed:
                step()
        except BaseException as problem:
            self._failure = problem

    def _publish(self) -> None:
        if (entry := self._mailbox.samples.pop(WAIT_TIMEOUT)) is None:
            return
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
        speeds, age, newer = entry.values[_COMMANDED_SPEEDS], float(entry.values[_AGE][0]), entry.tag != self._applied
        if newer or not np.array_equal(speeds, self._speeds, equal_nan=True):
            # a command may take effect between two samples
            self._wire.write_applied(stamp - (round(1e9 * age) if newer else 0), speeds)
        if newer:
            self._applied = entry.tag
            # older ones were superseded before a tick
            for number in [n for n in list(self._arrived) if n < entry.tag]:
                del self._arrived[number]
        if age > 0.0 and (arrived := self._arrived.pop(entry.tag, None)) is not None:
            self._latency.add(1e-9 * (written - arrived))
        self._speeds = speeds

    def _receive(self) -> None:
        for command in self._wire.receive(WAIT_TIMEOUT):
            self._pass_on(command, time.monotonic_ns())

    def _pass_on(self, command: MotorCommand, arrived: int) -> None:
        obeyed = self._wire.publishers.matched[:1]
        if obeyed != self._obeyed:
            # another node has a clock of its own
            self._obeyed, self._newest = obeyed, None
        if self._is_refused(command):
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

    def _is_refused(self, command: MotorCommand) -> bool:
        """Whether a command is not obeyed; counts it."""
        topic = self._wire.command_topic
        if not command.obeyed:
            self._events.add("other publisher", f"{topic}: {FOREIGN_TEXT}")
        elif command.mistake:
            self._events.add("invalid", f"{topic}: {command.mistake}")
        elif self._newest is not None and command.stamp is not None and command.stamp < self._newest:
            late = 1e-6 * (self._newest - command.stamp)
            self._events.add("old", f"{topic}: a command {late:.3g} ms older than the newest was dropped")
        else:
            return False
        return True

    def _summary(self, notes: list[str]) -> dict[str, Any]:
        times = (
            ("p50", self._latency.quantile(0.5)),
            ("p99", self._latency.quantile(0.99)),
            ("largest", self._latency.largest),
        )
        latency = {"latency_ms": {name: 1e3 * time for name, time in times}} if self._latency.count else {}
        asked = self._last - self._first + 1 if self._answers else 0
        return {
            "samples": self._samples, "lost": self._mailbox.samples.lost, "unwritten": self._wire.unwritten,
            "commands": self._commands, "ignored": self._events.counts, "unanswered": asked - self._answers,
            **self._wire.ends(), **latency, "notes": notes,
        }  # fmt: skip


def exchange(reporter: PipeReporter, settings: dict[str, Any]) -> dict[str, Any]:
    """Exchange messages with a controller until the simulation closes the mailbox; return a summary.

    Args:
        reporter: reporter of this process; its black box has the mailbox.
        settings: fields of `session.ServeOptions`, tick_s, counts_m and counts_l per turn, has_effort, has_scale.
    """
    events = WireEvents(reporter)
    wire = Wire(settings, events)
    mailbox = Mailbox(reporter.box, width(SAMPLE_PORTS), width(COMMAND_PORTS))
    if settings["lockstep"]:
        return Lockstep(wire, mailbox, events, reporter, settings).run()
    return FreeExchange(wire, mailbox, events, reporter).run()
