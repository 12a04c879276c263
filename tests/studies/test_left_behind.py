"""Folders and semaphores of studies that were killed: the next command clears them, and nothing else."""

import multiprocessing
import os
import time
from pathlib import Path

import pytest

from twin.cli.app import carried_out
from twin.studies import left_behind
from twin.studies.left_behind import DASK, ORDERS, SCRATCH, clear, dask_folder, held_folder, hold


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where temporary files go, and semaphores beside them."""
    (tmp_path / "shm").mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    monkeypatch.setattr(left_behind, "SEMAPHORES", tmp_path / "shm")
    return tmp_path


def folder(home: Path, name: str, age: float = 3600.0) -> Path:
    """One with a pipe that nobody holds."""
    made = home / name
    (made / "inside").mkdir(parents=True)
    os.close(hold(made / "pipe"))
    (home / "shm" / f"sem.{name}-abc").touch()
    then = time.time() - age
    os.utime(made, (then, then))
    return made


def left(home: Path) -> set[str]:
    return {entry.name for entry in (*home.iterdir(), *(home / "shm").iterdir())} - {"shm"}


@pytest.mark.parametrize("kind", [ORDERS, SCRATCH, DASK])
def test_what_nobody_holds_goes_with_its_semaphores(home: Path, kind: str):
    folder(home, f"{kind}a")
    # another one's, whose name begins alike
    (home / "shm" / f"sem.{kind}ab-abc").touch()
    clear()
    assert left(home) == {f"sem.{kind}ab-abc"}


def test_what_is_held_is_young_or_has_another_name_stays(home: Path):
    at_work = folder(home, f"{DASK}at_work")
    held = os.open(at_work / "pipe", os.O_RDWR)
    folder(home, f"{ORDERS}young", age=1.0)
    folder(home, "other")
    (home / f"{DASK}link").symlink_to(home / "other")
    before = left(home)
    clear()
    assert left(home) == before
    os.close(held)
    clear()
    assert before - left(home) == {f"{DASK}at_work", f"sem.{DASK}at_work-abc"}


def test_a_cluster_at_work_is_left_alone_and_its_semaphores_have_its_name(home: Path):
    with dask_folder() as name:
        os.utime(name, (0.0, 0.0))
        clear()
        assert name.is_dir()
        assert semaphore().startswith(f"/{name.name}-")
    assert not name.exists()
    assert not semaphore().startswith("/twin")


def test_a_folder_is_held_until_the_end_of_its_block(home: Path):
    with held_folder(SCRATCH) as name:
        os.utime(name, (0.0, 0.0))
        clear()
        assert name.is_dir()
    assert left(home) == set()


def test_a_command_clears(home: Path):
    folder(home, f"{SCRATCH}a")
    assert carried_out(["--version"]) in (None, 0)
    assert left(home) == set()


def semaphore() -> str:
    """The name of a new one for other processes."""
    return multiprocessing.get_context("spawn").Lock()._semlock.name  # type: ignore[attr-defined]
