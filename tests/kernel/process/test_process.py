"""How another Python is started: it finds this package, and not what lies in the current folder."""

import os
import subprocess
import sys
import sysconfig
from pathlib import Path

import pytest

from twin.kernel.process import process as interpreter
from twin.kernel.process.process import OURS, SAFE_PATH, environment, module_command, others_safe


def test_empty_entries_of_the_search_path_which_mean_the_current_folder_are_left_out(root: Path, monkeypatch):
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(["", "/a", "", "/b"]))
    assert environment()["PYTHONPATH"] == os.pathsep.join([str(root), "/a", "/b"])


def test_installed_packages_do_not_come_before_the_standard_library(monkeypatch: pytest.MonkeyPatch):
    packages = sysconfig.get_path("purelib")
    monkeypatch.setattr(interpreter.twin, "__file__", f"{packages}/twin/__init__.py")
    monkeypatch.delenv("PYTHONPATH", raising=False)
    assert environment()["PYTHONPATH"] == ""


def test_what_a_package_starts_is_safe_meanwhile_and_what_a_drive_starts_is_left_alone(monkeypatch):
    monkeypatch.delenv(SAFE_PATH, raising=False)
    with others_safe():
        assert os.environ[SAFE_PATH] == OURS and SAFE_PATH not in environment()
    assert SAFE_PATH not in os.environ
    # the user's own wish stays
    monkeypatch.setenv(SAFE_PATH, "1")
    with others_safe():
        assert os.environ[SAFE_PATH] == environment()[SAFE_PATH] == "1"
    assert os.environ[SAFE_PATH] == "1"


def test_the_package_is_found_from_any_folder_and_the_folder_is_not_searched(tmp_path: Path):
    (tmp_path / "json.py").write_text("raise SystemExit('imported from the current folder')")
    command = module_command("twin", "--version")
    assert command[0] == sys.executable
    done = subprocess.run(command, cwd=tmp_path, env=environment(), capture_output=True, text=True)
    assert done.stdout.startswith("twin "), done.stderr
