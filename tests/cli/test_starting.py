"""A drive to start from, and folders that are made where they are missing."""

import shlex
from pathlib import Path

import pytest

from tests.command_line import twin


@pytest.mark.parametrize("name", ["pmsm_foc", "smart_servo"])
def test_a_drive_that_is_copied_is_a_drive_of_its_own(root: Path, tmp_path: Path, name: str):
    done = twin("drive", "copy", name, "new/mine", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    own = sorted(path.relative_to(root / "fmus" / name) for path in (root / "fmus" / name).rglob("*") if path.is_file())
    assert [Path(line).relative_to("new/mine") for line in done.stdout.splitlines()[:-1]] == own
    # without the repository around it
    info = twin(*shlex.split(done.stdout.splitlines()[-1].removeprefix("next: twin ")), cwd=tmp_path)
    assert info.returncode == 0, info.stderr
    again = twin("drive", "copy", name, "new/mine", cwd=tmp_path)
    assert again.returncode == 2 and "exists; name a new folder" in again.stderr


def test_a_drive_that_is_not_there_is_named_with_the_nearest(tmp_path: Path):
    done = twin("drive", "copy", "pmsm_fok", "mine", cwd=tmp_path)
    assert done.returncode == 2 and "did you mean 'pmsm_foc'?" in done.stderr


@pytest.mark.parametrize("words", [["schema", "--out"], ["init"]])
def test_a_file_that_is_written_gets_its_folder(tmp_path: Path, words: list[str]):
    done = twin(*words, "a/b/c.toml", cwd=tmp_path)
    assert done.returncode == 0 and (tmp_path / "a" / "b" / "c.toml").is_file()
