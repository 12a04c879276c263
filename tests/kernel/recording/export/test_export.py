import csv
import re
from pathlib import Path

import numpy as np
import pytest
import scipy.io

from tests.kernel.recording import samples
from tests.kernel.recording.export.readers import csv_columns
from twin.kernel.errors import InputRefused, NotWritten
from twin.kernel.recording.export.export import export_recording
from twin.kernel.recording.export.table import NS_PER_S, SignalColumn, SignalTable, row_times, write_csv
from twin.kernel.recording.reader import read

pq = pytest.importorskip("pyarrow.parquet")


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """The sample recording: topics of periods 1, 2 and 40 ticks, with counts and truth values."""
    return samples.finished(tmp_path / "run.mcap")


@pytest.mark.parametrize("form", ["csv", "parquet", "mat"])
def test_the_same_recording_gives_the_same_bytes(run: Path, tmp_path: Path, form):
    export_recording(run, form, out=tmp_path / "a")
    export_recording(run, form, out=tmp_path / "b")
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()
    assert not list(tmp_path.glob("*.partial"))


def test_every_number_of_the_fastest_topic_comes_back_from_csv_exactly(run: Path):
    columns = csv_columns(export_recording(run, "csv").path)
    truth = samples.truth()
    np.testing.assert_array_equal(columns["t_s"], np.arange(samples.TICKS) / 1000)
    for i in range(3):
        np.testing.assert_array_equal(columns[f"plant.p_B[{i}]_m"], truth["plant.p_B"][:, i])
    np.testing.assert_array_equal(columns["drive/2.omega_m_rad_per_s"], truth["drive/2.omega_m"])


def test_names_that_are_formulas_commas_or_escapes_do_no_harm_in_a_spreadsheet(tmp_path: Path):
    names = ("=1+1", "+a", "-a", "@a", "a,b", 'a"b', "a\nb", "\x1b[31ma", "\ta", "plant.p_B[0]")
    columns = tuple(SignalColumn(name, "m", "", np.array([0.5, -1.5])) for name in names)
    write_csv(tmp_path / "a.csv", SignalTable(np.array([0.0, 1.0]), columns))
    text = (tmp_path / "a.csv").read_text()
    assert len(text.splitlines()) == 3 and "\x1b" not in text
    with (tmp_path / "a.csv").open(newline="") as file:
        head, *rows = csv.reader(file)
    assert rows == [["0.0", *["0.5"] * 10], ["1.0", *["-1.5"] * 10]]
    assert not any(name.startswith(("=", "+", "-", "@", "\t")) for name in head)
    assert head[1] == "'=1+1_m" and head[5:8] == ["a,b_m", 'a"b_m', "a\\nb_m"] and head[-1] == "plant.p_B[0]_m"


def test_the_head_of_an_ordinary_recording_needs_no_quotes(run: Path):
    head = export_recording(run, "csv").path.read_text().splitlines()[0]
    assert '"' not in head and "'" not in head and head.startswith("t_s,")


def test_a_slower_signal_keeps_its_value_until_the_next(run: Path):
    columns = csv_columns(export_recording(run, "csv").path)
    readings = samples.truth()["scale.n"]
    np.testing.assert_array_equal(columns["scale.n"], np.repeat(readings, 40)[: samples.TICKS].astype(float))


def test_rows_at_a_rate_hold_the_newest_values_and_nothing_in_between(run: Path):
    columns = csv_columns(export_recording(run, "csv", ["plant.p_B"], rate=400.0).path)
    t = np.arange(600) / 400
    np.testing.assert_array_equal(columns["t_s"], t)
    # 2.5 ms apart: every other row lies between two ticks
    np.testing.assert_array_equal(columns["plant.p_B[0]_m"], samples.truth()["plant.p_B"][np.arange(600) * 5 // 2, 0])


def test_parquet_holds_kinds_units_and_where_the_run_comes_from(run: Path):
    table = pq.read_table(export_recording(run, "parquet", ["encoder", "plant.p_B"]).path)
    truth = samples.truth()
    assert table.schema.field("plant.p_B[2]").metadata[b"unit"] == b"m"
    assert table.schema.field("encoder.triggered").type == "bool"
    assert b"press" in table.schema.metadata[b"experiment"]
    counts = table["encoder.count_m[1]"].to_numpy()
    assert counts.dtype == np.int64
    np.testing.assert_array_equal(counts, np.repeat(truth["encoder.count_m"][:, 1], 2))


def test_matlab_gets_a_struct_per_topic_with_its_own_times_and_units(run: Path):
    path = export_recording(run, "mat").path
    mat = scipy.io.loadmat(path, simplify_cells=True)
    truth = samples.truth()
    np.testing.assert_array_equal(mat["plant"]["F_ee_B"], truth["plant.F_ee_B"])
    np.testing.assert_array_equal(mat["scale"]["t"], np.arange(38) * 40 / 1000)
    np.testing.assert_array_equal(mat["drive_3"]["theta_m"], truth["drive/3.theta_m"])
    assert mat["units"]["drive_3"]["omega_m"] == "rad/s"
    columns = scipy.io.loadmat(path)["plant"][0, 0]
    assert columns["t"].shape == (samples.TICKS, 1)
    assert columns["p_B"].shape == (samples.TICKS, 3)


def test_matlab_at_a_rate_has_one_time_base(run: Path):
    mat = scipy.io.loadmat(export_recording(run, "mat", rate=100.0).path, simplify_cells=True)
    assert {len(mat[name]["t"]) for name in ("plant", "encoder", "scale", "drive_1")} == {150}


def test_a_file_is_replaced_only_when_that_is_asked_for(run: Path):
    path = export_recording(run, "csv", ["scale"]).path
    before = path.read_bytes()
    with pytest.raises(InputRefused, match="exists; replace it with --force"):
        export_recording(run, "csv")
    assert path.read_bytes() == before
    export_recording(run, "csv", ["scale.n"], force=True)
    assert path.read_bytes() != before


def test_an_unfinished_recording_is_exported_as_far_as_it_goes_and_says_so(tmp_path: Path):
    partial = samples.unfinished(tmp_path / "run.mcap")
    exported = export_recording(partial, "csv", ["plant.p_B"])
    assert exported.note == read(partial).note != ""
    assert exported.path == tmp_path / "run.csv"


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"patterns": ["plnt.p_B"]}, r"no signal is called plnt.p_B; did you mean 'plant.p_B'"),
        ({"patterns": ["plant.p_C*"]}, r"did you mean 'plant.p_B'"),
        ({"patterns": ["xyz"]}, r"there are plant.\*, drive/1.\*"),
        ({"rate": 0.0}, "rate 0 Hz: expected more than 0"),
        ({"rate": float("nan")}, "rate nan Hz: expected more than 0"),
        ({"rate": 1e9}, "at most 1e\\+06 Hz"),
    ],
)
def test_what_cannot_be_exported_is_one_sentence(run: Path, arguments, said: str):
    with pytest.raises(InputRefused, match=said) as refused:
        export_recording(run, "csv", **arguments)
    assert "\n" not in str(refused.value)
    assert not list(run.parent.glob("*.csv*"))


def test_a_rate_that_only_repeats_samples_is_refused():
    # 101 samples, a wrong time in the last: 10 Hz would make 5 million rows of them
    times = 1_000_000 * np.arange(101)
    assert len(row_times([times], 100_000.0)) == 10_001
    times[-1] = 500_000 * NS_PER_S
    with pytest.raises(
        InputRefused, match=r"^rate 10 Hz: makes 5000001 rows out of 101 samples, over 500000 s; choose"
    ):
        row_times([times], 10.0)


def test_a_rate_that_fills_the_memory_is_refused():
    # 20 s at 1 kHz, all of it at 1 MHz
    times = 1_000_000 * np.arange(20_001)
    said = r"^rate 1e\+06 Hz: makes 20000001 rows of 150 numbers, 24 GB; choose a lower one, or fewer signals"
    with pytest.raises(InputRefused, match=said):
        row_times([times], 1e6, 150)
    assert len(row_times([times], 1e6, 3)) == 20_000_001


def test_rows_are_written_in_blocks_as_in_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    table = SignalTable(
        np.arange(7.0), (SignalColumn("a", "1", "", np.arange(7) > 3), SignalColumn("b", "m", "", np.arange(7) / 3))
    )
    write_csv(tmp_path / "whole.csv", table)
    monkeypatch.setattr("twin.kernel.recording.export.table.BLOCK_ROWS", 3)
    write_csv(tmp_path / "blocks.csv", table)
    assert (tmp_path / "blocks.csv").read_bytes() == (tmp_path / "whole.csv").read_bytes()


def test_a_place_that_refuses_is_one_sentence(run: Path, tmp_path: Path):
    (tmp_path / "file").touch()
    place = tmp_path / "file" / "all.csv"
    with pytest.raises(NotWritten, match=f"^{re.escape(str(place))}: cannot be written: Not a directory$"):
        export_recording(run, "csv", out=place)


def test_without_pyarrow_the_extra_is_named(run: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(__import__("sys").modules, "pyarrow", None)
    with pytest.raises(InputRefused, match=r"needs pyarrow; install it with: pip install 'pyarrow>="):
        export_recording(run, "parquet")
    assert [path.name for path in run.parent.iterdir()] == ["run.mcap"]
