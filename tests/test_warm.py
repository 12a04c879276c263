"""What the tests stand on: a forked guarded process is what a started one is."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.warm import Forked, WarmStart
from twin.kernel.process import process
from twin.kernel.process.guard import run_guarded

JOB = "tests.kernel.process.jobs:surroundings"


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere all are started")
def test_a_forked_process_finds_what_a_started_one_finds(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    # what they are forked from has begun elsewhere
    run_guarded(JOB, {})
    monkeypatch.chdir(tmp_path)
    forked = run_guarded(JOB, {})
    monkeypatch.setattr(process, "Popen", subprocess.Popen)
    assert forked == run_guarded(JOB, {})
    assert forked["parent"] == os.getpid() and forked["leads_its_session"]


def test_in_other_surroundings_than_the_tests_a_process_is_started(monkeypatch: pytest.MonkeyPatch):
    warm = WarmStart()
    monkeypatch.setenv("TWIN_CACHE", "elsewhere")
    monkeypatch.setattr(process, "Popen", warm)
    with process.GuardedProcess(JOB) as begun:
        assert not isinstance(begun._process, Forked)
