import itertools
import re
import threading
import time
from pathlib import Path

import pytest

from tests.report.test_run_text import RUN
from twin.cli import compiling, display, progress
from twin.cli.compiling import PIECES
from twin.cli.display import Display, program
from twin.cli.progress import Progress
from twin.cli.progress import compiling as compiling_text


def test_without_a_terminal_a_line_a_minute_says_how_far_a_long_run_is(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    now = 0.0
    monkeypatch.setattr(progress.time, "monotonic", lambda: now)
    line = Progress()
    line.begin("fig4", 20.0)
    for now in (1.0, 31.0, 91.0, 121.0, 152.0):
        line.move(now / 1600.0)
    assert capsys.readouterr().err.splitlines() == [
        " fig4  1.1 / 20.0 s  0.0125 x real time  25 minutes left".strip(),
        " fig4  1.9 / 20.0 s  0.0125 x real time  24 minutes left".strip(),
    ]


class Heard(Progress):
    """Keeps what it is told."""

    def __init__(self) -> None:
        super().__init__()
        self.told: list[object] = []

    def say(self, what: str) -> None:
        self.told.append(what)

    def compile(self, done: int, about: int, seconds: float) -> None:
        self.told.append((done, about))

    def begin(self, name: str, duration: float) -> None:
        self.told.append((name, duration))

    def move(self, share: float) -> None:
        self.told.append(share)


@pytest.fixture
def heard(monkeypatch: pytest.MonkeyPatch) -> Heard:
    heard = Heard()
    monkeypatch.setattr(display, "progress", lambda: heard)
    monkeypatch.setattr(compiling, "compiled_pieces", lambda: PIECES)
    return heard


@pytest.mark.parametrize(
    ("counts", "told"),
    [
        ([0, 0, 3, PIECES - 1], [(3, PIECES), (PIECES - 1, PIECES)]),
        # a run with tasks on a body needs more than one of Fig. 4
        ([0, 0, 3, PIECES + 4], [(3, PIECES), (PIECES + 4, 0)]),
        # compiled in part, by whoever was interrupted: how many are lacking nobody knows
        ([60, 60, 61, 70], [(1, 0), (10, 0)]),
        ([95, 95, 95, 95], []),
    ],
)
def test_what_is_compiled_is_told_piece_by_piece_until_the_run_moves(heard: Heard, monkeypatch, counts, told):
    left, all_counted = iter(counts), threading.Event()

    def counted() -> int:
        found = next(left, None)
        if found is None:
            all_counted.set()
        return counts[-1] if found is None else found

    monkeypatch.setattr(compiling, "compiled_pieces", counted)
    monkeypatch.setattr(compiling, "PERIOD", 0.001)
    with Display(as_json=False) as shown:
        assert all_counted.wait(60.0)
        # the first step may have to wait for the last piece
        before = len(heard.told)
        shown.show(0, 10)
        assert 0.0 not in heard.told[before:]
        shown.show(1, 10)
        # the line belongs to the run from now on
        before = len(heard.told)
        time.sleep(0.02)
        shown.show(2, 10)
        assert heard.told[before:] == [0.2]
    said = [entry for entry in heard.told if isinstance(entry, tuple)]
    assert list(dict.fromkeys(said)) == list(dict.fromkeys(told))


def test_without_a_terminal_the_long_wait_is_one_plain_line(monkeypatch, capsys):
    counts, told_twice = itertools.count(), threading.Event()

    def counted() -> int:
        number = next(counts)
        if number > 2:
            told_twice.set()
        return number

    monkeypatch.setattr(compiling, "compiled_pieces", counted)
    monkeypatch.setattr(compiling, "PERIOD", 0.001)
    with Display(as_json=True):
        assert told_twice.wait(60.0)
    told = capsys.readouterr()
    assert told.out == "" and told.err == "compiling, once: some 10 s, more on a busy machine\n"


def test_a_run_that_is_refused_before_anything_is_compiled_does_not_speak_of_it(monkeypatch, capsys):
    monkeypatch.setattr(compiling, "compiled_pieces", lambda: 0)
    monkeypatch.setattr(compiling, "PERIOD", 0.001)
    with Display(as_json=True):
        time.sleep(0.02)
    assert capsys.readouterr().err == ""


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


def test_the_clock_keeps_its_width_and_speed_is_simulated_over_wall_time(monkeypatch: pytest.MonkeyPatch):
    now = iter([0.0, 10.0, 10.05, 12.0])
    monkeypatch.setattr("twin.cli.progress.time.monotonic", lambda: next(now))
    line, said = Progress(), list[str]()
    monkeypatch.setattr(line, "say", said.append)
    line.begin("a", 1000.0)
    for share in (0.001, 0.002, 0.801):
        line.move(share)
    assert said == ["   1.0 / 1000.0 s", "   2.0 / 1000.0 s", " 801.0 / 1000.0 s  400 x real time"]


def test_what_is_compiled_leaves_room_for_a_bar():
    assert compiling_text(12, 13, 9.2) == "compiling, once: 12 of about 13, 9 s"
    assert compiling_text(12, 0, 9.2) == "compiling, once: 12, 9 s"


def test_a_command_to_copy_begins_with_what_a_shell_finds(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    programs = {name: tmp_path / name / "twin" for name in ("here", "other")}
    for file in programs.values():
        file.parent.mkdir()
        file.write_text("")
        file.chmod(0o755)
    called = str(programs["here"])
    for path, argument, said in (
        ("nowhere", called, called),
        ("here", called, "twin"),
        ("other", called, called),
        ("here", "twin", "twin"),
        ("here", "/x/twin/__main__.py", "twin"),
    ):
        monkeypatch.setenv("PATH", str(tmp_path / path))
        monkeypatch.setattr("sys.argv", [argument, "run"])
        assert program() == said
