"""The source of the kernel names nothing of the robot: no port, no experiment, no body, and few options."""

import re
from pathlib import Path

import pytest

from twin.robot.assembly.assemble import COMPONENT_ROWS

PORTS = {port for row in COMPONENT_ROWS for port in row.inputs} | {
    port for row in COMPONENT_ROWS for sources in row.inputs.values() for _, port in sources
}
SIGNALS = {f"{row}.{port}" for one in COMPONENT_ROWS for sources in one.inputs.values() for row, port in sources}

OPTION = re.compile(r"(?<![\w-])--[a-z][a-z-]+")
MAX_OPTIONS = 92
"""Places of the kernel that name an option of the command line; a change lowers it, and none raises it."""


def kernel(root: Path) -> dict[str, str]:
    """The text of each file."""
    return {str(path.relative_to(root)): path.read_text() for path in sorted((root / "twin" / "kernel").rglob("*.py"))}


def test_no_signal_of_the_robot_is_named(root: Path):
    # words such as "power" and "share" are also others'
    names = SIGNALS | {port for port in PORTS if "_" in port}
    assert {"theta_m", "plant.theta_l", "controller.omega_ref"} <= names
    pattern = re.compile(r"(?<![\w.])(" + "|".join(map(re.escape, sorted(names))) + r")(?!\w)")
    found = {file: pattern.findall(text) for file, text in kernel(root).items()}
    assert {file: names for file, names in found.items() if names} == {}


@pytest.mark.parametrize("folder", ["experiments", "experiments/bodies", "experiments/robots", "experiments/sweeps"])
def test_no_file_of_the_experiments_is_named(root: Path, folder: str):
    names = [path.stem for path in (root / folder).glob("*.toml")]
    assert names
    # in quotes, in a path or with its ending; some are also words
    quoted = "|".join(set(names) - {"back", "scale"})
    pattern = re.compile(rf"[\"'`/]({quoted})[\"'`/]|\b({'|'.join(names)})\.toml")
    found = {file: [one.group() for one in pattern.finditer(text)] for file, text in kernel(root).items()}
    # the branch of a ROS package
    found["twin/kernel/recording/sources/zenoh_topics.py"].remove("/rolling/") if folder == "experiments" else None
    assert {file: names for file, names in found.items() if names} == {}


def test_options_of_the_command_line_are_named_in_ever_fewer_places(root: Path):
    found = {file: len(OPTION.findall(text)) for file, text in kernel(root).items()}
    assert sum(found.values()) <= MAX_OPTIONS, {file: count for file, count in found.items() if count}
