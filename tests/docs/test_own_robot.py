"""docs/own_robot.md is what a new user sees, in an empty folder and with a robot of another shape."""

import json
import re
import shlex
from pathlib import Path

import pytest

from tests.command_line import twin
from tests.docs.code_blocks import blocks
from twin.kernel.recording.reader import read

PAGE = "docs/own_robot.md"


def typed(command: str, folder: Path) -> str:
    done = twin(*shlex.split(command, comments=True)[1:], cwd=folder, env={"COLUMNS": "80"})
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.slow
def test_the_first_commands_press_5_newtons_in_an_empty_folder(root: Path, tmp_path: Path):
    first = blocks(root, PAGE)[0]
    commands = [command for command, _ in first.commands]
    assert [command.split()[1] for command in commands] == ["init", "init", "run", "run"]
    outputs = [typed(command, tmp_path) for command in commands]
    assert "below 6 Hz" not in " ".join(outputs)
    assert "surface at z = -130.0 mm, height_mm of the experiment (computed: 4 mm" in " ".join(outputs[3].split())
    runs = sorted((tmp_path / "results" / "press").glob("2*"))
    assert len(runs) == 2
    for folder in runs:
        recording = read(folder / "run.mcap")
        assert recording["controller.F_z_ref"].max() == 5.0
        assert abs(-recording["plant.F_ee_B"][-1, 2] - 5.0) < 0.25
    assert "lateral error while held 3.03 mm" in " ".join(outputs[2].split())


@pytest.mark.slow
def test_the_robot_of_the_page_does_the_whole_massage(root: Path, tmp_path: Path):
    typed(blocks(root, PAGE)[0].commands[0][0], tmp_path)
    typed("twin init knead.toml --robot my_robot.toml --from massage", tmp_path)
    # exit code 4 if the monitor trips
    assert "task 4: " in typed("twin run knead.toml", tmp_path)


def test_a_platform_wider_than_the_base_is_as_soft_as_the_page_states(root: Path, tmp_path: Path):
    text = (root / PAGE).read_text()
    (lengths, stiffness, frequency) = re.findall(r"long rods, make them soft: (.+) has (\d+) N/m and (\d+) Hz", text)[0]
    assert "below 6 Hz" in typed(f"twin init --robot soft.toml --lengths-mm {lengths}", tmp_path)
    typed("twin robot soft.toml --no-rank", tmp_path)
    facts = json.loads((tmp_path / "results/robot/soft/robot.json").read_text())
    assert round(facts["stiffness"][0]) == int(stiffness) and round(facts["natural_frequency"][0]) == int(frequency)


@pytest.mark.slow
def test_the_page_prints_what_twin_robot_prints(root: Path, tmp_path: Path):
    typed(blocks(root, PAGE)[0].commands[0][0], tmp_path)
    text = typed("twin robot my_robot.toml", tmp_path)
    (shown,) = (block.text for block in blocks(root, PAGE) if block.text.startswith("my_robot: "))
    assert text.startswith(shown)
    facts = json.loads((tmp_path / "results/robot/my_robot/robot.json").read_text())
    assert {"reach_z", "radius", "stiffness", "smallest_force", "largest_force", "weight"} <= facts.keys()


def test_every_key_that_a_urdf_fills_exists(root: Path):
    from twin.robot.plant.dynamics import TrueRobot

    known = {field.alias for field in TrueRobot.model_fields.values()}
    table = (root / PAGE).read_text().partition("| URDF | here |")[2].partition("\n\n")[0]
    keys = {
        word
        for line in table.splitlines()
        if line.count("|") > 3
        for word in line.split("|")[2].split("`")
        if "_" in word
    }
    keys -= {"[controller] speed_limit_rad_per_s"}
    assert len(keys) >= 12
    assert keys <= known | {"k_s_Nm_per_rad"}
