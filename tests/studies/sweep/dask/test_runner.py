import time
from pathlib import Path

import pytest

from twin.runs.guard.limits import JobLimits
from twin.studies.sweep.dask import file_store, runner
from twin.studies.sweep.dask.bundle import Bundle
from twin.studies.sweep.dask.runner import difference, versions
from twin.studies.sweep.plan import Task
from twin.studies.sweep.pool import Job


def test_a_runner_that_nobody_uses_any_more_is_closed(root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("TWIN_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(runner, "IDLE", 0.01)
    experiment = root / "experiments" / "fig4_position.toml"
    bundle = Bundle(experiment)
    file_store.keep(bundle.contents)
    sweep = runner.SweepJob("mine", versions(), bundle.manifest, Job(experiment, tmp_path, "none", JobLimits(), ""))
    runner._runners["mine"] = mine = runner.Runner(sweep, str(tmp_path))
    assert list(tmp_path.glob("twin_runner_*"))
    mine.results([])
    deadline = time.monotonic() + 30.0
    while "mine" in runner._runners or list(tmp_path.glob("twin_runner_*")):
        assert time.monotonic() < deadline
        time.sleep(0.01)
    # a batch that arrives in that moment comes back undone
    assert mine.results([Task(1, "", None, {}, ())]) == []


def test_versions_that_differ_are_named_and_equal_ones_are_not():
    ours = {"numba": "0.61.0", "Python": "3.11"}
    assert difference("worker a", ours, ours) == ""
    told = difference("worker a", {"Python": "3.11"}, ours)
    assert told == "worker a has numba none, this machine has 0.61.0"
