"""A log of a robot beside a run: read with the map beside it, on its own clock; a page names no path."""

import base64
import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.laws.runs import shipped
from tests.report.explore.test_worker import BASE
from twin.kernel.process.reporter import DirectReporter
from twin.report.explore.logs import known_logs
from twin.report.explore.worker import answer_request
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
    Path("logs/robot.map.toml").write_text(MAP)
    return "logs/robot.csv"


def answer(op: str, **more: Any) -> dict[str, Any]:
    ask = {"op": op, "panels": ["Pressing force F_z", "Height z"], "span": None, "width": 4000, **more}
    found: dict[str, Any] = json.loads(
        json.dumps(answer_request(DirectReporter(lambda note: None), os.getcwd(), BASE, ask))
    )
    return found


def curve(found: dict[str, Any], label: str, title: str = "Pressing force F_z") -> tuple[np.ndarray, np.ndarray]:
    block = np.frombuffer(base64.b64decode(found["block"]), "<f4")
    (row,) = (
        row for panel in found["panels"] if panel["title"] == title for row in panel["rows"] if row["label"] == label
    )
    at, count, start, step = row["curve"]
    return start + step * np.arange(count), block[at : at + count]


def test_counts_become_the_estimates_that_the_controller_had_and_the_gap_stays_open(run: Trace, robot_csv: str):
    found = answer("log", log=robot_csv)
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
    t, _ = curve(answer("log", log=robot_csv, shift_s=2.5), "scale")
    assert t[0] == pytest.approx(2.5)


def test_a_log_without_a_map_beside_it_is_read_by_the_names_of_its_columns(robot_csv: str):
    Path("logs/robot.map.toml").unlink()
    refused = answer("log", log=robot_csv)["refused"]
    assert "clock (s)" in refused and refused.endswith("robot.map.toml next to it: twin log new logs/robot.csv")
    # names of twin's own need no map
    table = Path(robot_csv)
    table.write_text(table.read_text().replace("clock (s)", "t_s").replace("load (N)", "scale.F_z_N"))
    t, force = curve(answer("log", log=robot_csv), "scale")
    assert t[0] == pytest.approx(0.0, abs=1e-3) and np.isfinite(force).any()


@pytest.mark.parametrize(
    ("more", "expected"),
    [
        ({"log": "/etc/passwd"}, "no such log below the current folder"),
        ({"log": "logs/../../x.csv"}, "no such log below"),
        ({"log": ["x"]}, "log: expected the path of a log"),
        ({"shift_s": "now"}, "shift_s: expected a time"),
    ],
)
def test_what_a_page_may_not_name_is_a_sentence(robot_csv: str, more: dict[str, Any], expected: str):
    found = answer("log", **{"log": robot_csv} | more)
    assert expected in found["refused"]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ('time = "clok (s)"', "clok"),
        ("/etc/passwd", "not valid TOML"),
        ('time = "clock (s)"\n"other.thing" = "arm1"', "no signal of the plots that are shown"),
        (MAP.replace("arm1", "load (N)"), "differ in unit"),
    ],
)
def test_a_map_that_fits_no_robot_is_a_sentence(robot_csv: str, text: str, expected: str):
    Path("logs/robot.map.toml").write_text(text)
    assert expected in answer("log", log=robot_csv)["refused"]


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
