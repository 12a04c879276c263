from pathlib import Path

import numpy as np
import pytest

from tests.kernel.recording import samples
from twin.kernel.errors import RecordingDamageError, RecordingError
from twin.kernel.recording.logs.column_map import column_map
from twin.kernel.recording.logs.log import LogError
from twin.kernel.recording.logs.reader import read_log
from twin.kernel.recording.reader import read
from twin.kernel.recording.writer import Writer


def test_a_recording_of_twin_is_a_log_of_scalars_with_its_times_and_units(tmp_path: Path):
    path = samples.finished(tmp_path / "run.mcap")
    recording, log = read(path), read_log(path)
    np.testing.assert_array_equal(log.vector("plant.p_B").values, recording["plant.p_B"])
    np.testing.assert_array_equal(log["plant.p_B[2]"].t, recording.time("plant"))
    np.testing.assert_array_equal(log["encoder.triggered"].values, recording["encoder.triggered"])
    assert (log["plant.p_B[2]"].unit, log.notes) == ("m", ())


def test_a_run_is_found_by_its_folder(tmp_path: Path):
    samples.finished(tmp_path / "run.mcap")
    assert read_log(tmp_path).path == tmp_path / "run.mcap"


def test_an_unfinished_recording_is_read_and_says_so(tmp_path: Path):
    log = read_log(samples.unfinished(tmp_path / "run.mcap"))
    assert log.notes[0].startswith("unfinished recording: read up to")


def test_a_damaged_recording_is_refused(tmp_path: Path):
    path = samples.finished(tmp_path / "run.mcap")
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)
    with pytest.raises(RecordingDamageError):
        read_log(path)


def test_what_is_not_there_or_empty_is_refused(tmp_path: Path):
    with pytest.raises(RecordingError, match="no recording; expected"):
        read_log(tmp_path)
    with Writer(tmp_path / "run.mcap", samples.TOPICS, 1e-3, {}):
        pass
    with pytest.raises(LogError, match="holds no samples"):
        read_log(tmp_path / "run.mcap")


def test_times_of_a_wall_clock_count_from_the_first_sample_and_the_date_is_noted(tmp_path: Path):
    path = tmp_path / "a.csv"
    path.write_text("t_ms,F_N,G_N\n" + "".join(f"{1.7e12 + 10 * k:.0f},{k},{k}\n" for k in range(20)))
    log = read_log(path)
    # stamps of 1.7e9 s are 2.4e-7 s apart in double precision
    np.testing.assert_allclose(log["F"].t, 0.01 * np.arange(20), atol=3e-7)
    assert log["F"].t is log["G"].t
    assert "2023-11-14 22:13:20 UTC" in log.notes[0]


def test_dropped_samples_are_noted_once_for_all_columns(tmp_path: Path):
    path = tmp_path / "a.csv"
    path.write_text("t_s,F_N,G_N\n" + "".join(f"{k},{k},{k}\n" for k in range(20) if k not in (7, 8)))
    assert read_log(path).notes == ("2 samples missing in a gap of 3 s at 6 s",)


def test_a_map_does_not_touch_a_recording_of_twin(tmp_path: Path):
    path = samples.finished(tmp_path / "run.mcap")
    assert list(read_log(path, column_map(["F=x[N]"])).series) == list(read_log(path).series)
