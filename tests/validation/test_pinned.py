"""Files of others are those that were pinned, or nothing is compared."""

import subprocess
import tomllib
import zipfile
from hashlib import sha256
from pathlib import Path

import numpy as np
import pytest

from validation.pinned import LIST, PinnedFiles, pinned
from validation.yardstick import NotHere
from validation.yardsticks.dual_mass import YARDSTICKS, Masses

CONTENT = b"one\n"


def git(*arguments: str, folder: Path) -> str:
    who = ["-c", "user.name=test", "-c", "user.email=test@localhost"]
    done = subprocess.run(["git", *who, *arguments], cwd=folder, check=True, capture_output=True, text=True)
    return done.stdout.strip()


@pytest.fixture
def files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> PinnedFiles:
    """Of a clone with one commit, whose file was changed since."""
    clone = tmp_path / "clone"
    (clone / "part").mkdir(parents=True)
    (clone / "part/a.txt").write_bytes(CONTENT)
    git("init", "-q", folder=clone)
    git("add", ".", folder=clone)
    git("commit", "-q", "-m", "first", folder=clone)
    commit = git("rev-parse", "HEAD", folder=clone)
    (clone / "part/a.txt").write_text("another")
    monkeypatch.setenv("A_CLONE", str(clone))
    return PinnedFiles("owner/name", "A_CLONE", commit, {"part/a.txt": sha256(CONTENT).hexdigest(), "part/b": "0" * 64})


def test_a_file_is_that_of_its_commit(files: PinnedFiles, tmp_path: Path):
    assert files.content("part/a.txt") == CONTENT
    with pytest.raises(NotHere, match="the clone of owner/name has no part/b of commit"):
        files.packed("part", tmp_path / "a.zip")
    only = PinnedFiles(files.repository, files.variable, files.commit, {"part/a.txt": files.files["part/a.txt"]})
    with zipfile.ZipFile(only.packed("part", tmp_path / "a.zip")) as packed:
        assert packed.read("a.txt") == CONTENT


def test_another_file_of_that_name_fails_and_no_clone_runs_nothing(files: PinnedFiles, monkeypatch: pytest.MonkeyPatch):
    other = PinnedFiles(files.repository, files.variable, files.commit, {"part/a.txt": "0" * 64})
    with pytest.raises(RuntimeError, match=r"part/a.txt has another SHA-256"):
        other.content("part/a.txt")
    monkeypatch.delenv("A_CLONE")
    with pytest.raises(NotHere, match="A_CLONE=a clone of owner/name"):
        files.content("part/a.txt")


def test_every_list_has_whole_hashes():
    for name in tomllib.loads(LIST.read_text()):
        one = pinned(name)
        assert len(one.commit) == 40 and all(len(digest) == 64 for digest in one.files.values())


def test_masses_that_move_as_one_swing_with_the_frequency_of_one(monkeypatch: pytest.MonkeyPatch):
    # the same springs outside, nothing in between but a spring that is never stretched
    alike = Masses(9.0, 5.0, 9.0, 0.0, 0.3, 0.0, 0.5, 0.5)
    np.testing.assert_allclose(alike.exact(0.01, 301)[:, 0], 0.5 * np.cos(3.0 * 0.01 * np.arange(301)), atol=1e-12)
    monkeypatch.delenv("OMSIMULATOR_CLONE", raising=False)
    with pytest.raises(NotHere, match="OMSIMULATOR_CLONE=a clone of OpenModelica/OMSimulator"):
        YARDSTICKS[0].differences()
