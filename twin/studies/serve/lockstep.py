"""Lockstep protocol of a served robot: the simulation waits for the controller's answer to each sample.

1. Wait until a reader of joint states and a writer of commands are connected.
2. At each tick at which the controller is due, write wrench, clock and joint states with the tick's stamp s.
3. Wait for a command with stamp s. Older and newer ones, second answers and other publishers are counted and ignored;
   an invalid command is an event, and the sample is written again.
4. Without an answer, write the same sample again every second; after the answer timeout, give up.
5. The command acts from tick s on and is held to the next.
6. Unstamped commands answer samples in order; a second answer to a sample ends determinism.
"""

import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from twin.kernel.process.mailbox import GIVE_UP_TAG, IGNORED_TAG, OBEYED_TAG, Mailbox, MailboxEntry
from twin.kernel.process.reporter import PipeReporter
from twin.studies.serve.messages import NS_PER_SECOND, MotorCommand
from twin.studies.serve.wire import FOREIGN_TEXT, REPORT_PERIOD, WAIT_TIMEOUT, Wire, WireEvents

START_STAMP = NS_PER_SECOND
"""Stamp of tick 0 (ns), since ROS reads time 0 as a clock that has not started."""
REPEAT_PERIOD = 1.0
"""Time (s) without an answer after which a sample is written again."""
MAX_INVALID = 100
"""Number of invalid answers to a sample after which it is only written again once per `REPEAT_PERIOD`."""


class Lockstep:
    """The wire's side of the protocol; for `settings` see `exchange`."""

    def __init__(
        self, wire: Wire, mailbox: Mailbox, events: WireEvents, reporter: PipeReporter, settings: Mapping[str, Any]
    ):
        self._wire, self._mailbox, self._events, self._reporter = wire, mailbox, events, reporter
        self._tick_ns, self._answer_timeout = round(1e9 * settings["tick_s"]), settings["answer_s"]
        self._stamped = settings["commands"] == "joint"
        self._samples = self._commands = self._resent = 0
        self._answered, self._reported = -1, 0.0
        self._deterministic = True

    def run(self) -> dict[str, Any]:
        """Connect, and exchange samples and commands until the run has ended; return the summary."""
        while not (self._wire.has_controller or self._mailbox.is_closed):
            self._report_each_second(self._wire.waiting_text)
            time.sleep(0.01)
        self._reporter.note(ready=True)
        while not self._mailbox.is_closed:
            entry = self._mailbox.samples.pop(WAIT_TIMEOUT)
            if entry is None:
                self._count_extra(self._wire.receive(0.0))
            elif not self._exchange(entry):
                break
        return {
            "samples": self._samples, "commands": self._commands, "resent": self._resent,
            "ignored": self._events.counts, **self._wire.ends(), "deterministic": self._deterministic, "notes": [],
        }  # fmt: skip

    def _exchange(self, entry: MailboxEntry) -> bool:
        """Write a sample and wait for its answer; return whether the run continues."""
        stamp = START_STAMP + entry.tick * self._tick_ns
        self._count_extra(self._wire.receive(0.0))
        self._wire.write_sample(stamp, entry)
        self._samples += 1
        begun = repeated = self._reported = time.monotonic()
        invalid = 0
        while not self._mailbox.is_closed:
            found = self._wire.receive(WAIT_TIMEOUT)
            for number, command in enumerate(found):
                if self._is_ignored(command, stamp, entry.tick):
                    self._mailbox.commands.put(entry.tick, command.speeds, IGNORED_TAG)
                elif command.mistake or not np.isfinite(command.speeds).all():
                    self._mailbox.commands.put(entry.tick, command.speeds, IGNORED_TAG)
                    wrong = command.mistake or "a speed is not a finite number"
                    self._events.add("invalid", f"{self._wire.command_topic}: {wrong}; asked again", entry.tick)
                    invalid += 1
                    if invalid < MAX_INVALID:
                        self._repeat()
                else:
                    self._mailbox.commands.put(entry.tick, command.speeds, OBEYED_TAG)
                    self._wire.write_applied(stamp, command.speeds)
                    self._commands, self._answered = self._commands + 1, stamp
                    self._count_extra(found[number + 1 :])
                    return True
            now = time.monotonic()
            if now - begun > self._answer_timeout:
                self._mailbox.commands.put(entry.tick, np.zeros(self._mailbox.commands.values), GIVE_UP_TAG)
                return False
            if now - repeated > REPEAT_PERIOD:
                repeated = now
                self._repeat()
            self._report_each_second(lambda: f"no answer at {1e-9 * stamp:.3f} s; {self._wire.waiting_text()}")
        return False

    def _report_each_second(self, text: Callable[[], str]) -> None:
        if time.monotonic() - self._reported > REPORT_PERIOD:
            self._reported = time.monotonic()
            self._reporter.note(waiting=text())

    def _is_ignored(self, command: MotorCommand, stamp: int, tick: int) -> bool:
        """Whether a command is not the answer to the sample with the stamp `stamp` (ns); counts it."""
        topic, own = self._wire.command_topic, command.stamp
        if not command.obeyed:
            self._events.add("other publisher", f"{topic}: {FOREIGN_TEXT}", tick)
        elif own is None or own == stamp:
            return False
        elif own == self._answered:
            self._events.counts["second answer"] += 1
        else:
            age = "older" if own < stamp else "newer"
            apart = 1e-9 * abs(own - stamp)
            self._events.add(age, f"{topic}: a command {apart:.6g} s {age} than the sample was ignored", tick)
        return True

    def _repeat(self) -> None:
        self._resent += 1
        self._wire.repeat_sample()
        if not self._stamped:
            self._lose_determinism("a sample was written again")

    def _count_extra(self, found: Sequence[MotorCommand]) -> None:
        """Count commands that arrived while no sample awaited an answer."""
        for command in found:
            self._mailbox.commands.put(-1, command.speeds, IGNORED_TAG)
            if not command.obeyed:
                self._events.add("other publisher", f"{self._wire.command_topic}: {FOREIGN_TEXT}")
                continue
            self._events.counts["second answer"] += 1
            if not self._stamped:
                self._lose_determinism("a sample had a second answer")

    def _lose_determinism(self, why: str) -> None:
        if self._deterministic:
            self._deterministic = False
            text = f"{self._wire.command_topic}: not deterministic: {why}, and commands have no stamps"
            self._events.add("not deterministic", text)
