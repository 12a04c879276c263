"""A job in a guarded process: what comes back, and what is made of every way to end."""

import _thread
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from twin.kernel.errors import TwinError
from twin.kernel.process import guard
from twin.kernel.process.guard import JobFailure, JobLoadFailure, run_guarded
from twin.kernel.process.job import JobLimits
from twin.studies.identify.identification import NotIdentifiable

JOBS = "tests.kernel.process.jobs"


@pytest.mark.slow
def test_a_job_gives_back_its_result_and_its_notes():
    notes: list[dict[str, Any]] = []
    # a float that has no short decimal form comes back as it went
    arguments = {"numbers": [1, 0.1 + 0.2, -0.0], "text": "Nm/°"}
    assert run_guarded(f"{JOBS}:echo", arguments, listen=notes.append) == arguments
    assert notes == [{"name": "numbers"}, {"name": "text"}]


def test_an_error_for_the_user_keeps_its_class_its_text_and_its_exit_code():
    with pytest.raises(NotIdentifiable) as refused:
        run_guarded(f"{JOBS}:refuse", {})
    assert (str(refused.value), refused.value.exit_code) == ("drive.fmu: is a teapot", NotIdentifiable.exit_code)


def test_a_line_that_is_printed_again_and_again_is_shown_once(capfd: pytest.CaptureFixture[str]):
    assert run_guarded(f"{JOBS}:chatter", {"lines": ["hello"] * 6 + ["", ""] + ["bye", "hello"]}) == "done"
    assert capfd.readouterr().err == "hello  (6 times)\n\nbye\nhello\n"


def test_arguments_keep_their_types():
    assert run_guarded(f"{JOBS}:typed", {"path": Path("a"), "pair": (1, 2)}) == ["PosixPath", "tuple"]


def test_a_mistake_of_ours_shows_its_traceback():
    with pytest.raises(TwinError, match=r"(?s)Traceback.*in blunder.*a mistake of ours") as failed:
        run_guarded(f"{JOBS}:blunder", {})
    assert failed.value.exit_code == 70


def test_exit_code_0_without_a_result_is_a_death():
    with pytest.raises(JobLoadFailure) as died:
        run_guarded(f"{JOBS}:vanish", {})
    said = "the process of this job ended the process with exit(0) between two steps, before the first step."
    assert str(died.value) == f"{said} It printed last: 'so long'."


@pytest.mark.slow
def test_a_job_is_ended_at_its_time_limit():
    with pytest.raises(JobLoadFailure, match="the time limit of 2 s was over"):
        run_guarded(f"{JOBS}:linger", {"farewell": ""}, JobLimits(wall=2.0))


@pytest.mark.slow
def test_what_is_compiled_within_a_call_is_not_charged_to_it():
    assert run_guarded(f"{JOBS}:compile_within_a_call", {"seconds": 2.0}, JobLimits(step=0.2)) == "done"


@pytest.mark.slow
def test_a_call_that_waits_for_ever_is_ended_too():
    with pytest.raises(JobLoadFailure, match=r"^a.fmu \(it\) did not return within 0.25 s in fmi2DoStep, before"):
        run_guarded(f"{JOBS}:sleep_within_a_call", {}, JobLimits(step=0.25))


def test_a_simulation_that_would_take_too_long_is_ended_as_soon_as_that_is_known(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(guard, "MIN_ESTIMATE_TIME", 0.5)
    began = time.monotonic()
    with pytest.raises(
        JobFailure, match=r"\(crawler\) was at work when .* take about \d\d hours .* --yes runs it anyway"
    ) as ended:
        run_guarded(f"{JOBS}:crawl", {"ticks": 20_000_000}, JobLimits(expected=3600.0))
    # 20 s of more than a day
    assert time.monotonic() - began < 20.0 and ended.value.exit_code == 3


@pytest.mark.parametrize("stubborn", [False, True])
def test_ctrl_c_asks_the_job_to_stop_and_waits_only_so_long(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, stubborn: bool
):
    # it steps nothing; what steps a system has longer
    monkeypatch.setattr(guard, "UNSTEPPED_STOP_TIMEOUT", 0.5 if stubborn else 60.0)
    farewell = tmp_path / "farewell"
    began = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        run_guarded(
            f"{JOBS}:linger",
            {"farewell": str(farewell), "stubborn": stubborn},
            listen=lambda note: _thread.interrupt_main(),
        )
    assert farewell.exists()
    # far from both 60 s of grace and the 1000 s that the job sleeps
    assert time.monotonic() - began < 30


def test_the_supervisor_of_a_run_loads_no_numerics(root: Path):
    code = (
        "import sys, twin.cli.run; print({'numpy', 'numba', 'fmpy', 'mcap', 'pydantic', 'ctypes'} & set(sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=root, capture_output=True, text=True, check=True)
    assert done.stdout == "set()\n"


@pytest.mark.slow
def test_a_process_that_works_beside_others_starts_one_thread_for_sums_unless_the_user_says_otherwise(
    monkeypatch: pytest.MonkeyPatch,
):
    name = "OPENBLAS_NUM_THREADS"
    monkeypatch.delenv(name, raising=False)
    assert run_guarded(f"{JOBS}:variable", {"name": name}) == "1"
    monkeypatch.setenv(name, "2")
    assert run_guarded(f"{JOBS}:variable", {"name": name}) == "2"
