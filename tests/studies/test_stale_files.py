"""Folders of studies that were killed: the next command clears them, and nothing else."""

import os
import time
from pathlib import Path

import pytest

from twin.cli.app import run_command_line
from twin.studies.stale_files import FOLDER_PREFIX, held_folder, remove_stale_folders


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where temporary files go."""
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    return tmp_path


def folder(home: Path, name: str, age: float = 3600.0) -> Path:
    """One with a pipe that nobody holds."""
    made = home / name
    (made / "inside").mkdir(parents=True)
    os.mkfifo(made / "pipe")
    then = time.time() - age
    os.utime(made, (then, then))
    return made


def left(home: Path) -> set[str]:
    return {entry.name for entry in home.iterdir()}


def test_what_nobody_holds_goes(home: Path):
    folder(home, f"{FOLDER_PREFIX}a")
    remove_stale_folders()
    assert left(home) == set()


def test_what_is_held_is_young_or_has_another_name_stays(home: Path):
    at_work = folder(home, f"{FOLDER_PREFIX}at_work")
    held = os.open(at_work / "pipe", os.O_RDWR)
    folder(home, f"{FOLDER_PREFIX}young", age=1.0)
    folder(home, "other")
    (home / f"{FOLDER_PREFIX}link").symlink_to(home / "other")
    before = left(home)
    remove_stale_folders()
    assert left(home) == before
    os.close(held)
    remove_stale_folders()
    assert before - left(home) == {f"{FOLDER_PREFIX}at_work"}


def test_a_folder_is_held_until_the_end_of_its_block(home: Path):
    with held_folder() as name:
        os.utime(name, (0.0, 0.0))
        remove_stale_folders()
        assert name.is_dir()
    assert left(home) == set()


def test_a_command_clears(home: Path):
    folder(home, f"{FOLDER_PREFIX}a")
    assert run_command_line(["--version"]) in (None, 0)
    assert left(home) == set()
