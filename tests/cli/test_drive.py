import json
import os
from pathlib import Path

import pytest
from PIL import Image

from tests.command_line import twin
from tests.kernel.fmi.archives import redescribed
from tests.kernel.fmi.faulty import faulty_drive
from twin.studies.qualify.definitions import CHECK_MEANINGS, MEASURE_DEFINITIONS

FIG4 = "experiments/fig4_force_position.toml"


def test_info_shows_contract_parameters_and_hash_within_80_columns(root: Path, tmp_path: Path):
    done = twin("drive", "info", root / "fmus/pmsm_foc", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert max(len(line) for line in done.stdout.splitlines()) <= 80
    for word in ("omega_ref", "tau_load", "theta_m", "omega_m", "sha256", "V_bus", "linux64"):
        assert word in done.stdout


def test_info_as_json_is_complete(root: Path, tmp_path: Path):
    facts = json.loads(twin("drive", "info", root / "fmus/velocity_servo", "--json", cwd=tmp_path).stdout)
    (fmu,) = facts["fmus"]
    assert fmu["fmi_version"] == "2.0"
    assert fmu["parameters"]["droop"]["start"] == 0.6
    assert facts["roles"]["theta_m"] == {"variable": "theta_m", "causality": "output", "unit": "rad", "gain": 1.0}
    assert facts["warnings"] == []


def test_a_drive_that_does_not_fit_is_exit_code_2(root: Path, tmp_path: Path):
    good = root / "fmus/velocity_servo/velocity_servo.fmu"
    bad = redescribed(good, tmp_path / "bad.fmu", 'causality="input"', 'causality="parameter"')
    for command in ("info", "check"):
        done = twin("drive", command, bad, cwd=tmp_path, isolated=True)
        assert done.returncode == 2
        assert "omega_ref" in done.stderr and "Traceback" not in done.stderr
    # what came with it was looked at before
    assert "came with bad.fmu" in done.stdout


def test_info_lists_what_there_is_where_roles_are_unclear(root: Path, tmp_path: Path):
    fmu = root / "fmus/modelica_dc/modelica_dc.fmu"
    done = twin("drive", "info", fmu, cwd=tmp_path)
    assert done.returncode == 2 and "undecided which of its variables is omega_ref" in done.stderr
    heads = [line for line in done.stdout.splitlines() if line.startswith("modelica_dc.fmu: ")]
    assert [head.partition(": ")[2] for head in heads] == ["3 inputs", "1 output", "2 local variables"]
    assert "  v_f " in done.stdout and "  theta_m " in done.stdout and "[N.m]" in done.stdout
    listed = json.loads(twin("drive", "info", fmu, "--json", cwd=tmp_path).stdout)["variables"]
    assert {v["name"] for v in listed} == {"v_a", "v_f", "tau_load", "tau_motor", "theta_m", "omega_m"}


@pytest.mark.slow
def test_check_prints_the_verdict_first_and_draws_a_picture(root: Path, tmp_path: Path):
    done = twin("drive", "check", root / "fmus/stepper", cwd=tmp_path, isolated=True)
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert lines[0] == "stepper.fmu  QUALIFIED"
    assert max(len(line) for line in lines) <= 80
    picture = lines[-1].removeprefix("  picture  ")
    with Image.open(tmp_path / picture) as image:
        assert image.width >= 1200


@pytest.mark.slow
def test_check_as_json_has_every_check_and_measure_with_its_unit(root: Path, tmp_path: Path):
    done = twin("drive", "check", root / "fmus/velocity_servo", "--json", cwd=tmp_path, isolated=True)
    facts = json.loads(done.stdout)
    assert facts["qualified"] is True and facts["failed"] == []
    assert list(facts["checks"]) == list(CHECK_MEANINGS) and list(facts["measures"]) == list(MEASURE_DEFINITIONS)
    droop = facts["measures"]["droop"]
    assert droop["unit"] == "rad/s per N m" and abs(droop["value"] - 0.6) < 1e-6
    assert all(check["meaning"] for check in facts["checks"].values())
    (came,) = facts["references"]
    assert [one["word"] for one in came["experiments"]] == ["agrees"] and "twin's default" in came["tolerance"]
    assert (tmp_path / facts["picture"]).is_file()


@pytest.mark.slow
def test_a_drive_that_fails_the_check_is_exit_code_1_and_the_picture_says_so(root: Path, tmp_path: Path):
    faulty_drive(root, tmp_path)
    (tmp_path / "mapping.toml").write_text('fmu = "faulty.fmu"\n[parameters]\ndroop = 2.0\n')
    done = twin("drive", "check", "mapping.toml", cwd=tmp_path, isolated=True)
    assert done.returncode == 1, done.stderr
    assert done.stdout.startswith("faulty.fmu  NOT QUALIFIED: runs")
    assert (tmp_path / "results/drive_check/faulty.png").is_file()


def test_list_names_every_drive_of_the_shelf_within_80_columns(root: Path):
    done = twin("drive", "list", cwd=root)
    assert done.returncode == 0, done.stderr
    names = [folder.name for folder in (root / "fmus").iterdir() if any(folder.glob("*.fmu"))]
    assert all(any(line.startswith(name) for line in done.stdout.splitlines()) for name in names)
    assert max(len(line) for line in done.stdout.splitlines()) <= 80
    assert {drive["name"] for drive in json.loads(twin("drive", "list", "--json", cwd=root).stdout)} == set(names)


def test_new_writes_a_mapping_that_the_check_takes_and_never_overwrites_it(root: Path, tmp_path: Path):
    (tmp_path / "servo.fmu").write_bytes((root / "fmus/velocity_servo/velocity_servo.fmu").read_bytes())
    done = twin("drive", "new", "servo.fmu", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    written = (tmp_path / "mapping.toml").read_text()
    assert twin("drive", "info", "mapping.toml", cwd=tmp_path).returncode == 0
    again = twin("drive", "new", "servo.fmu", cwd=tmp_path)
    assert again.returncode == 2
    assert "never overwritten" in again.stderr
    assert (tmp_path / "mapping.toml").read_text() == written


@pytest.mark.slow
def test_compare_says_first_who_is_better_and_draws_a_picture_and_a_page_of_each_experiment(root: Path, tmp_path: Path):
    experiments = ("--experiment", root / FIG4, "--experiment", "step_z_air", "--set", "duration_s=2", "--body", "back")
    words = ("velocity_servo", "stepper", *experiments, "--out", tmp_path / "x", "--html", "--json")
    facts = json.loads(twin("drive", "compare", *words, cwd=root).stdout)
    assert facts["verdict"][0].startswith("stepper beside velocity_servo: ")
    assert facts["set"] == ["duration_s=2", "body back"]
    for one in facts["experiments"]:
        assert [drive["drive"] for drive in one["drives"]] == ["velocity_servo", "stepper"]
        with Image.open(one["picture"]) as image:
            assert image.width >= 1200
    page = Path(facts["page"]).read_text()
    assert page.index(facts["verdict"][0]) < page.index("fig4_force_position</h2>") < page.index("step_z_air</h2>")
    assert page.count("data:image/png;base64,") == 2


def test_help_of_every_command_fits_80_columns(tmp_path: Path):
    for command in ("info", "list", "new", "check", "compare"):
        done = twin("drive", command, "--help", cwd=tmp_path, env=os.environ | {"COLUMNS": "80"})
        assert done.returncode == 0
        assert max(len(line) for line in done.stdout.splitlines()) <= 80
