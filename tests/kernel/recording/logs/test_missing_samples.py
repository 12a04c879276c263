"""One rule for samples that are missing, whatever kind of file they are missing in."""

import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.writer import Writer

from tests.conftest import examples
from tests.kernel.recording.logs.bags import bag, joints, logged, refusal, wrench
from twin.kernel.recording.logs.column_map import column_map
from twin.kernel.recording.logs.log import MAX_INVALID_SHARE, Log, LogError, LogSeries, join_rows, refuse_invalid
from twin.kernel.recording.logs.reader import read_log

EMPTY = ("", " ")
INVALID = (
    *("nan", "NaN", "-nan", "inf", "-inf", "Infinity", "null", "None", "N/A", "1e300", "NaT", "missing"),
    # of C libraries and spreadsheets, and dashes
    *(
        "-nan(ind)",
        "nan(0x8000)",
        "1.#QNAN",
        "-1.#IND00",
        "1.#INF",
        "#DIV/0!",
        "#WERT!",
        "#N/A",
        "#NAME?",
        "-",
        "--",
        "?",
    ),
)
ROWS = 12


def read_text(folder: Path, text: str, *maps: str) -> Log:
    (folder / "a.csv").write_text(text, newline="")
    return read_log(folder / "a.csv", column_map(maps))


@examples(60)
@given(
    cells=st.lists(
        st.lists(st.one_of(st.floats(-9, 9).map(repr), st.sampled_from(EMPTY + INVALID)), min_size=3, max_size=3),
        min_size=ROWS,
        max_size=ROWS,
    ),
    state=st.sampled_from(["running", "running, ok", "", "3", "3,14", 'a "b" c']),
    separator=st.sampled_from([",", ";", "\t", "|"]),
    mapped=st.booleans(),
)
def test_a_column_has_the_rows_in_which_it_has_a_number(
    tmp_path_factory: pytest.TempPathFactory, cells: list[list[str]], state: str, separator: str, mapped: bool
):
    quoted = '"' + state.replace('"', '""') + '"'
    head = ["t_s", "a_N", "b_m", "c", "state"]
    lines = [[f"{0.1 * k:.1f}", *row, quoted] for k, row in enumerate(cells)]
    text = f"sep={separator}\n" + "".join(separator.join(line) + "\n" for line in [head, *lines])
    # the second column of the file is one that everybody can read
    text = text.replace(f"t_s{separator}", f"t_s{separator}ok{separator}")
    text = "".join(
        line if k < 2 else line.replace(separator, f"{separator}{k}{separator}", 1)
        for k, line in enumerate(text.splitlines(True))
    )
    maps = ["a=a_N", "b=b_m", "c=c", "ok=ok"] if mapped else []
    log = read_text(tmp_path_factory.mktemp("a"), text, *maps)
    for place, name in enumerate("abc"):
        column = [row[place].strip() for row in cells]
        there = [k for k, cell in enumerate(column) if cell and cell not in INVALID]
        if len(there) < 2:
            assert name not in log.series and name in log.left_out and any(name in note for note in log.notes)
            continue
        assert log[name].t.tolist() == [float(f"{0.1 * k:.1f}") for k in there]
        assert log[name].values.tolist() == [float(column[k]) for k in there]
        assert len(log[name].invalid) == sum(cell in INVALID for cell in column)
    assert len(log["ok"].t) == ROWS


def test_a_last_line_that_is_cut_anywhere_costs_at_most_itself(tmp_path: Path):
    whole = "t_s,a_N,b_m\n" + "".join(f"0.{k},-1.5e-3,{k}.25\n" for k in range(10))
    last = whole.splitlines(True)[-1]
    for cut in range(1, len(last)):
        log = read_text(tmp_path, whole[: -len(last) + cut])
        assert len(log["a"].t) in (9, 10) and log["b"].values[:9].tolist() == [k + 0.25 for k in range(9)]
        # nothing says that more digits were to come, or that a field was
        assert log.notes or len(log["b"].t) in (9, 10)
    # a row in the middle is no end
    with pytest.raises(LogError, match="line 4: 2 fields, expected 3"):
        read_text(tmp_path, whole.replace("0.2,-1.5e-3,2.25", "0.2,-1.5e-3"))


@examples(40)
@given(
    zeros=st.sampled_from([0, 1, 5000]),
    cut=st.sampled_from([0, 1, 4, 9]),
    comments=st.sets(st.integers(0, 9)),
    trailing=st.booleans(),
    end=st.sampled_from(["\n", "\r\n", "\r"]),
)
def test_what_loggers_leave_between_and_after_the_rows_costs_no_row(
    tmp_path_factory: pytest.TempPathFactory, zeros: int, cut: int, comments: set[int], trailing: bool, end: str
):
    """Comments, a separator after the last field of each row, zeros after a crash."""
    rows = [f"0.{k},-1.5,{k}.25{',' * trailing}{end}" for k in range(10)]
    lines = [f"# restarted, at {k}{end}{row}" if k in comments else row for k, row in enumerate(rows)]
    text = f"t_s,a_N,b_m{end}{''.join(lines)}"
    log = read_text(tmp_path_factory.mktemp("a"), text[: len(text) - cut] + "\0" * zeros)
    assert log["b"].values[:9].tolist() == [k + 0.25 for k in range(9)]
    assert ("zeros at its end are left out" in log.notes) == bool(zeros)
    assert set(log.series) == {"a", "b"}


@pytest.mark.parametrize(
    "when",
    [
        *("2025-05-01 12:00:00", "2025-05-01T12:00:00.5Z", "20250501T120000Z", "5/1/2025 12:00:00 PM", "1.5.2025"),
        *("01-May-2025 12:00:00", "1 May 2025", "Thu May  1 12:00:00 2025", "12:00:00.5", "0 days 00:00:00.010"),
    ],
)
@pytest.mark.parametrize("name", ["time", "t_s"])
def test_dates_are_called_dates(tmp_path: Path, when: str, name: str):
    with pytest.raises(LogError, match=f"time column '{name}' holds the date or time of day"):
        read_text(tmp_path, f"{name},F_N\n{when},1\n{when},2\n")


def test_zeros_in_the_middle_are_no_text(tmp_path: Path):
    with pytest.raises(LogError, match="not a text file"):
        read_text(tmp_path, "t_s,F_N\n0,1\n\0\0\n1,2\n2,3\n")


def test_a_column_that_nobody_asks_for_never_refuses_a_log(tmp_path: Path):
    odd = {"state": "off", "x [lbs]": "1", "": "", "twice": "1", "date": "2025-05-01", "komma": "3,14", "mixed": "1"}
    names = [*odd, "twice"]
    rows = "".join(f"{k},{k},{','.join(chr(34) + odd[name] + chr(34) for name in names)}\n" for k in range(5))
    log = read_text(tmp_path, f"t_s,F_N,{','.join(names)}\n{rows}".replace('"1"\n', '"on"\n', 1))
    assert set(log.series) == {"F", "mixed"}
    assert {"state", "x", "twice", "date", "komma"} <= set(log.left_out)
    for name in ("x", "twice", "komma"):
        assert any(name in note for note in log.notes)
        with pytest.raises(LogError):
            log[name]
    with pytest.raises(LogError, match="two columns are named 'twice'"):
        read_text(tmp_path, (tmp_path / "a.csv").read_text(), "q=twice")


def json_log(path: Path, messages: list[dict[str, object]]) -> Path:
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(library="robot's own")
        channel = writer.register_channel("/j", "json", writer.register_schema("J", "jsonschema", b"{}"))
        for k, message in enumerate(messages):
            writer.add_message(channel, k * 10**7, json.dumps(message).encode(), k * 10**7)
        writer.finish()
    return path


@examples(40)
@given(st.lists(st.sampled_from(["number", "null", "nan", "absent", "empty", "short"]), min_size=8, max_size=30))
def test_messages_without_a_value_are_no_samples_of_it(tmp_path_factory: pytest.TempPathFactory, kinds: list[str]):
    """A value that is null or NaN counts as invalid; a field, name or element that is not there does not."""
    kinds = ["number", "absent", *kinds, "number"]
    made: dict[str, dict[str, object]] = {
        "number": {"z": 1.0, "name": ["a.b"], "position": [2.0]},
        "null": {"z": None, "name": ["a.b"], "position": [None]},
        "nan": {"z": math.nan, "name": ["a.b"], "position": [math.nan]},
        "absent": {},
        "empty": {"name": [], "position": []},
        "short": {"name": ["a.b"], "position": []},
    }
    path = json_log(tmp_path_factory.mktemp("a") / "a.mcap", [{"ok": 1.0, **made[kind]} for kind in kinds])
    log = read_log(path, column_map(["z=/j.z[N]", "q=/j.position.a.b[rad]", 'r=/j.position."a.b"[rad]', "ok=/j.ok"]))
    there = [k for k, kind in enumerate(kinds) if kind == "number"]
    for name, value in (("z", 1.0), ("q", 2.0), ("r", 2.0)):
        np.testing.assert_allclose(log[name].t, 0.01 * np.array(there))
        assert set(log[name].values) == {value}
        assert len(log[name].invalid) == kinds.count("null") + kinds.count("nan")


def test_a_field_is_absent_if_no_message_has_it(tmp_path: Path):
    path = json_log(tmp_path / "a.mcap", [{"z": 1.0}, {}, {"z": 2.0}])
    with pytest.raises(LogError, match="/j has no field 'y'; it has z"):
        read_log(path, column_map(["y=/j.y"]))
    names = [(1.0 + 0.01 * k, joints(1.0 + 0.01 * k, **({} if k < 3 else {"knee": 0.1 * k}))) for k in range(10)]
    folder = bag(tmp_path / "b", {"/js": names})
    assert len(logged(folder, "q=/js.position.knee")["q"].t) == 7
    assert "its name is empty" in refusal(folder, "q=/js.position.elbow")


def test_a_share_of_invalid_samples_up_to_the_limit_is_read():
    refuse_invalid(Path("a"), "x", round(1000 * MAX_INVALID_SHARE), 1000)
    with pytest.raises(LogError, match="51 of 1000 samples of x are NaN, null or infinite, expected at most 5 %"):
        refuse_invalid(Path("a"), "x", 51, 1000)


@examples(50)
@given(
    late=st.floats(-0.49, 0.49), jitter=st.floats(0.0, 0.004), lost=st.sets(st.integers(0, 49)), seed=st.integers(0, 99)
)
def test_samples_less_than_half_a_period_apart_make_one_row(late: float, jitter: float, lost: set[int], seed: int):
    t = np.asarray(0.01 * np.arange(50), dtype=np.float64)
    noise = jitter * (np.random.default_rng(seed).uniform(size=50) - 0.5) * (1.0 - 2.0 * abs(late))
    keep = np.array([k not in lost for k in range(50)])
    if keep.sum() < 2:
        return
    one, two = LogSeries(t, t, "1"), LogSeries((t + 0.01 * late + noise)[keep], t[keep], "1")
    rows = join_rows([one, two])
    assert rows.t.tolist() == t[keep].tolist()
    assert rows.values.tolist() == np.column_stack([t, t])[keep].tolist()


def test_a_part_of_a_log_is_read_by_its_own_time(tmp_path: Path):
    text = "t_s,F_N\n" + "".join(f"{1.7e9 + k},{'nan' if k < 3 else k}\n" for k in range(20))
    (tmp_path / "a.csv").write_text(text)
    log = read_log(tmp_path / "a.csv", part=(5.0, None))
    assert log["F"].values.tolist() == list(range(8, 20))
    assert len(log["F"].invalid) == 0 and not any("not a number" in note for note in log.notes)
    with pytest.raises(LogError, match="no samples from 90 to inf s; it has 0 to 16 s"):
        read_log(tmp_path / "a.csv", part=(90.0, None))
    with pytest.raises(LogError, match="expected a start before the end"):
        read_log(tmp_path / "a.csv", part=(2.0, 1.0))


def test_force_that_is_never_measured_is_left_out_and_named(tmp_path: Path):
    times = [1.0 + 0.01 * k for k in range(30)]
    said: dict[str, Sequence[tuple[float, Any]]] = {
        "/js": [(t, joints(t, m=1.0)) for t in times],
        "/ft": [(t, wrench(t, math.nan)) for t in times],
    }
    log = logged(bag(tmp_path / "b", said), "m=/js.position.m", "scale.F_z=/ft.wrench.force.z")
    assert list(log.series) == ["m"] and "left out: /ft.wrench.force.z is nan in all messages" in log.notes[0]
