import json
from pathlib import Path

from tests.cli.test_run import twin
from tests.drive.archives import redescribed


def test_info_shows_contract_parameters_and_hash_within_80_columns(root: Path, tmp_path: Path):
    done = twin("drive", "info", root / "fmus/pmsm_foc", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert max(len(line) for line in done.stdout.splitlines()) <= 80
    for word in ("omega_ref", "tau_load", "theta_m", "omega_m", "sha256", "V_bus", "linux64"):
        assert word in done.stdout


def test_info_as_json_is_complete(root: Path, tmp_path: Path):
    facts = json.loads(twin("drive", "info", root / "fmus/velocity_servo", "--json", cwd=tmp_path).stdout)
    assert facts["fmi_version"] == "2.0"
    assert facts["roles"]["theta_m"] == {"causality": "output", "unit": "rad", "unit_stated": True}
    assert facts["parameters"]["droop"]["start"] == "0.6"
    assert facts["warnings"] == []


def test_a_drive_that_does_not_fit_is_exit_code_2(root: Path, tmp_path: Path):
    good = root / "fmus/velocity_servo/velocity_servo.fmu"
    bad = redescribed(good, tmp_path / "bad.fmu", 'name="omega_ref"', 'name="n_cmd"')
    done = twin("drive", "info", bad, cwd=tmp_path)
    assert done.returncode == 2
    assert "no input 'omega_ref'" in done.stderr
