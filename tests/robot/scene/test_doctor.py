"""pymcap-cli's doctor, which shares no code with the mcap package, finds nothing wrong with a recording."""

import subprocess
import sys
from pathlib import Path

from twin.robot.assembly.load import load_experiment
from twin.robot.run.run import execute


def test_the_doctor_passes_a_recording_with_pictures(root: Path, tmp_path: Path):
    experiment = load_experiment(root / "experiments/fig4_force_position.toml", ["duration_s=0.5"])
    recording = execute(experiment, tmp_path).recording
    command = [str(Path(sys.executable).with_name("pymcap-cli")), "doctor", str(recording)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stdout + done.stderr
    report = " ".join(done.stdout.split())
    assert "passed MCAP doctor checks" in report
    assert not {"error", "warning"} & set(report.split())


def test_the_doctor_finds_a_changed_byte(root: Path, tmp_path: Path):
    experiment = load_experiment(root / "experiments/fig4_force_position.toml", ["duration_s=0.5"])
    recording = execute(experiment, tmp_path).recording
    content = bytearray(recording.read_bytes())
    content[len(content) // 2] ^= 1
    recording.write_bytes(content)
    command = [str(Path(sys.executable).with_name("pymcap-cli")), "doctor", str(recording)]
    assert subprocess.run(command, capture_output=True, timeout=60).returncode != 0
