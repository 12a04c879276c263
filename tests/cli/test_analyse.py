import json
from pathlib import Path

import pytest
from PIL import Image

from tests.command_line import twin

FIG4, AIR = "experiments/fig4_force_position.toml", "experiments/step_z_air.toml"


@pytest.mark.slow
def test_analyse_prints_the_verdict_first_and_draws_loops_and_maps(root: Path, tmp_path: Path):
    done = twin("analyse", root / FIG4, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert lines[0] == "fig4_force_position  STABLE at all 5 operating points"
    assert max(map(len, lines)) <= 80
    files = [tmp_path / line.strip() for line in lines[-4:]]
    assert [file.name for file in files] == ["analysis.png", "disks.png", "map.png", "analysis.json"]
    for file in files[:3]:
        with Image.open(file) as image:
            assert image.width >= 1200
    facts = json.loads(files[3].read_text())
    assert facts["stable"] is True and [limit["holds"] for limit in facts["gain_limits"]] == [True, True, True]


def test_an_unstable_loop_is_exit_code_1_and_has_no_margins(root: Path, tmp_path: Path):
    options = ("--set", "controller.position.kp_per_s=60", "--no-try", "--json")
    done = twin("analyse", root / AIR, *options, cwd=tmp_path)
    assert done.returncode == 1, done.stderr
    facts = json.loads(done.stdout)
    assert facts["gain_limits"] == []
    assert facts["points"][0]["loops"] == {} and facts["points"][0]["stable"] is False
    assert [Path(file).name for file in facts["files"]] == ["analysis.png", "analysis.json"]


def test_an_experiment_without_an_operating_point_is_exit_code_2(root: Path, tmp_path: Path):
    weightless = [part for key in ("m_a_g", "m_b_g", "m_p_g") for part in ("--set", f"plant.{key}=0")]
    done = twin("analyse", root / AIR, *weightless, "--set", "plant.I_r_kg_m2=1e-5", cwd=tmp_path)
    assert done.returncode == 2
    assert "no linear model at (0, 0, -85) mm" in done.stderr and "Traceback" not in done.stderr


def test_in_the_hand_it_says_where_it_is_passive_and_draws_it(root: Path, tmp_path: Path):
    done = twin("analyse", root / AIR, "--passivity", "--no-try", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert lines[0].startswith("step_z_air  passive in the hand at 0 of ") and max(map(len, lines)) <= 80
    # nothing presses, and nothing was tried
    assert "renders" not in done.stdout and "carries" not in done.stdout
    folder = tmp_path / "results/analysis/step_z_air"
    with Image.open(folder / "passivity.png") as image:
        assert image.width >= 500
    facts = json.loads((folder / "passivity.json").read_text())
    assert facts["z_width"] is None and facts["points"][0]["not_passive"]["x"]["least"] < 0.0
