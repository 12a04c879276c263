"""A process of the topics without topics: it answers samples from a table, and misbehaves as it is told."""

import json
import os
import time
from typing import Any

import numpy as np

from twin.kernel.cosim.port import width
from twin.kernel.process.mailbox import GIVE_UP_TAG, IGNORED_TAG, Mailbox
from twin.kernel.process.reporter import PipeReporter
from twin.robot.remote import COMMAND_PORTS, SAMPLE_PORTS

JOB = "tests.studies.serve.answers:exchange"
TOLD = "TWIN_TEST_ANSWERS"
"""Environment variable with JSON: `table`, a .npy file of commands by tick; ticks at which it does something else."""


def exchange(reporter: PipeReporter, settings: dict[str, Any]) -> dict[str, Any]:
    """Answer samples until the run is over.

    Ticks: `stalls` answers `seconds` late, or never if they are not given, `gives_up`, `dies`, `ignores` puts a command
    that is not obeyed first.
    """
    told = json.loads(os.environ[TOLD])
    mailbox = Mailbox(reporter.box, width(SAMPLE_PORTS), width(COMMAND_PORTS))
    table = np.load(told["table"]) if "table" in told else np.zeros((1, 3))
    reporter.note(waiting="waiting for nobody")
    reporter.note(ready=True)
    samples = 0
    while not mailbox.is_closed:
        sample = mailbox.samples.pop(0.05)
        if sample is None:
            continue
        samples += 1
        if sample.tick == told.get("stalls"):
            until = time.monotonic() + told.get("seconds", 1e9)
            while time.monotonic() < until and not mailbox.is_closed:
                time.sleep(0.05)
        if sample.tick == told.get("dies"):
            os._exit(7)
        if sample.tick == told.get("ignores"):
            mailbox.commands.put(sample.tick, [9.0] * 3, IGNORED_TAG)
            reporter.note(event="a command of somebody else", tick=sample.tick)
        tag = GIVE_UP_TAG if sample.tick == told.get("gives_up") else 0
        answers = sample.tick if settings["lockstep"] else -1
        mailbox.commands.put(answers, table[min(sample.tick, len(table) - 1)], tag)
    return {"samples": samples, "settings": settings, "notes": ["answered from a table"]}
