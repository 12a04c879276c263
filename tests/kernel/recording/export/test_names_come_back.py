"""Names of others come back through export, comparison and a proposed map as they are."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from tests.conftest import examples
from twin.kernel.errors import InputRefused
from twin.kernel.recording.export.export import export_recording
from twin.kernel.recording.export.table import SignalColumn, SignalTable, write_csv
from twin.kernel.recording.logs.column_map import TIME_NAMES, column_map, split_unit
from twin.kernel.recording.logs.csv_file import heading, read_csv
from twin.kernel.recording.logs.log import LogError
from twin.kernel.recording.logs.reader import read_log
from twin.kernel.recording.messages import Field, Topic
from twin.kernel.recording.writer import Writer
from twin.studies.compare.comparison import read_logs
from twin.studies.compare.study import compare
from twin.studies.replay.map_proposal import propose

UNITS = ("1", "A", "m", "mm", "N", "N m", "rad/s", "m/s2", "N m/rad", "K", "Pa", "degC")
WORDS = st.sampled_from(["i", "x", "T", "F_z", "speed", "x[2]", "a b", "=1", "-x", 'q"', "a,b", "ä", "'q", "_", "t"])
ENDINGS = st.sampled_from(["", "_A", "_mm", "_s", "_N", "_N_m", "[rpm]", " [m]", " (N)", "_per_s", "_rad_per_s", "[0]"])
NAMES = st.one_of(st.builds("{}{}".format, WORDS, ENDINGS), st.text(min_size=1, max_size=6))
T = np.arange(4) * 0.5


@examples(150)
@given(st.lists(st.tuples(NAMES, st.sampled_from(UNITS)), min_size=1, max_size=6, unique_by=lambda one: one[0]))
def test_an_export_reads_back_beside_its_source_with_every_name(
    tmp_path_factory: pytest.TempPathFactory, signals: list[tuple[str, str]]
):
    path = tmp_path_factory.mktemp("a") / "a.csv"
    names = [(name, unit) for name, unit in signals if name.strip() == name and name.isprintable()]
    assume(names)
    columns = [SignalColumn(name, unit, "", k + T) for k, (name, unit) in enumerate(names)]
    heads = ["t_s", *(heading(name, unit) for name, unit in names)]
    if len(set(heads)) < len(heads):
        with pytest.raises(InputRefused, match="two columns would be named"):
            write_csv(path, SignalTable(T, tuple(columns)))
        return
    write_csv(path, SignalTable(T, tuple(columns)))
    log = read_csv(path, {}, dict(names))
    assert {name: (one.unit, one.values[0]) for name, one in log.series.items()} == {
        name: (unit, float(k)) for k, (name, unit) in enumerate(names)
    }


def recorded(path: Path, names: tuple[str, ...]) -> Path:
    topic = Topic("model", tuple(Field(name, 1, "double", "1", "") for name in names), 1)
    rows = np.random.default_rng(1).normal(size=(50, len(names)))
    with Writer(path, [topic], 1e-3, {}) as writer:
        writer.write("model", 0, rows)
    return path


def test_outputs_named_like_units_are_all_compared(tmp_path: Path):
    run = recorded(tmp_path / "run.mcap", ("i_A", "x_mm", "T_s", "F_z_N"))
    file = export_recording(run, "csv").path
    for one, other in ((run, file), (file, run), (file, file)):
        answer = compare(lambda *_: None, [one, other], out=tmp_path / "out")
        assert answer.exit_code == 0 and "in common" not in answer.text
        assert len(answer.facts["rows"]) == 4
    assert {name.partition(".")[2] for name in read_logs(file, run)[0].series} == {"i_A", "x_mm", "T_s", "F_z_N"}
    # alone it has the names of 1.0
    assert set(read_log(file).series) == {"model.i", "model.x", "model.T", "model.F_z"}


def test_a_comparison_of_few_of_many_signals_says_so_first(tmp_path: Path):
    rows = "".join(f"{k},{k},{k},{k},{k}\n" for k in range(5))
    (tmp_path / "a.csv").write_text("t_s,a,b,c,d\n" + rows)
    (tmp_path / "b.csv").write_text("t_s,a,x,y,z\n" + rows)
    logs = [tmp_path / "a.csv", tmp_path / "b.csv"]
    answer = compare(lambda *_: None, logs, out=tmp_path / "out")
    assert answer.text.splitlines()[0].startswith("1 of 4 signals in common: B stays within")
    answer = compare(lambda *_: None, logs, signals=["a"], out=tmp_path / "out")
    assert answer.text.splitlines()[0].startswith("B stays within")


COLUMNS = st.lists(
    st.one_of(NAMES, st.text(min_size=1, max_size=5)), min_size=1, max_size=5, unique_by=lambda one: one.strip()
)


@examples(100)
@given(COLUMNS, st.integers(0, 3))
def test_the_map_that_is_proposed_reads_the_file_it_was_made_for(
    tmp_path_factory: pytest.TempPathFactory, others: list[str], place: int
):
    """Columns of other names beside those of a robot change nothing."""
    own = ["stamp_ms", *(f"q_{side}{k}_deg" for side in ("motor", "link") for k in (1, 2, 3)), "Fz (N)"]
    others = [name for name in others if name.strip() == name and not set(name) & set("\0\r\n\ud800")]
    assume(not any(split_unit(name)[0] in (*TIME_NAMES, *own) for name in others))
    head = [*own[:place], *others, *own[place:]]
    folder = tmp_path_factory.mktemp("a")
    quoted = ",".join('"' + name.replace('"', '""') + '"' for name in head)
    values = {name: 10 * k for k, name in enumerate(own)}
    rows = [",".join(str(values.get(name, 7) + (k if name in values else -k)) for name in head) for k in range(4)]
    (folder / "robot.csv").write_text("\n".join([quoted, *rows, ""]), encoding="utf-8")
    try:
        path, _ = propose(folder / "robot.csv")
    except LogError:
        # a byte that no text file has, or nothing but numbers
        assert head[0].startswith("#") or all(name.isnumeric() for name in head)
        return
    columns = column_map([path])
    if not {f"estimator.theta_m[{k}]" for k in range(3)} <= set(columns):
        return
    log = read_log(folder / "robot.csv", columns)
    for k in range(3):
        assert np.degrees(log[f"estimator.theta_m[{k}]"].values[0]) == pytest.approx(10.0 * (k + 1))
        assert np.degrees(log[f"estimator.theta_l[{k}]"].values[0]) == pytest.approx(10.0 * (k + 4))


@pytest.mark.parametrize(
    ("entry", "value"),
    [("a=x[2]", 1.0), ("a=-x", 2.0), ("a=y[rpm]", 3.0), ("a=z", 4e-3), ("a=-z[m]", -4.0), ("a=k[lbs]", 5.0)],
)
def test_a_map_means_the_column_of_that_whole_name_first(tmp_path: Path, entry: str, value: float):
    (tmp_path / "a.csv").write_text("t_s,x[2],-x,y[rpm],z_mm,k[lbs]\n0,1,2,3,4,5\n1,1,2,3,4,5\n")
    if entry == "a=k[lbs]":
        with pytest.raises(LogError, match="unknown unit 'lbs'"):
            read_log(tmp_path / "a.csv", column_map([entry]))
        return
    scale = 2.0 * np.pi / 60.0 if "rpm" in entry else 1.0
    assert read_log(tmp_path / "a.csv", column_map([entry]))["a"].values[0] == pytest.approx(value * scale)


def test_a_name_that_two_columns_could_mean_is_refused_with_both(tmp_path: Path):
    (tmp_path / "a.csv").write_text("t_s,F_N,F_mN\n0,1,2\n1,1,2\n")
    with pytest.raises(LogError, match="column 'F' for a could be F_N or F_mN; expected one of them"):
        read_log(tmp_path / "a.csv", column_map(["a=F"]))
