"""Clusters that are not there, or not like this machine: one sentence that says which, and nothing is run."""

import os
import signal
import socket
import subprocess
import sys
import time
from contextlib import closing
from pathlib import Path

import pytest
from click.testing import CliRunner

from tests.kernel.process.hostile import Command
from tests.studies.sweep.dask.running import Running, kill
from tests.studies.sweep.definitions import stiffness_text, stiffnesses, written
from twin.cli.app import twin_command
from twin.kernel.errors import InputRefused
from twin.studies.sweep.dask import cluster as cluster_module
from twin.studies.sweep.dask import worker as worker_module
from twin.studies.sweep.dask.cluster import versions
from twin.studies.sweep.dask.engine import DaskEngine
from twin.studies.sweep.plan import SweepPlan
from twin.studies.sweep.stored import stored_sweep
from twin.studies.sweep.sweep import run_sweep

pytestmark = pytest.mark.slow


@pytest.fixture
def plan(root: Path, tmp_path: Path) -> SweepPlan:
    return stiffnesses(root, tmp_path, "[500, 600]")


def refusal(plan: SweepPlan, folder: Path, scheduler: str) -> str:
    with pytest.raises(InputRefused) as refused:
        run_sweep(plan, folder, DaskEngine(scheduler))
    assert stored_sweep(folder).rows == []
    return str(refused.value)


def refusal_with_a_worker_in(folder: Path, plan: SweepPlan, cluster: Running) -> str:
    """The refusal for a third worker, which finds its packages in `folder` first."""
    worker = cluster.worker(folder)
    try:
        cluster.wait(3)
        said = refusal(plan, folder / "out", cluster.address)
    finally:
        kill(worker)
    assert said.startswith("--engine dask: worker tcp://127.0.0.1:")
    return said


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:{port}", "nothing://there", "127.0.0.1", "tcp://[oops"])
def test_a_scheduler_that_is_not_there_is_named(
    plan: SweepPlan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, address: str
):
    monkeypatch.setattr(cluster_module, "CONNECT_TIMEOUT", 0.3)
    with closing(socket.socket()) as silent:
        # whoever connects is never answered
        silent.bind(("127.0.0.1", 0))
        silent.listen()
        address = address.format(port=silent.getsockname()[1])
        said = refusal(plan, tmp_path / "out", address)
    assert said.startswith(f"--scheduler {address}: no Dask scheduler answers there")
    assert said.endswith("such as tcp://127.0.0.1:8786")


def test_a_scheduler_without_workers_is_told_from_one_that_is_not_there(root: Path, plan: SweepPlan, tmp_path: Path):
    cluster = Running(root, tmp_path)
    try:
        cluster.begin(0)
        said = refusal(plan, tmp_path / "out", cluster.address)
    finally:
        cluster.end()
    assert said == (
        f"--scheduler {cluster.address}: has no workers; start some with: dask worker {cluster.address} --nthreads 1"
    )


@pytest.mark.parametrize(("package", "told"), [("numpy", "numpy 1.0"), ("numba", "numba 1.0"), ("twin", "twin 1.0")])
def test_a_worker_with_another_version_is_named_with_both(
    plan: SweepPlan, tmp_path: Path, cluster: Running, package: str, told: str
):
    other = tmp_path / f"{package}-1.0.dist-info"
    other.mkdir()
    (other / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: 1.0\n")
    said = refusal_with_a_worker_in(tmp_path, plan, cluster)
    assert f"has {told}" in said
    assert f", this machine has {versions()[package]}" in said


def test_a_worker_without_twin_is_named(plan: SweepPlan, tmp_path: Path, cluster: Running):
    (tmp_path / "twin.py").write_text("raise ImportError('no twin here')\n")
    said = refusal_with_a_worker_in(tmp_path, plan, cluster)
    assert "has no twin like this one" in said


def test_a_worker_that_comes_later_with_another_version_runs_nothing(
    plan: SweepPlan, tmp_path: Path, cluster: Running, monkeypatch: pytest.MonkeyPatch
):
    # nobody has asked it before, and to it it is the same who of the two is the other
    monkeypatch.setattr(cluster_module, "refuse_other_versions", lambda client: None)
    monkeypatch.setattr(worker_module, "versions", lambda: versions() | {"Python": "2.7"})
    said = refusal(plan, tmp_path / "out", cluster.address)
    assert f"has Python {versions()['Python']}, this machine has 2.7; runs would not give the same numbers" in said


def test_without_dask_the_extra_is_named(root: Path, tmp_path: Path):
    """In a process of its own, for here it is imported already."""
    said = subprocess.run(
        [sys.executable, "-c", "import sys; sys.modules['distributed'] = None; from twin.cli import main; main()",
         "sweep", "stiffness_and_gain", "--engine", "dask", "--scheduler", "tcp://a:1", "--out", str(tmp_path / "out")],
        cwd=root, capture_output=True, text=True,
    )  # fmt: skip
    assert said.stderr.endswith("install it with pip install 'dask>=2024.8' 'distributed>=2024.8'\n")
    assert said.returncode == 2


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (["--scheduler", "tcp://a:1"], "belongs to --engine dask"),
        (["--engine", "dask"], "--engine dask: no longer starts a cluster; add --scheduler ADDRESS"),
        (
            ["--engine", "dask", "--scheduler", "tcp://a:1", "-j", "2"],
            "tcp://a:1 has the workers it has",
        ),
    ],
)
def test_options_that_contradict_each_other_are_refused(root: Path, options: list[str], told: str):
    sweep = root / "experiments" / "sweeps" / "stiffness_and_gain.toml"
    result = CliRunner().invoke(twin_command(), ["sweep", str(sweep), *options])
    assert isinstance(result.exception, InputRefused)
    assert told in str(result.exception)


def test_ctrl_c_keeps_what_is_finished_ends_all_processes_and_says_how_to_go_on(
    root: Path, tmp_path: Path, cluster: Running
):
    command = Command(root, tmp_path)
    # batches hold half a second's worth of runs: it takes 15 s, and is not over when the first rows are there
    values = str([500 + number for number in range(1000)])
    sweep = written(tmp_path, stiffness_text(root, values))
    on_cluster = "--engine", "dask", "--scheduler", cluster.address
    process = subprocess.Popen(
        [sys.executable, "-m", "twin", "sweep", str(sweep), "--out", "out", *on_cluster],
        cwd=tmp_path,
        env={**command.environment, "PYTHONPATH": str(root)},
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    rows = tmp_path / "out" / "rows.jsonl"
    try:
        while process.poll() is None and not (rows.exists() and rows.stat().st_size):
            time.sleep(0.05)
        # some press twice
        os.killpg(process.pid, signal.SIGINT)
        os.killpg(process.pid, signal.SIGINT)
        said = process.communicate(timeout=60)[1]
    finally:
        process.kill()
    finished = len(rows.read_text().splitlines())
    assert process.returncode == 130
    assert 0 < finished < 1000
    assert said.strip() == f"interrupted; {finished} of 1000 runs are kept in out; the same command runs the others"
    assert command.survivors() == []
    assert command.leftovers() == []
