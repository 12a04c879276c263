from pathlib import Path

from tests.command_line import twin
from tests.recording import samples
from tests.recording.export.readers import csv_columns


def test_a_run_is_exported_beside_its_recording(tmp_path: Path):
    samples.finished(tmp_path / "run.mcap")
    done = twin("export", ".", "--csv", "--signals", "plant.p_B", "--signals", "scale", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout == "run.csv  3 signals, 1500 rows\n"
    assert len(csv_columns(tmp_path / "run.csv")["t_s"]) == 1500


def test_two_formats_at_once_are_refused(tmp_path: Path):
    samples.finished(tmp_path / "run.mcap")
    done = twin("export", ".", "--csv", "--mat", cwd=tmp_path)
    assert done.returncode == 2
    assert done.stderr == "got 2 formats; expected one of --csv, --parquet and --mat\n"
