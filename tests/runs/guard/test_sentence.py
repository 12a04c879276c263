"""Sentences about jobs that could not say goodbye."""

import signal

import pytest

from twin.runs.guard.account import Account
from twin.runs.guard.black_box import Announcer, BlackBox
from twin.runs.guard.sentence import failure_sentence, manner


@pytest.mark.parametrize(
    ("status", "said"),
    [
        (-signal.SIGSEGV, "crashed (SIGSEGV, segmentation fault)"),
        (-signal.SIGFPE, "crashed (SIGFPE, floating point exception)"),
        (-signal.SIGABRT, "aborted the process (SIGABRT)"),
        (-signal.SIGKILL, "was killed from outside (SIGKILL; the machine may have run out of memory)"),
        (3, "ended the process with exit(3)"),
    ],
)
def test_the_manner_of_an_end_names_signal_or_status(status: int, said: str):
    assert manner(status) == said


def test_a_call_that_has_returned_is_not_blamed():
    box, account = BlackBox(), Account()
    announcer = Announcer(box.fd)
    announcer.tell("acme.fmu", "drive_1", "fmi2Instantiate")
    blamed = failure_sentence(account, box, "crashed", None, "")
    announcer.tell("acme.fmu", "drive_1", "")
    cleared = failure_sentence(account, box, "crashed", None, "")
    box.close()
    assert blamed.startswith(
        "acme.fmu (drive_1) crashed in fmi2Instantiate, before the first step. acme.fmu is not fit"
    )
    assert cleared == "the process of this job crashed between two steps, before the first step."


def test_only_the_end_of_what_was_printed_is_quoted():
    box = BlackBox()
    text = failure_sentence(Account(), box, "crashed", None, "first line\n" + 1000 * "x" + "end\n\n")
    box.close()
    assert text.endswith(f"It printed last: '{197 * 'x'}end'.")
