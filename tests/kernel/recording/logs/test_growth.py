"""Readers of logs take work in proportion to what a log holds, of each format and in each direction."""

import json
from collections.abc import Callable
from pathlib import Path

import pytest
from mcap.writer import Writer

from tests.growth import assert_linear
from tests.kernel.recording.logs.bags import bag, joints
from twin.kernel.recording.logs.column_map import column_map
from twin.kernel.recording.logs.log import Log
from twin.kernel.recording.logs.reader import read_log


def many_rows(folder: Path, n: int) -> Path:
    rows = "".join(f"{k},{k}.5,{'' if k % 3 else 'nan'}\n" for k in range(100 * n))
    (folder / "a.csv").write_text("t_s,F_N,G_N\n" + rows)
    return folder / "a.csv"


def many_columns(folder: Path, n: int) -> Path:
    head = ",".join(f"a{k}_N" for k in range(4 * n))
    rows = "".join(f"{k}{f',{k}' * (4 * n)}\n" for k in range(4))
    (folder / "a.csv").write_text(f"t_s,{head}\n{rows}")
    return folder / "a.csv"


def many_comments(folder: Path, n: int) -> Path:
    (folder / "a.csv").write_text("# by a logger\n" * (100 * n) + "t_s,F_N\n0,1\n1,2\n")
    return folder / "a.csv"


def words(folder: Path, n: int) -> Path:
    rows = "".join(f"{k},{k},state {k}\n" for k in range(100 * n))
    (folder / "a.csv").write_text("t_s,F_N,state\n" + rows)
    return folder / "a.csv"


def mcap(folder: Path, n: int, topics: int = 1) -> Path:
    with (folder / "a.mcap").open("wb") as file:
        writer = Writer(file, chunk_size=4096)
        writer.start(library="robot's own")
        schema = writer.register_schema("J", "jsonschema", b"{}")
        channels = [writer.register_channel(f"/j{k or ''}", "json", schema) for k in range(topics)]
        for k in range(n):
            for channel in channels:
                writer.add_message(channel, k * 10**6, json.dumps({"F": k, "none": None}).encode(), k * 10**6)
        writer.finish()
    return folder / "a.mcap"


def many_messages(folder: Path, n: int) -> Path:
    return mcap(folder, 25 * n)


def many_topics(folder: Path, n: int) -> Path:
    return mcap(folder, 4, 4 * n)


def ros_bag(storage: str) -> Callable[[Path, int], Path]:
    def written(folder: Path, n: int) -> Path:
        times = [1.0 + 0.01 * k for k in range(10 * n)]
        return bag(folder / "bag", {"/js": [(t, joints(t, m=t)) for t in times]}, storage)

    return written


CSV = {"rows": many_rows, "columns": many_columns, "comments": many_comments, "words": words}
MCAP = {"messages": many_messages, "topics": many_topics}
BAGS = {"mcap": ros_bag("mcap"), "sqlite3": ros_bag("sqlite3")}


@pytest.mark.parametrize(
    ("written", "maps"),
    [
        *(pytest.param(one, (), id=f"csv {name}") for name, one in CSV.items()),
        *(pytest.param(one, ("F=/j.F",), id=f"mcap {name}") for name, one in MCAP.items()),
        *(pytest.param(one, ("q=/js.position.m",), id=f"bag {name}") for name, one in BAGS.items()),
    ],
)
def test_a_log_of_four_times_the_size_takes_four_times_the_work(
    written: Callable[[Path, int], Path], maps: tuple[str, ...], tmp_path: Path
):
    columns = column_map(maps)

    def prepared(n: int) -> Callable[[], Log]:
        folder = tmp_path / str(n)
        folder.mkdir()
        file = written(folder, n)
        return lambda: read_log(file, columns)

    assert_linear(prepared, 24)
