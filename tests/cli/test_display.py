import re
from pathlib import Path

import pytest

from tests.report.test_run_text import RUN
from twin.cli import display
from twin.cli.display import Display
from twin.cli.progress import Silent, Speed, clock


class Heard(Silent):
    """Keeps what it is told."""

    def __init__(self) -> None:
        self.told: list[object] = []

    def say(self, what: str) -> None:
        self.told.append(what)

    def begin(self, name: str, duration: float) -> None:
        self.told.append((name, duration))

    def move(self, share: float) -> None:
        self.told.append(share)


@pytest.fixture
def heard(monkeypatch: pytest.MonkeyPatch) -> Heard:
    heard = Heard()
    monkeypatch.setattr(display, "progress", lambda: heard)
    return heard


@pytest.mark.parametrize(("warm", "said"), [(True, "loading"), (False, "compiling for the first time, up to a minute")])
def test_the_first_run_of_all_says_that_it_compiles(heard: Heard, monkeypatch, warm: bool, said: str):
    monkeypatch.setattr(display, "is_warm", lambda: warm)
    with Display(as_json=False):
        assert heard.told == [said]


def test_runs_follow_one_another_and_the_next_step_names_all_of_them(heard: Heard, tmp_path: Path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    with Display(as_json=False) as shown:
        for name in ("a", "b"):
            folder = tmp_path / "results" / name / "2026"
            folder.mkdir(parents=True)
            shown.hear({"experiment": name, "folder": str(folder), "duration": 20.0})
            shown.show(5, 10)
            shown.hear({"run": RUN | {"recording": str(folder / "run.mcap")}})
    assert heard.told[1:] == [("a", 20.0), 0.5, ("b", 20.0), 0.5]
    out = capsys.readouterr().out
    assert out.endswith("  next       twin report results/a/2026 results/b/2026\n")
    assert re.findall(r"recording +(.*)", out) == ["results/a/2026/run.mcap", "results/b/2026/run.mcap"]


def test_the_clock_keeps_its_width():
    assert [clock(share, 200.0) for share in (0.0, 0.5, 1.0)] == [
        "  0.0 / 200.0 s",
        "100.0 / 200.0 s",
        "200.0 / 200.0 s",
    ]


def test_speed_is_simulated_over_wall_time(monkeypatch: pytest.MonkeyPatch):
    now = iter([10.0, 10.05, 12.0])
    monkeypatch.setattr("twin.cli.progress.time.monotonic", lambda: next(now))
    speed = Speed()
    assert [speed.text(simulated) for simulated in (1.0, 2.0, 801.0)] == ["", "", "400 x real time"]
