"""How another Python is started: it finds this package, and not what lies in the current folder."""

import os
import subprocess
import sys
import sysconfig
from pathlib import Path

import pytest

from twin.cli.ahead import RUN_JOB, start_expected_job
from twin.kernel.process import process as ahead
from twin.kernel.process import process as interpreter
from twin.kernel.process.process import (
    end_waiting,
    environment,
    module_command,
    process_for,
    start_ahead,
)


def test_empty_entries_of_the_search_path_which_mean_the_current_folder_are_left_out(root: Path, monkeypatch):
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(["", "/a", "", "/b"]))
    assert environment()["PYTHONPATH"] == os.pathsep.join([str(root), "/a", "/b"])


def test_installed_packages_do_not_come_before_the_standard_library(monkeypatch: pytest.MonkeyPatch):
    packages = sysconfig.get_path("purelib")
    monkeypatch.setattr(interpreter.twin, "__file__", f"{packages}/twin/__init__.py")
    monkeypatch.delenv("PYTHONPATH", raising=False)
    assert environment()["PYTHONPATH"] == ""


def test_the_package_is_found_from_any_folder_and_the_folder_is_not_searched(tmp_path: Path):
    (tmp_path / "json.py").write_text("raise SystemExit('imported from the current folder')")
    command = module_command("twin", "--version")
    assert command[0] == sys.executable
    done = subprocess.run(command, cwd=tmp_path, env=environment(), capture_output=True, text=True)
    assert done.stdout.startswith("twin "), done.stderr


@pytest.fixture(autouse=True)
def nobody_waits():
    yield
    assert not ahead._waiting
    end_waiting()


def test_who_asks_for_the_job_gets_the_process_that_waits():
    start_ahead(RUN_JOB)
    waiting = ahead._waiting[RUN_JOB]
    with process_for(RUN_JOB) as process:
        assert process is waiting and not process.has_exit_status


def test_who_asks_for_another_job_gets_a_new_one_and_none_waits_any_more():
    start_ahead(RUN_JOB)
    waiting = ahead._waiting[RUN_JOB]
    with process_for("json:dumps") as process:
        assert process is not waiting and waiting.has_exit_status


@pytest.mark.parametrize(
    ("words", "begins"),
    [
        (["run", "fig4"], True),
        (["run", "fig4", "--json", "--isolate", "drive"], True),
        (["run"], False),
        (["run", "--help"], False),
        (["run", "fig4", "--live"], False),
        (["run", "fig4", "--isolate", "none"], False),
        (["compare", "run"], False),
        (["report", "fig4"], True),
        (["report"], False),
        (["report", "--help"], False),
        (["report", "fig4", "--budget"], False),
        (["report", *"abcdefg"], False),
        (["sweep", "gains.toml"], True),
        (["sweep", "run", "gains.toml", "-j", "2"], True),
        (["sweep", "show", "gains"], False),
        (["sweep", "gains.toml", "--engine", "dask"], False),
        (["sweep"], False),
        ([], False),
    ],
)
def test_what_looks_like_a_run_a_picture_or_a_sweep_begins_one(
    monkeypatch: pytest.MonkeyPatch, words: list[str], begins: bool
):
    monkeypatch.setattr("sys.argv", ["twin", *words])
    monkeypatch.setattr("twin.cli.ahead.cores", lambda: 2)
    with start_expected_job():
        waiting = list(ahead._waiting.values())
        assert bool(waiting) == begins
    assert all(process.has_exit_status for process in waiting)


def test_on_one_core_nothing_begins_that_can_be_done_as_well_later(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("sys.argv", ["twin", "report", "fig4"])
    monkeypatch.setattr("twin.cli.ahead.cores", lambda: 1)
    with start_expected_job():
        assert not ahead._waiting


def test_where_a_stream_is_closed_nothing_begins(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("sys.argv", ["twin", "run", "fig4"])
    monkeypatch.setattr("sys.stdin", None)
    with start_expected_job():
        assert not ahead._waiting


def test_what_hinders_it_is_told_when_it_is_needed(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("sys.argv", ["twin", "run", "fig4"])
    monkeypatch.setattr(
        "twin.kernel.process.process.start_ahead", lambda job: (_ for _ in ()).throw(OSError("too many processes"))
    )
    with start_expected_job():
        pass
