"""Workers that do not see the files of a sweep, or see others."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

from tests.studies.sweep.definitions import job, stiffnesses
from twin.kernel.errors import InputRefused
from twin.studies.sweep.dask.worker import SweepPlugin
from twin.studies.sweep.engine import Job
from twin.studies.sweep.plan import SweepPlan, Task, files_digest, text_settings
from twin.studies.sweep.stored import SWEEP_FILE


@pytest.fixture
def plan(root: Path, tmp_path: Path) -> SweepPlan:
    (tmp_path / SWEEP_FILE).touch()
    return stiffnesses(root, tmp_path, "[500]")


def plugin(common: Job) -> SweepPlugin:
    """In a worker at a:1."""
    made = SweepPlugin("sweep", common)
    made.setup(SimpleNamespace(address="tcp://a:1"))  # type: ignore[arg-type]
    return made


def refusal(common: Job, task: Task) -> str:
    worker = plugin(common)
    try:
        with pytest.raises(InputRefused) as refused:
            worker.results([task])
    finally:
        worker.teardown(None)  # type: ignore[arg-type]
    return str(refused.value)


@pytest.mark.parametrize("missing", ["here", "sweep"])
def test_a_worker_that_shares_no_folder_is_refused_by_name(plan: SweepPlan, tmp_path: Path, missing: str):
    common = job(plan, tmp_path / "runs")
    if missing == "here":
        common = replace(common, here=tmp_path / "elsewhere")
    else:
        (tmp_path / SWEEP_FILE).unlink()
    said = refusal(common, plan.tasks[0])
    assert said.startswith(f"--engine dask: worker tcp://a:1 does not see {tmp_path}")
    assert "needs a folder that all machines share" in said


def test_a_worker_that_reads_other_files_is_refused_by_name_and_one_with_the_same_runs(plan: SweepPlan, tmp_path: Path):
    (task,) = plan.tasks
    files = task.drive, text_settings(task.settings)
    common = replace(job(plan, tmp_path / "runs"), files={files: "of another FMU"})
    assert refusal(common, task).startswith(f"worker tcp://a:1: {plan.experiment}: reads other files here")
    worker = plugin(replace(common, files={files: files_digest(plan.experiment, *files)}))
    try:
        ((run, facts),) = worker.results([task])
    finally:
        worker.teardown(None)  # type: ignore[arg-type]
    assert (run, facts["status"]) == (task.run, "done")
    # a sweep that has ended makes no run
    assert worker.results([task]) == []


def test_the_hash_of_files_is_of_what_texts_name_and_not_of_numbers(root: Path):
    path = root / "experiments/fig4_force_position.toml"
    plain = files_digest(path, None, ())
    assert files_digest(path, None, ("contact.stiffness_N_per_m=900",)) == plain
    assert files_digest(path, None, ('contact.body="calf"',)) != plain != files_digest(path, "brushed_dc", ())
