import json
import os
from pathlib import Path

from tests.command_line import twin_process


def test_the_answer_is_the_first_word(root: Path):
    done = twin_process("doctor", cwd=root)
    assert done.returncode == 0, done.stdout
    assert done.stdout.startswith("ready")


def test_what_prevents_a_run_is_exit_code_2_and_named_for_programs_too(root: Path, tmp_path: Path):
    broken = tmp_path / "fmus" / "velocity_servo"
    broken.mkdir(parents=True)
    (broken / "velocity_servo.fmu").write_bytes(b"no archive")
    done = twin_process("doctor", "--json", cwd=tmp_path, env=os.environ | {"PYTHONPATH": str(root)})
    facts = json.loads(done.stdout)
    assert done.returncode == 2
    assert facts["verdict"] == "not ready: drives"
    assert {"topic", "state", "text"} == facts["findings"][0].keys()
