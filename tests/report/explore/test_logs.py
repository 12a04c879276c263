"""A log of a robot beside a run: read with a map as `twin replay` reads it, on its own clock; a page names no path."""

import base64
import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.kernel.recording.test_writer import largest_file
from tests.laws.runs import shipped
from tests.report.explore.test_worker import BASE
from twin.kernel.errors import NotWritten
from twin.kernel.process.reporter import DirectReporter
from twin.report.explore.brought import inspected, settled
from twin.report.explore.logs import known_logs, stored
from twin.report.explore.worker import answered
from twin.robot.run.trace import Trace, run_in_memory

MAP = "\n".join(
    ['time = "clock (s)"', *(f'"encoder.count_{c}[{i}]" = "{name}{i + 1}"' for c, name in (("m", "motor"), ("l", "arm"))
                             for i in range(3)), '"scale.F_z" = "-load (N)"']
)  # fmt: skip


@pytest.fixture(scope="module")
def run() -> Trace:
    return run_in_memory(shipped("fig4_force_position", "duration_s=8", "scale.period_ms=2"))


@pytest.fixture
def robot_csv(run: Trace, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """What a robot of other names and signs would have written, without what it lost between 3 and 3.1 s."""
    monkeypatch.chdir(tmp_path)
    t, counts = run.time("encoder"), np.hstack([run["encoder.count_m"], run["encoder.count_l"]])
    rows = np.column_stack([t, counts, -run["scale.F_z"]])[(t < 3.0) | (t > 3.1)]
    Path("logs").mkdir()
    head = "clock (s),motor1,motor2,motor3,arm1,arm2,arm3,load (N)"
    np.savetxt("logs/robot.csv", rows, "%.9g", ",", header=head, comments="")
    return "logs/robot.csv"


def answer(op: str, **more: Any) -> dict[str, Any]:
    ask = {"op": op, "panels": ["Pressing force F_z", "Height z"], "span": None, "width": 4000, **more}
    found: dict[str, Any] = json.loads(json.dumps(answered(DirectReporter(lambda note: None), os.getcwd(), BASE, ask)))
    return found


def curve(found: dict[str, Any], label: str, title: str = "Pressing force F_z") -> tuple[np.ndarray, np.ndarray]:
    block = np.frombuffer(base64.b64decode(found["block"]), "<f4")
    (row,) = (
        row for panel in found["panels"] if panel["title"] == title for row in panel["rows"] if row["label"] == label
    )
    at, count, start, step = row["curve"]
    return start + step * np.arange(count), block[at : at + count]


def test_counts_become_the_estimates_that_the_controller_had_and_the_gap_stays_open(run: Trace, robot_csv: str):
    found = answer("log", log=robot_csv, map=MAP)
    t, height = curve(found, "estimated", "Height z")
    gap = (t > 2.999) & (t < 3.101)
    assert np.all(np.isnan(height[(t > 3.001) & (t < 3.099)])) and not np.any(np.isnan(height[~gap]))
    own = np.interp(t[~gap], run.time("estimator"), 1e3 * run["estimator.p_B"][:, 2])
    np.testing.assert_allclose(height[~gap], own, atol=1e-4)
    # the scale's reading with its sign taken round
    t, force = curve(found, "scale")
    np.testing.assert_allclose(force[-100:], run["scale.F_z"][-100:], rtol=1e-6)
    assert "missing" in found["note"]


def test_a_log_that_begins_later_is_shifted(robot_csv: str):
    t, _ = curve(answer("log", log=robot_csv, map=MAP, shift_s=2.5), "scale")
    assert t[0] == pytest.approx(2.5)


def test_the_map_that_lies_beside_or_that_of_twin_log_new_is_proposed(robot_csv: str):
    assert 'column = "clock (s)"' in answer("columns", log=robot_csv)["map"]
    Path("logs/robot.map.toml").write_text(MAP)
    assert answer("columns", log=robot_csv)["map"] == MAP


@pytest.mark.parametrize(
    ("more", "expected"),
    [
        ({"log": "/etc/passwd"}, "no such log below the current folder"),
        ({"log": "logs/../../x.csv"}, "no such log below"),
        ({"log": ["x"]}, "log: expected the path of a log"),
        ({"map": 'time = "clok (s)"'}, "clok"),
        ({"map": "/etc/passwd"}, "not valid TOML"),
        ({"map": "x" * 9000}, "at most 8000 characters"),
        ({"map": 1}, "at most 8000"),
        ({"shift_s": "now"}, "shift_s: expected a time"),
        ({"map": 'time = "clock (s)"\n"other.thing" = "arm1"'}, "no signal of the plots that are shown"),
        ({"map": MAP.replace("arm1", "load (N)")}, "differ in unit"),
    ],
)
def test_what_a_page_may_not_name_and_what_fits_no_robot_is_a_sentence(
    robot_csv: str, more: dict[str, Any], expected: str
):
    found = answer("log", **{"log": robot_csv, "map": MAP} | more)
    assert expected in found["refused"]


def test_logs_are_looked_for_below_the_folder_but_not_behind_links_and_not_for_ever(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    here = tmp_path / "here"
    for name in ("a.csv", "deep/er/b.mcap", "deep/er/run.mcap", ".hidden/c.csv", "d/e/f/g/h.csv", "notes.txt"):
        (here / name).parent.mkdir(parents=True, exist_ok=True)
        (here / name).touch()
    (here / "bag").mkdir()
    (here / "bag" / "metadata.yaml").touch()
    (here / "bag" / "part.db3").touch()
    (tmp_path / "away.csv").touch()
    (here / "link.csv").symlink_to(tmp_path / "away.csv")
    monkeypatch.chdir(here)
    assert known_logs() == ["a.csv", "bag", "deep/er/b.mcap"]


def test_a_log_that_was_brought_in_is_one_of_them_under_the_same_name_every_time(robot_csv: str):
    path = stored(Path(robot_csv))
    assert path == stored(Path(robot_csv)) and path in known_logs()
    assert Path(path).read_bytes() == Path(robot_csv).read_bytes()


def test_a_disk_that_is_full_is_a_sentence_and_leaves_no_half_of_what_was_brought_in(robot_csv: str, root: Path):
    fmu = root / "fmus/ideal_velocity/ideal_velocity.fmu"
    roles = {role["role"]: role["chosen"] for role in inspected(fmu)["commands"]["velocity"] if role["chosen"]}
    with largest_file(1000):
        with pytest.raises(NotWritten, match=r"results/explored/robot-\w{8}.csv: cannot be written: File too large"):
            stored(Path(robot_csv))
        with pytest.raises(NotWritten, match=r"ideal_velocity.fmu: cannot be written: File too large"):
            settled(fmu, {"command": "velocity", "roles": roles})
    assert [path for path in Path("results").rglob("*") if path.is_file()] == []
    assert Path(stored(Path(robot_csv))).is_file()
