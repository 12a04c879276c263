import json
from pathlib import Path

import pytest

from tests.command_line import twin
from tests.studies.replay.logs import ran


@pytest.mark.slow
def test_it_ends_with_exit_code_0_and_prints_facts(tmp_path: Path):
    done = twin("identify", ran("calibration_one_pose").path, "--out", "x", "--json", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    facts = json.loads(done.stdout)
    assert facts["quantities"]["k_s"]["value"] is None
    assert facts["one_pose"]["as printed"] > 1.4


def test_a_log_without_excitation_has_one_sentence_and_exit_code_1(tmp_path: Path):
    done = twin("identify", ran("step_z_air").path, "--out", "x", cwd=tmp_path)
    assert done.returncode == 1
    assert done.stdout == "" and "Traceback" not in done.stderr
    assert len(done.stderr.splitlines()) == 1 and "experiments/calibration.toml" in done.stderr
    assert not (tmp_path / "x").exists()


def test_what_is_no_log_is_one_sentence_and_exit_code_2(tmp_path: Path):
    done = twin("identify", "log.csv", cwd=tmp_path)
    assert done.returncode == 2
    assert "log.csv: no such file" in done.stderr and "Traceback" not in done.stderr


@pytest.mark.slow
def test_the_papers_procedure_is_printed_if_it_is_asked_for(tmp_path: Path):
    done = twin("identify", ran("calibration_one_pose").path, "--out", "x", "--paper", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "  paper      Sec. III.A on the press of" in done.stdout and "as printed" in done.stdout
