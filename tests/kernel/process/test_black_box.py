"""The memory that outlives its writer."""

import io
import json
import os
import signal

import numpy as np
import pytest

from twin.kernel.cosim.delay import delay
from twin.kernel.cosim.port import Port
from twin.kernel.cosim.simulation import NO_COMPONENT, Simulation
from twin.kernel.cosim.system import System
from twin.kernel.process.black_box import INPUTS_AT, Announcer, BlackBox, Call, JobAccount, exit_phrase, failure_message
from twin.kernel.process.reporter import PipeReporter


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
    assert exit_phrase(status) == said


def test_a_call_that_has_returned_is_not_blamed():
    box, account = BlackBox(), JobAccount()
    announcer = Announcer(box.fd)
    announcer.announce_call("acme.fmu", "drive_1", "fmi2Instantiate")
    blamed = failure_message(account, box, "crashed", None, "")
    announcer.announce_call("acme.fmu", "drive_1", "")
    cleared = failure_message(account, box, "crashed", None, "")
    box.close()
    assert blamed.startswith(
        "acme.fmu (drive_1) crashed in fmi2Instantiate, before the first step. acme.fmu is unusable"
    )
    assert cleared == "the process of this job crashed between two steps, before the first step."


def test_only_the_end_of_what_was_printed_is_quoted():
    box = BlackBox()
    text = failure_message(JobAccount(), box, "crashed", None, "first line\n" + 1000 * "x" + "end\n\n")
    box.close()
    assert text.endswith(f"It printed last: '{197 * 'x'}end'.")


def test_who_reads_the_black_box_sees_the_last_step_and_its_inputs():
    box = BlackBox()
    first = delay("first", (Port("x", 2),), 1, np.array([1.5, -2.5]))
    second = delay("second", (Port("x", 2),), 1, np.array([0.25, 4.0]))
    system = System([first, second], [("second.x", "first.x"), ("first.x", "second.x")], 1e-3)
    memory = PipeReporter(io.StringIO(), box.fd).stepping(system, 10)
    assert box.mark() == (0, NO_COMPONENT)
    Simulation(system, 10, slice_ticks=1, memory=memory).advance()
    # tick 0: `first` read what `second` starts with, `second` what `first` then gave
    assert box.inputs(0, 4) == (0.25, 4.0, 1.5, -2.5)
    memory.mark[:] = 7, 1
    assert box.mark() == (7, 1)
    box.close()


def test_memory_of_a_simulation_is_there_after_a_smaller_one_has_begun():
    """A file that has become shorter would end the process here."""
    box = BlackBox()
    memories = []
    for size in (2000, 1):
        wide = delay("wide", (Port("x", size),), 1, np.zeros(size))
        system = System([wide], [("wide.x", "wide.x")], 1e-3)
        memories.append(PipeReporter(io.StringIO(), box.fd).stepping(system, 10))
    memories[0].u[:] = 1.0
    assert box.inputs(1999, 1) == (1.0,)
    box.close()


def test_an_account_knows_the_component_that_the_mark_points_to():
    box, pipe, account = BlackBox(), io.StringIO(), JobAccount()
    system = System([delay("only", (Port("x", 1, "N"),), 1, np.zeros(1))], [("only.x", "only.x")], 1e-3)
    memory = PipeReporter(pipe, box.fd).stepping(system, 10)
    account.update(json.loads(pipe.getvalue()))
    assert not account.is_busy(box)
    memory.mark[:] = 3, 0
    stepping = account.stepping(box)
    assert stepping is not None and (stepping.name, stepping.inputs) == ("only", (("x", 1, "N"),))
    box.close()


def test_a_call_is_known_from_before_it_is_made_until_it_has_returned():
    box = BlackBox()
    announcer = Announcer(box.fd)
    assert box.call() is None and not JobAccount().is_busy(box)
    announcer.announce_call("acme.fmu", "drive_1", "fmi2DoStep")
    assert box.call() == Call(1, "acme.fmu", "drive_1", "fmi2DoStep") and JobAccount().is_busy(box)
    announcer.announce_call("acme.fmu", "drive_1", "")
    assert box.call() is None
    # the same call once more is another one: it is not the first that takes so long
    announcer.announce_call("acme.fmu", "drive_1", "fmi2DoStep")
    assert box.call() == Call(2, "acme.fmu", "drive_1", "fmi2DoStep")
    box.close()


def test_a_call_with_endless_names_leaves_the_inputs_alone():
    box = BlackBox()
    Announcer(box.fd).announce_call(300 * "\u00fc", 300 * "\u00fc", 300 * "\u00fc")
    call = box.call()
    assert call is not None and call.function.startswith(100 * "\u00fc")
    assert len(os.pread(box.fd, 2 * INPUTS_AT, 0)) == INPUTS_AT
    box.close()
