"""Nothing that lies in the folder where a command is given is imported, by it or by what it starts."""

import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

POISON = 'open({marker!r}, "a").write(__name__ + "\\n")\nraise ImportError("imported from the current folder")\n'
MODULES = [
    *("asyncio.py", "encodings.py", "hashlib.py", "json.py", "multiprocessing.py", "numba.py", "numpy.py"),
    *("random.py", "socket.py", "statistics.py", "twin/__init__.py"),
]
SWEEP = """
experiment = "fig4_position.toml"
[[vary]]
key = "duration_s"
values = [0.01]
"""
GUARDED = 'if __name__ == "__main__":\n    main()\n'
COMMANDS = {
    "a run and its drives in processes of theirs": (
        "run",
        "fig4_position",
        "--set",
        "duration_s=0.01",
        "--isolate",
        "drive",
    ),
    "the doctor's run": ("doctor", "--run"),
    "workers of a sweep": ("sweep", "sweep.toml", "-j", "1", "--out", "elsewhere"),
}


@pytest.fixture
def poisoned(tmp_path: Path) -> Path:
    """A folder full of modules that leave their names in ./imported."""
    (tmp_path / "twin").mkdir()
    for name in MODULES:
        (tmp_path / name).write_text(POISON.format(marker=str(tmp_path / "imported")))
    (tmp_path / "sweep.toml").write_text(SWEEP)
    return tmp_path


@pytest.mark.parametrize("command", COMMANDS.values(), ids=COMMANDS)
def test_no_command_imports_from_the_folder_it_is_given_in(
    poisoned: Path, tmp_path_factory: pytest.TempPathFactory, root: Path, command: tuple[str, ...]
):
    # as the program that an installation makes, whose own folder is the first that is searched
    program = tmp_path_factory.mktemp("bin") / "program.py"
    program.write_text(f"import sys\nsys.path.append({str(root)!r})\nfrom twin.cli import main\n" + GUARDED)
    done = subprocess.run(
        [sys.executable, program, *command], cwd=poisoned, capture_output=True, text=True, timeout=300
    )
    assert not (poisoned / "imported").exists(), (poisoned / "imported").read_text()
    assert done.returncode == 0, done.stdout + done.stderr


def test_started_as_a_module_it_searches_the_folder_no_longer_than_python_makes_it(tmp_path: Path, root: Path):
    (tmp_path / "numpy.py").write_text(POISON.format(marker=str(tmp_path / "imported")))
    done = subprocess.run(
        [sys.executable, "-m", "twin", "drive", "info", "velocity_servo"], cwd=tmp_path, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    assert not (tmp_path / "imported").exists()
