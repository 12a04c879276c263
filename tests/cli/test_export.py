from pathlib import Path

from tests.command_line import twin
from tests.kernel.recording import samples
from tests.kernel.recording.export.readers import csv_columns


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
    assert done.stderr == "twin export: expected one of --csv, --parquet, --mat and --ros2, got --csv and --mat\n"


def test_a_bag_of_ros_2_is_written_and_a_damaged_one_refused(tmp_path: Path):
    samples.finished(tmp_path / "run.mcap")
    done = twin("export", ".", "--ros2", "--signals", "plant.p_B", cwd=tmp_path)
    assert done.stdout == "run_ros2  1 signals, 1500 messages\n", done.stderr
    file = tmp_path / "run_ros2/run_ros2_0.mcap"
    content = bytearray(file.read_bytes())
    content[len(content) // 2] ^= 1
    file.write_bytes(content)
    done = twin("export", "run_ros2", "--map", "run_ros2/map.toml", "--csv", cwd=tmp_path)
    assert done.returncode == 2
    assert done.stderr.startswith("run_ros2/run_ros2_0.mcap: damaged near byte") and done.stderr.count("\n") == 1
