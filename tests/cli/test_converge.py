import json
from pathlib import Path

import pytest
from PIL import Image

from tests.command_line import twin

POSITION = "experiments/fig4_position.toml"
PRESS = ("reference.p_mm=[[0,0,-101],[0,0,-102],[0,0,-102]]", "reference.t_s=[0,0.2,1]", "duration_s=0.4")
"""From the surface 1 mm into it."""
SETTINGS = [word for text in PRESS for word in ("--set", text)]


@pytest.mark.slow
def test_what_to_use_is_printed_first_and_where_picture_and_facts_are_last(root: Path, tmp_path: Path):
    done = twin("converge", root / POSITION, *SETTINGS, "--tolerance", "0.001", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert lines[0] == "fig4_position: use gauss_seidel, linear at 2 ms"
    assert max(map(len, lines)) <= 80
    picture, facts = (tmp_path / line.split()[1] for line in lines[-2:])
    with Image.open(picture) as image:
        assert image.width >= 1000
    assert json.loads(facts.read_text())["recommended"]["tick_s"] == 0.002
    assert done.stderr == ""


def test_no_coupling_that_is_good_enough_is_exit_code_1(root: Path, tmp_path: Path):
    done = twin("converge", root / POSITION, *SETTINGS, "--tolerance", "1e-12", "--json", cwd=tmp_path)
    assert done.returncode == 1, done.stderr
    facts = json.loads(done.stdout)
    assert facts["recommended"] is None
    assert [one["order"]["F_z"]["finding"] for one in facts["series"]][:2] == ["smooth", "smooth"]


def test_an_experiment_in_the_air_has_orders_and_no_recommendation(root: Path, tmp_path: Path):
    done = twin("converge", root / "experiments/step_z_air.toml", "--duration", "0.8", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("step_z_air: never presses\n")
    assert done.stderr == ""


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("experiments/tapping.toml",), "tapping: its tasks change phase at the measured force"),
        ((POSITION, "--drive", "no_such_drive"), "no such drive"),
        ((POSITION, "--duration", "0"), "invalid value for '--duration'"),
        ((POSITION, "--out", "file"), "file: cannot be created: "),
    ],
)
def test_what_cannot_be_studied_is_refused_in_one_sentence(
    root: Path, tmp_path: Path, arguments: tuple[str, ...], said: str
):
    (tmp_path / "file").touch()
    done = twin("converge", root / arguments[0], *arguments[1:], cwd=tmp_path)
    assert done.returncode == 2
    assert said in done.stderr and len(done.stderr.splitlines()) == 1
