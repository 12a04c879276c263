"""The tutorial works in an environment that has what its own commands install, and nothing else."""

import os
import re
import shutil
import subprocess
import sys
import sysconfig
import tomllib
from collections.abc import Iterable, Iterator
from importlib.metadata import Distribution, PackageNotFoundError, distribution
from pathlib import Path
from typing import Any

import pytest
from packaging.requirements import Requirement

from tests.docs.code_blocks import Block, blocks
from tests.docs.workshop import SETUP, Workshop

PAGE = "docs/tutorial.md"
SCRIPT = "#!{python}\nimport sys\nfrom twin.cli import main\nsys.exit(main())\n"

pytestmark = pytest.mark.skipif("sys.platform == 'win32'", reason="programs of an environment lie elsewhere there")


def needed(wanted: Iterable[str]) -> dict[str, Distribution]:
    """What pip would install for the requirements `wanted`, as it is installed here, by name."""
    found: dict[str, Distribution] = {}
    todo = [(Requirement(text), "") for text in wanted]
    while todo:
        requirement, extra = todo.pop()
        if requirement.marker and not requirement.marker.evaluate({"extra": extra}):
            continue
        one = distribution(requirement.name)
        # nothing here asks for one package with different extras
        if found.setdefault(requirement.name.lower(), one) is one:
            extras = requirement.extras or {""}
            todo += [(Requirement(text), extra) for text in one.requires or () for extra in extras]
    return found


def top_level(one: Distribution) -> Iterator[Path]:
    """What a distribution puts into site-packages: folders and files there."""
    home = Path(str(one.locate_file("")))
    names = {file.parts[0] for file in one.files or ()}
    yield from (home / name for name in names if name not in ("..", "__pycache__"))


class Newcomer(Workshop):
    """A folder with a copy of what commands read, and a new environment in it.

    Nothing is downloaded: `pip install` links what it would bring from the environment of the tests, as the metadata of
    the packages tells. twin is that of the repository, as an editable install has it. Programs are those of the new
    environment and of the system.
    """

    def __init__(self, root: Path, folder: Path):
        super().__init__(root, folder)
        kept = {key: value for key, value in os.environ.items() if not key.startswith(("PYTHON", "VIRTUAL_ENV"))}
        self._environment = {**kept, "PATH": "/usr/local/bin:/usr/bin:/bin", "COLUMNS": "80"}
        self._environment.pop("NUMBA_CACHE_DIR", None)
        self.programs = folder / ".venv" / "bin"
        self.linked: set[str] = set()

    def _shell(self, block: Block) -> None:
        waiting: list[tuple[str, int]] = []
        for command, expected in block.commands:
            if SETUP.match(command):
                self._scripted(block, waiting)
                waiting = []
                self._setup(block, command)
                self._set_up(command)
            else:
                waiting.append((command, expected))
        self._scripted(block, waiting)

    def _set_up(self, command: str) -> None:
        """Do what a command that sets up would."""
        if " -m venv " in command:
            subprocess.run([sys.executable, "-m", "venv", "--without-pip", ".venv"], cwd=self.folder, check=True)
        elif command.endswith(" -e ."):
            assert command.startswith(".venv/bin/python -m pip install "), command
            self._link(tomllib.loads((self._root / "pyproject.toml").read_text())["project"]["dependencies"])
            (self.packages / "twin.pth").write_text(f"{self._root}\n")
            self._link_files(distribution("twin"), ".dist-info")
            (self.programs / "twin").write_text(SCRIPT.format(python=self.programs / "python"))
            (self.programs / "twin").chmod(0o755)
        elif command == ". .venv/bin/activate":
            self._environment["PATH"] = f"{self.programs}{os.pathsep}{self._environment['PATH']}"
        else:
            self._link(re.sub(r"^python -m pip install (-c \S+ )?", "", command).split())

    @property
    def packages(self) -> Path:
        """Where the environment's packages are."""
        (found,) = (self.folder / ".venv").glob("lib/python*/site-packages")
        return found

    def _link(self, wanted: Iterable[str]) -> None:
        for name, one in needed(wanted).items():
            self.linked.add(name)
            self._link_files(one)

    def _link_files(self, one: Distribution, ending: str = "") -> None:
        for path in top_level(one):
            link = self.packages / path.name
            if path.name.endswith(ending) and not link.is_symlink():
                link.symlink_to(path)

    def _python(self, block: Block, namespace: dict[str, Any]) -> None:
        program = shutil.which("python", path=self._environment["PATH"])
        assert program is not None
        done = subprocess.run(
            [program, "-c", block.text], cwd=self.folder, env=self._environment, capture_output=True, text=True
        )
        assert done.returncode == 0, f"{block.place}:\n{done.stdout}\n{done.stderr}"


@pytest.mark.slow
def test_every_step_works_with_what_the_tutorial_installs_and_nothing_else(root: Path, tmp_path: Path):
    newcomer = Newcomer(root, tmp_path)
    for block in blocks(root, PAGE):
        newcomer.run(block, {})
    # the tests' own environment has these, and the tutorial asks for none of them
    assert newcomer.linked >= {"numba", "fmpy", "pytest"}
    assert not newcomer.linked & {"hypothesis", "mypy", "ruff", "hatchling", "pyarrow", "rosbags", "websockets"}
    inside = {path.name for path in newcomer.packages.iterdir()}
    assert "hypothesis" not in inside and Path(sysconfig.get_paths()["purelib"]) not in newcomer.packages.parents
    assert shutil.which("twin", path=newcomer._environment["PATH"]) == str(newcomer.programs / "twin")


def test_what_a_package_needs_is_found_from_its_metadata():
    found = needed(["pytest"])
    assert {"pytest", "pluggy", "iniconfig"} <= found.keys() and "numpy" not in found
    with pytest.raises(PackageNotFoundError):
        needed(["no-such-package"])
