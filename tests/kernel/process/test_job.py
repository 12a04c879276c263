"""When a call or a job has taken too long, by a clock of our own."""

import math
import os
import signal
import subprocess
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace

import pytest

from twin.kernel.process import guard
from twin.kernel.process.black_box import Announcer, BlackBox, Call
from twin.kernel.process.guard import JobLoadFailure, Watchdog
from twin.kernel.process.job import MAX_WAIT_RATIO, JobLimits, interrupt_message
from twin.kernel.process.process import GuardedProcess

STEP = 10.0


@dataclass
class Box:
    """A job in the middle of a call."""

    compiling: float = 0.0

    def mark(self) -> tuple[int, int]:
        return 0, -1

    def call(self) -> Call:
        return Call(1, "a.fmu", "it", "fmi2DoStep")

    def compile_time(self) -> float:
        return self.compiling


@dataclass
class Process:
    """That of a job, with clocks that the test sets."""

    box: Box = field(default_factory=Box)
    age: float = 0.0
    processor_time: float = 0.0
    gone: bool = False
    memory: int = 0
    output_tail: str = ""
    is_waiting: bool = False

    def end(self) -> int:
        self.gone = True
        return -9


class Bench:
    """A watched call."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, limits: JobLimits):
        self.process = Process()
        monkeypatch.setattr(guard, "time", SimpleNamespace(monotonic=lambda: self.process.age))
        self.watch = Watchdog(self.process, limits)  # type: ignore[arg-type]
        self.watch.raise_if_over()

    def pass_time(self, seconds: float, processor: float, compiling: float = 0.0) -> None:
        """So much of it, of which so much on a processor, and compiling."""
        for _ in range(round(seconds)):
            self.process.age += 1.0
            self.process.processor_time += processor / seconds
            self.process.box.compiling += compiling / seconds
            self.watch.raise_if_over()


def test_a_call_that_computes_is_ended_at_the_limit(monkeypatch: pytest.MonkeyPatch):
    bench = Bench(monkeypatch, JobLimits(step=STEP))
    bench.pass_time(STEP, STEP)
    with pytest.raises(JobLoadFailure, match="did not return within 10 s in fmi2DoStep"):
        bench.pass_time(2.0, 2.0)


def test_a_call_that_gets_a_hundredth_of_a_processor_is_no_slower_for_that(monkeypatch: pytest.MonkeyPatch):
    Bench(monkeypatch, JobLimits(step=STEP)).pass_time(100.0 * STEP, STEP)


def test_many_threads_at_once_are_not_slower_than_one(monkeypatch: pytest.MonkeyPatch):
    Bench(monkeypatch, JobLimits(step=STEP)).pass_time(0.9 * STEP, 8.0 * STEP)


def test_a_call_that_waits_is_ended_too(monkeypatch: pytest.MonkeyPatch):
    bench = Bench(monkeypatch, JobLimits(step=STEP))
    bench.process.is_waiting = True
    bench.pass_time(MAX_WAIT_RATIO * STEP, 0.0)
    with pytest.raises(JobLoadFailure, match="did not return within 10 s in fmi2DoStep"):
        bench.pass_time(2.0, 0.0)


def test_where_nobody_tells_of_the_processor_the_clock_decides(monkeypatch: pytest.MonkeyPatch):
    bench = Bench(monkeypatch, JobLimits(step=STEP))
    bench.process.processor_time = math.inf
    with pytest.raises(JobLoadFailure, match="did not return within 10 s"):
        bench.pass_time(STEP + 2.0, 0.0)


def test_compiling_is_outside_all_limits(monkeypatch: pytest.MonkeyPatch):
    bench = Bench(monkeypatch, JobLimits(step=STEP, wall=60.0))
    bench.pass_time(300.0, 300.0, compiling=300.0)
    # and the call has its whole time afterwards
    bench.pass_time(STEP, STEP)


def test_a_job_is_ended_when_its_time_without_compiling_is_over(monkeypatch: pytest.MonkeyPatch):
    bench = Bench(monkeypatch, JobLimits(wall=60.0))
    bench.pass_time(300.0, 300.0, compiling=270.0)
    with pytest.raises(JobLoadFailure, match="time limit of 60 s was over"):
        bench.pass_time(100.0, 100.0, compiling=50.0)


def test_the_writer_of_the_box_tells_how_long_it_compiles():
    box = BlackBox()
    teller = Announcer(box.fd)
    assert box.compile_time() == 0.0
    teller.compiling(True)
    while box.compile_time() == 0.0:
        pass
    teller.compiling(False)
    done = box.compile_time()
    assert box.compile_time() == done > 0.0
    box.close()


@pytest.mark.slow
def test_a_process_that_computes_gets_older_on_its_processor():
    with GuardedProcess("tests.kernel.process.jobs:spin") as process:
        process.start({})
        began = process.processor_time
        assert math.isfinite(began)
        while process.processor_time < began + 0.05:
            pass
        # it is ready for a processor, whether it has one or not
        assert not process.is_waiting
    with GuardedProcess("tests.kernel.process.jobs:sleep_within_a_call") as process:
        process.start({})
        while process.box.call() is None or not process.is_waiting:
            pass
    assert process.processor_time == math.inf


LOST = """
import sys, time
from twin.kernel.process.job import retry_lost_interrupts

class Kept:
    def __del__(self):
        raise {error}

retry_lost_interrupts()
try:
    Kept()
    # without the hook nobody would end this
    time.sleep(1.0)
    print("went on")
except KeyboardInterrupt:
    print("interrupted")
"""


def _said(error: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-c", LOST.format(error=error)], capture_output=True, text=True, timeout=60)


def test_an_interrupt_in_a_finaliser_ends_the_program_and_prints_nothing():
    said = _said("KeyboardInterrupt")
    assert (said.stdout, said.stderr) == ("interrupted\n", "")


@pytest.mark.slow
def test_other_errors_of_a_finaliser_are_printed_as_ever():
    said = _said("ValueError('odd')")
    assert said.stdout == "went on\n" and "ValueError: odd" in said.stderr


@pytest.mark.skipif(os.name != "posix", reason="Ctrl-C is sent as a signal")
@pytest.mark.parametrize("moment", ["twin.cli.ahead", "twin.cli.app", "twin.cli.run"])
def test_ctrl_c_while_the_commands_are_imported_is_one_word(moment, tmp_path):
    # at a moment that no clock could hit
    interrupting = f"""
import os, signal, sys
class Ctrl:
    def find_spec(self, name, path=None, target=None):
        if name == {moment!r}:
            os.kill(os.getpid(), signal.SIGINT)
sys.meta_path.insert(0, Ctrl())
sys.argv = ["twin", "run", "fig4_position"]
from twin.cli import main
main()
"""
    said = subprocess.run(
        [sys.executable, "-c", interrupting], capture_output=True, text=True, timeout=60, cwd=tmp_path
    )
    assert (said.returncode, said.stdout, said.stderr) == (130, "", "interrupted\n")


@pytest.mark.skipif(os.name != "posix", reason="Ctrl-C is sent as a signal")
def test_a_waiting_main_thread_is_woken():
    code = "import threading, time\nfrom twin.kernel.process.job import interrupt_main\n"
    code += "threading.Timer(0.1, interrupt_main).start()\ntime.sleep(30)"
    began = time.monotonic()
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert said.returncode == -signal.SIGINT and time.monotonic() - began < 20.0


def test_what_was_recorded_is_named_and_an_empty_folder_goes(tmp_path: Path):
    folder = tmp_path / "run"
    folder.mkdir()
    (folder / "run.mcap").touch()
    assert interrupt_message(folder) == f"interrupted; the recording is complete: {folder}/run.mcap"
    (folder / "run.mcap").rename(folder / "run.mcap.partial")
    until_then = f"interrupted; recorded until then: {folder}/run.mcap.partial"
    assert interrupt_message(folder) == f"{until_then}; continue with: twin run --from {folder}"
    assert interrupt_message(folder, "the same command and").endswith(
        f"continue with: the same command and --from {folder}"
    )
    (folder / "run.mcap.partial").unlink()
    (folder / "notes").touch()
    assert interrupt_message(folder) == "interrupted before the first step; nothing is recorded" and folder.exists()
    (folder / "notes").unlink()
    interrupt_message(folder)
    assert not folder.exists()
