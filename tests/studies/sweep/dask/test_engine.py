import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.kernel.process.hostile import EXIT, HANG, NONE, SEGFAULT, hostile_drive
from tests.studies.sweep.dask import deadly
from tests.studies.sweep.dask.running import Running, kill, running
from tests.studies.sweep.definitions import stiffness_text, stiffnesses, written
from twin.kernel.process.job import JobLimits
from twin.studies.sweep.dask import engine as engine_module
from twin.studies.sweep.dask.engine import ClusterLost, DaskEngine
from twin.studies.sweep.engine import Engine, LocalEngine
from twin.studies.sweep.plan import SweepPlan, read_plan
from twin.studies.sweep.stored import stored_sweep
from twin.studies.sweep.sweep import RECORDINGS_FOLDER, SweepState, run_sweep

pytestmark = pytest.mark.slow

COSTS = ("seconds", "stepping_s")
FEW, SOME = "[500, 1000, 2000]", str([500 + 10 * number for number in range(24)])


def rows(
    plan: SweepPlan,
    folder: Path,
    engine: Engine,
    record: str = "none",
    limits: JobLimits = JobLimits(),  # noqa: B008
) -> list[dict]:
    """Of every run, without what it cost."""
    run_sweep(plan, folder, engine, record, limits)
    return bare(folder)


def bare(folder: Path) -> list[dict]:
    return [{k: v for k, v in row.items() if k not in COSTS} for row in stored_sweep(folder).rows]


def shown_rows(plan: SweepPlan, folder: Path, cluster: Running, watch: Callable[[SweepState], None]) -> list[dict]:
    run_sweep(plan, folder, DaskEngine(cluster.address), show=watch)
    return stored_sweep(folder).rows


@pytest.fixture
def short(root: Path, tmp_path: Path) -> SweepPlan:
    """Three short runs."""
    return stiffnesses(root, tmp_path, FEW)


@pytest.fixture
def longer(root: Path, tmp_path: Path) -> SweepPlan:
    """Two dozen runs, long enough for something to happen meanwhile."""
    return stiffnesses(root, tmp_path, SOME)


def test_rows_and_recordings_are_those_of_local_processes_byte_for_byte(root: Path, tmp_path: Path, cluster: Running):
    text = f"""
experiment = "{root}/experiments/calibration.toml"
drives = ["velocity_servo", "brushed_dc"]
vary = [{{ key = "plant.eta", values = [0.8, 0.9] }}, {{ key = "duration_s", values = [0.1] }}]
"""
    plan = read_plan(written(tmp_path, text))
    here, there = tmp_path / "here", tmp_path / "there"
    local = rows(plan, here, LocalEngine(1), "all")
    assert rows(plan, there, DaskEngine(cluster.address), "all") == local
    assert [row["status"] for row in local] == ["done"] * 4
    for row in local:
        recording = f"{RECORDINGS_FOLDER}/{row['run']:06d}/run.mcap"
        assert (there / recording).read_bytes() == (here / recording).read_bytes()


@pytest.mark.endurance
def test_drives_that_crash_exit_or_hang_cost_only_their_run_and_no_worker(root: Path, tmp_path: Path, cluster: Running):
    drive = hostile_drive(root, tmp_path)
    attacks = (NONE, SEGFAULT, EXIT, HANG)
    text = f"""
experiment = "{root}/experiments/fig4_position.toml"
vary = [
  {{ key = "drive.joint_2.fmu", values = ["{drive}"] }},
  {{ key = "drive.joint_2.parameters.droop", values = {list(attacks)} }},
  {{ key = "duration_s", values = [1.1] }},
]
"""
    plan, limits = read_plan(written(tmp_path, text)), JobLimits(step=1.0)
    local = rows(plan, tmp_path / "here", LocalEngine(2), limits=limits)
    assert [row["status"] for row in local] == ["done", "failed", "failed", "failed"]
    assert rows(plan, tmp_path / "there", DaskEngine(cluster.address), limits=limits) == local
    assert all(worker.poll() is None for worker in cluster.workers)


def test_a_sweep_leaves_no_process_in_a_worker(short: SweepPlan, tmp_path: Path, cluster: Running):
    rows(short, tmp_path / "out", DaskEngine(cluster.address))
    assert [children(worker.pid) for worker in cluster.workers] == [[], []]


def test_a_sweep_whose_command_is_killed_ends_in_the_workers(root: Path, tmp_path: Path, cluster: Running):
    sweep = written(tmp_path, stiffness_text(root, str(list(range(500, 4500)))))
    command = [sys.executable, "-m", "twin", "sweep", str(sweep), "--out", str(tmp_path / "out")]
    rows_file = tmp_path / "out" / "rows.jsonl"
    process = subprocess.Popen(
        [*command, "--engine", "dask", "--scheduler", cluster.address], env={**os.environ, "PYTHONPATH": str(root)}
    )
    try:
        wait_until(lambda: rows_file.exists() and rows_file.stat().st_size > 0)
    finally:
        kill(process)
    wait_until(lambda: not any(children(worker.pid) for worker in cluster.workers))


def test_a_worker_that_comes_later_works(root: Path, longer: SweepPlan, tmp_path: Path):
    with running(root, tmp_path, 1) as cluster:

        def watch(state: SweepState) -> None:
            if state.done and len(cluster.workers) == 1:
                cluster.workers.append(cluster.worker())
                cluster.wait(2)
                kill(cluster.workers[0])

        found = shown_rows(longer, tmp_path / "out", cluster, watch)
        assert len(cluster.workers) == 2
    assert [row["status"] for row in found] == ["done"] * 24


def test_a_worker_killed_at_work_loses_no_run_and_none_is_counted_twice(root: Path, longer: SweepPlan, tmp_path: Path):
    with running(root, tmp_path, 2) as cluster:

        def watch(state: SweepState) -> None:
            if 0 < state.done < state.total and cluster.workers[0].poll() is None:
                kill(cluster.workers[0])

        found = shown_rows(longer, tmp_path / "out", cluster, watch)
        assert cluster.workers[0].poll() is not None
    assert [row["run"] for row in found] == list(range(1, 25))
    assert {row["status"] for row in found} == {"done"}


@pytest.mark.endurance
def test_a_run_whose_worker_dies_twice_is_a_row_and_the_others_are_done(
    root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    # in place of the four deaths that Dask waits for
    monkeypatch.setenv("DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES", "0")
    monkeypatch.setattr(engine_module, "run_tasks", deadly.run_tasks)
    # all runs in one batch: who is to blame has to be found out
    monkeypatch.setattr(engine_module, "BATCHES_PER_THREAD", 1)
    monkeypatch.setattr(engine_module, "BATCH_SECONDS", 1e3)
    plan = stiffnesses(root, tmp_path, "[500, 600, 700, 800]")
    with running(root, tmp_path, 3) as cluster:
        found = rows(plan, tmp_path / "out", DaskEngine(cluster.address))
        assert [worker.poll() for worker in cluster.workers].count(1) == 2
    assert [row["status"] for row in found] == ["done", "done", "failed", "done"]
    assert found[deadly.DEADLY - 1]["reason"] == "the Dask worker died whenever it was tried"


@pytest.mark.endurance
def test_a_scheduler_that_is_killed_is_named_and_after_its_restart_the_sweep_goes_on(
    root: Path, longer: SweepPlan, tmp_path: Path
):
    folder = tmp_path / "out"
    with running(root, tmp_path, 1) as cluster:

        def watch(state: SweepState) -> None:
            if state.done:
                assert cluster.scheduler is not None
                kill(cluster.scheduler)

        with pytest.raises(
            ClusterLost, match=f"the scheduler {cluster.address} is gone; finished runs are kept"
        ) as end:
            run_sweep(longer, folder, DaskEngine(cluster.address), show=watch)
        assert end.value.exit_code == 3
        before = stored_sweep(folder).rows
        assert 0 < len(before) < 24
        cluster.end()
        cluster.begin(1)
        run_sweep(longer, folder, DaskEngine(cluster.address))
    after = stored_sweep(folder).rows
    assert [row["run"] for row in after] == list(range(1, 25))
    # not even their cost has changed: they have not been run again
    assert [row for row in after if row["run"] in {old["run"] for old in before}] == before


def wait_until(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + 60.0
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.05)


def children(pid: int) -> list[str]:
    """Command lines of the living children of a process."""
    pids = [
        child for thread in Path(f"/proc/{pid}/task").iterdir() for child in (thread / "children").read_text().split()
    ]
    lines = [Path(f"/proc/{child}/cmdline").read_bytes().replace(b"\0", b" ").decode() for child in pids]
    # Python's own, which lives as long as the process
    return [line for line in lines if line and "resource_tracker" not in line]
