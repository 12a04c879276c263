"""A folder in which the code of a page runs as it would from the repository's root."""

import itertools
import os
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from tests.command_line import twin
from tests.docs.code_blocks import Block
from tests.kernel.fmi.amplifier import parts_of_a_drive
from twin.kernel.recording.logs.column_map import column_map
from twin.robot.assembly.load import load_experiment
from twin.robot.experiment.schema import Drive
from twin.studies.sweep.plan import read_plan

PLAIN = re.compile(r"twin ([^|;&$<>`*?~{}()!\\'\"]|'[^']*')*$")
"""A command that a shell would only split into words."""
ISOLATION = "docs/isolation.md"
LATEST = ": the latest run, "
SETUP = re.compile(
    r"^(make\b|python3 -m venv|\S*python -m pip install|\S*pip install|pipx |uv tool |\. \.venv/bin/activate$)"
)


class Workshop:
    """A copy of what commands read, with recordings of Fig. 4.

    Attributes:
        folder: where commands run.
    """

    def __init__(self, root: Path, folder: Path):
        self.folder = folder
        self._root = root
        self._refusal = ""
        for name in ("experiments", "fmus", "tests/baselines"):
            shutil.copytree(root / name, folder / name)
        for name in ("examples", "benchmarks"):
            (folder / name).symlink_to(root / name)
        # the drives that docs/drives.md and docs/tutorial.md bring in
        parts_of_a_drive(root, folder / "parts")
        for sent in ("supplier", "sent"):
            (folder / sent).mkdir()
            shutil.copy(root / "fmus" / "pmsm_foc" / "pmsm_foc.fmu", folder / sent / "servo.fmu")
        programs = folder / "programs"
        programs.mkdir()
        # who has no compiler has that of the drives
        compiler = [] if shutil.which("cc") else [("cc", "-m ziglang cc")]
        for name, start in (("twin", "-m twin"), ("python", ""), *compiler):
            (programs / name).write_text(f'#!/bin/sh\nexec {shlex.quote(sys.executable)} {start} "$@"\n')
            (programs / name).chmod(0o755)
        self._environment = {
            **os.environ,
            "PATH": f"{programs}{os.pathsep}{os.environ['PATH']}",
            "PYTHONPATH": f"{root}{os.pathsep}{folder}",
            "COLUMNS": "80",
        }

    def twin(self, *arguments: str, expected: int = 0) -> str:
        """What a command of twin prints; it has to end with the exit code `expected`."""
        done = twin(*arguments, cwd=self.folder, env=self._environment)
        assert done.returncode == expected, f"{shlex.join(arguments)}: {done.returncode}\n{done.stdout}\n{done.stderr}"
        return done.stdout

    def run(self, block: Block, namespace: dict[str, Any]) -> None:
        """Run `block`; Python blocks of a page share `namespace`.

        Raises:
            AssertionError: a command ended with another exit code than the page says; it has the command's output.
        """
        if block.file_name:
            (self.folder / block.file_name).parent.mkdir(parents=True, exist_ok=True)
            (self.folder / block.file_name).write_text(block.text)
        refusal, self._refusal = self._refusal, ""
        match block.language:
            case "text" if refusal:
                assert block.text in refusal, f"{block.place}: not what the commands before it say:\n{refusal}"
            case "sh":
                self._shell(block)
            case "toml":
                self._toml(block)
            case "c" if not block.file_name:
                self._c(block)
            case "python" if not block.file_name:
                self._python(block, namespace)

    def _shell(self, block: Block) -> None:
        commands = []
        for command, expected in block.commands:
            if SETUP.match(command):
                self._setup(block, command)
            elif block.remark.startswith("not run"):
                self._knows_options(block, command)
            else:
                commands.append((command.replace(".venv/bin/", ""), expected))
        # what only twin is needed for is sooner typed in this process than in a shell
        plain = list(itertools.takewhile(lambda command: PLAIN.match(command[0]), commands))
        self._typed(block, plain)
        if len(plain) < len(commands):
            self._scripted(block, commands[len(plain) :])

    def _typed(self, block: Block, commands: list[tuple[str, int]]) -> None:
        """Commands of twin and nothing else, in this process."""
        for command, expected in commands:
            words = shlex.split(command, comments=True)[1:]
            # other pages are not about what guards a run, and type two hundred commands
            isolated = block.page == ISOLATION
            done = twin(*words, cwd=self.folder, env=self._environment, isolated=isolated)
            assert done.returncode == expected, (
                f"{block.place}: exit code {done.returncode}\n{done.stdout}\n{done.stderr}"
            )
            if expected:
                # which run is the latest is no part of a refusal
                self._refusal += "".join(line for line in done.stderr.splitlines(True) if LATEST not in line)

    def _scripted(self, block: Block, commands: list[tuple[str, int]]) -> None:
        script = ["set -e"]
        for command, expected in commands:
            script.append(command if not expected else f"c=0; {command} || c=$?; [ $c -eq {expected} ]")
        done = subprocess.run(
            ["bash", "-c", "\n".join(script)],
            cwd=self.folder, env=self._environment, capture_output=True, text=True, timeout=900,
        )  # fmt: skip
        self._refusal += done.stderr if any(expected for _, expected in commands) else ""
        assert done.returncode == 0, f"{block.place}: exit code {done.returncode}\n{done.stdout}\n{done.stderr}"

    def _setup(self, block: Block, command: str) -> None:
        """What would install or build is held to the Makefile and to pyproject.toml instead."""
        words = shlex.split(command, comments=True)
        if words[0] == "make":
            targets = re.findall(r"^([a-z-]+):", (self._root / "Makefile").read_text(), re.MULTILINE)
            assert set(words[1:2]) <= set(targets), f"{block.place}: make has no target {words[1:]}"
        wheels = [Path(word).name for word in words if word.endswith(".whl")]
        version = tomllib.loads((self._root / "pyproject.toml").read_text())["project"]["version"]
        assert set(wheels) <= {f"twin-{version}-py3-none-any.whl"}, f"{block.place}: another wheel than is built"
        for name in (word for before, word in pairwise(words) if before in ("-c", "-r")):
            assert (self._root / name).is_file(), f"{block.place}: no file {name}"
        for extras in re.findall(r"\[([a-z,]+)\]", command):
            known = tomllib.loads((self._root / "pyproject.toml").read_text())["project"]["optional-dependencies"]
            assert set(extras.split(",")) <= known.keys(), f"{block.place}: no such extra: {command}"

    def _knows_options(self, block: Block, command: str) -> None:
        """Whether `twin COMMAND --help` names every option of `command`."""
        words = shlex.split(command, comments=True)
        assert words[0] == "twin", f"{block.place}: only commands of twin can be left out: {command}"
        options = [word.partition("=")[0] for word in words if word.startswith("--")]
        name = [word for word in words[1:3] if re.fullmatch("[a-z]+", word)]
        if name == ["sweep"]:
            # twin sweep FILE is short for this
            name.append("run")
        asked = [*(name if name[0] in ("drive", "sweep") else name[:1]), "--help"]
        told = self.twin(*asked)
        assert all(option in told for option in options), f"{block.place}: twin {' '.join(asked)} lacks {options}"

    def _c(self, block: Block) -> None:
        """What calls the library that `twin build --c` has written in a block before."""
        (header,) = self.folder.glob("results/build/*/c/computer.h")
        command = ["cc", "-std=c11", "-Wall", "-Werror", "-fsyntax-only", f"-I{header.parent}", "-x", "c", "-"]
        done = subprocess.run(command, input=block.text, env=self._environment, capture_output=True, text=True)
        assert done.returncode == 0, f"{block.place}: {done.stderr}"

    def _toml(self, block: Block) -> None:
        """A mapping of a drive, a column map, a sweep, or else a complete experiment."""
        table = tomllib.loads(block.text)
        if block.file_name and (table.keys() == {"contact"} or "variable" in table):
            # a body, on which the experiment after it presses; a drive, which tests/fmu builds
            return
        if table.keys() <= set(Drive.model_fields):
            Drive.model_validate(table)
            return
        if "time" in table:
            column_map([self._written(block)])
            return
        if "experiment" in table:
            read_plan(self._written(block))
            return
        assert "extends" in table, f"{block.place}: not a mapping, and no experiment: begin with extends = ..."
        load_experiment(self._written(block))

    def _written(self, block: Block) -> Path:
        path = self.folder / (block.file_name or f"experiments/line_{block.line}_of_{Path(block.page).stem}.toml")
        path.write_text(block.text)
        return path

    def _python(self, block: Block, namespace: dict[str, Any]) -> None:
        # lines are numbered as on the page, and numba finds the source of what it compiles
        source = "\n" * block.line + block.text
        path = self.folder / f"{Path(block.page).stem}_{block.line}.py"
        path.write_text(source)
        with pytest.MonkeyPatch.context() as here:
            here.chdir(self.folder)
            here.setenv("PYTHONPATH", self._environment["PYTHONPATH"])
            exec(compile(source, str(path), "exec"), namespace)
