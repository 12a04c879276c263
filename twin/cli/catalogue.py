"""Catalogue of the commands of twin, found in the text of their files without importing them."""

import re
from collections.abc import Mapping
from inspect import cleandoc
from pathlib import Path
from typing import NamedTuple

COMMAND_FOLDERS = {"twin.studies": Path(__file__).parents[1] / "studies", "twin.cli": Path(__file__).parent}
"""Packages whose files, and the `study.py` of their folders, define commands."""
COMMAND_PATTERN = re.compile(r'^@study\((?:"([^"]*)")?.*?^def (\w+)\(.*?"""(.*?)"""', re.DOTALL | re.MULTILINE)
HELP_SECTIONS: Mapping[str, tuple[str, ...]] = {
    "Run": ("run", "explore", "sweep", "branch", "cosim"),
    "Choose": ("robot", "drive", "tune", "analyse", "component"),
    "Judge": ("report", "compare", "check", "faults", "accuracy", "converge", "falsify", "safety"),
    "Beside a robot": ("replay", "identify", "shadow", "serve", "log"),
    "Hand on": ("export", "build"),
    "Look after": ("runs", "init", "schema", "doctor"),
}
"""Headings of the help, and the commands below each, the most used first."""


class CommandText(NamedTuple):
    """A command of twin as declared in the text of its file: module, function, help."""

    module: str
    function: str
    help: str


def command_texts() -> dict[str, CommandText]:
    """Return all commands of twin by their words, such as `drive check`."""
    found = {}
    for package, folder in COMMAND_FOLDERS.items():
        for file in sorted([*folder.glob("*/study.py"), *folder.glob("*.py")]):
            module = ".".join([package, *file.relative_to(folder).with_suffix("").parts])
            for words, function, text in COMMAND_PATTERN.findall(file.read_text("utf-8")):
                # `Raises:` is for programs, not for users of the command line
                help_text = cleandoc(text).partition("\n\nRaises:")[0]
                found[words or function] = CommandText(module, function, help_text)
    return found


class CommandGroup(NamedTuple):
    """A group of two-word commands with the same first word: its help, and its default second word."""

    help: str
    default: str = ""


COMMAND_GROUPS: Mapping[str, CommandGroup] = {
    "sweep": CommandGroup(
        "Run one experiment many times: twin sweep SWEEP, or twin sweep run SWEEP.\n\n"
        "Options: twin sweep run --help.\n\n"
        "Example: twin sweep experiments/sweeps/stiffness_and_gain.toml --dry-run",
        default="run",
    ),
    "drive": CommandGroup("Look at drive FMUs, qualify, compare and bring them in."),
    "component": CommandGroup("Look at and check third-party parts of the robot."),
    "log": CommandGroup("Bring in the log of a robot: which column is which signal."),
}
