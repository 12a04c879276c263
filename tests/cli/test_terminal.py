"""Nothing that a file says is obeyed by a terminal."""

import fcntl
import io
import itertools
import os
import re
import shlex
import struct
import subprocess
import sys
import termios
import threading
import time
from collections.abc import Sequence
from pathlib import Path

import pytest

from tests.cli.test_run import FIG4
from tests.cli.test_run_text import RUN
from tests.command_line import twin
from twin.cli import terminal as compiling
from twin.cli import terminal as display
from twin.cli import terminal as progress
from twin.cli.ask import ask
from twin.cli.streams import EscapingTerminal, print_answer
from twin.cli.terminal import TYPICAL_PIECES, Bar, PlainLine, PlainProgress, TerminalDisplay, program
from twin.cli.terminal import compiling_text as compiling_text
from twin.studies.check.study import check
from twin.studies.command import Answer

NAME = "\x1b]0;owned\x07[bold]x[/y]\x9b31m"


def test_control_characters_are_written_out_and_colours_stay():
    stream = io.StringIO()
    print("\x1b[1;31mtwin\x1b[0m µ\t" + NAME + "\b\0", file=EscapingTerminal(stream))  # type: ignore[arg-type]
    shown = "\\x1b]0;owned\\x07[bold]x[/y]\\x9b31m\\x08\\x00"
    assert stream.getvalue() == "\x1b[1;31mtwin\x1b[0m µ\t" + shown + "\n"


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize("line", [Bar, PlainLine])
def test_the_name_of_a_run_is_neither_markup_nor_an_escape(line: type, monkeypatch: pytest.MonkeyPatch):
    seen = Terminal()
    monkeypatch.setattr("sys.stderr", seen)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "200")
    shown = line()
    shown.begin(NAME, 1.0)
    shown.move(0.5)
    shown.clear()
    assert "[bold]x[/y]" in seen.getvalue()
    assert not {"\x07", "\x9b"} & set(seen.getvalue()) and "\x1b]" not in seen.getvalue()


def test_what_to_run_next_can_be_copied_whatever_the_name(root: Path, tmp_path: Path):
    folder = "it's $HOME; a b"
    done = twin("init", f"{folder}/my 'x'.toml", cwd=tmp_path)
    command = done.stdout.splitlines()[-1].removeprefix("next: ")
    assert shlex.split(command) == ["twin", "run", f"{folder}/my 'x'.toml"]
    assert shlex.split((tmp_path / folder / "my 'x'.toml").read_text().partition("Run this: ")[2].splitlines()[0])
    arguments = ["--set", "duration_s=0.1", "--isolate", "none", "--out", f"{folder}/run"]
    ran = twin("run", f"{folder}/my 'x'.toml", *arguments, cwd=tmp_path)
    command = ran.stdout.splitlines()[-1].partition("next")[2]
    assert shlex.split(command) == ["twin", "report", f"{folder}/run"]


def test_what_was_counted_before_says_nothing_of_how_long_the_rest_takes(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("sys.stderr", Terminal())
    bar = Bar()
    for share in (0.0, 0.5, 0.9):
        bar.step("checking", share)
        time.sleep(0.01)
    (task,) = bar._line.tasks
    assert task.time_remaining is not None
    bar.compile(2, 13, 1.0)
    assert (task.total, task.time_remaining) == (13, None)
    bar.compile(2, 0, 1.0)
    assert task.total is None
    bar.step("checking", 0.1)
    assert (task.total, task.time_remaining) == (1.0, None)
    bar.clear()


@pytest.mark.parametrize("line", [Bar, PlainLine])
def test_checks_are_counted_on_a_line_that_is_gone_in_the_end(
    line: type[PlainProgress], root: Path, monkeypatch: pytest.MonkeyPatch
):
    seen = Terminal()
    monkeypatch.setattr("sys.stderr", seen)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setattr(display, "progress", line)
    names = ("step_z_air", "step_z_low")
    asked = {
        "experiments": [root / f"experiments/{name}.toml" for name in names],
        "drives": ["velocity_servo"],
        "baselines": root / "tests/no_such_folder",
        "out": root / "results/check",
        "isolate": "none",
    }
    # there is no baseline
    with pytest.raises(SystemExit, match="2"):
        ask(check, asked)
    # a bar is drawn a few times a second only
    assert "of 2 checks" in seen.getvalue()
    # written over, or erased
    assert seen.getvalue().endswith((" \r", "\x1b[2K"))


def test_without_a_terminal_a_line_a_minute_says_how_far_a_long_run_is(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    now = 0.0
    monkeypatch.setattr(progress.time, "monotonic", lambda: now)
    line = PlainProgress()
    line.begin("fig4", 20.0)
    for now in (1.0, 31.0, 91.0, 121.0, 152.0):
        line.move(now / 1600.0)
    assert capsys.readouterr().err.splitlines() == [
        " fig4  1.1 / 20.0 s  0.0125 x real time  25 minutes left".strip(),
        " fig4  1.9 / 20.0 s  0.0125 x real time  24 minutes left".strip(),
    ]


class Heard(PlainProgress):
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
    monkeypatch.setattr(compiling, "object_files", lambda: range(TYPICAL_PIECES))
    return heard


@pytest.mark.parametrize(
    ("counts", "told"),
    [
        ([0, 0, 3, TYPICAL_PIECES - 1], [(3, TYPICAL_PIECES), (TYPICAL_PIECES - 1, TYPICAL_PIECES)]),
        # a run with tasks on a body needs more than one of Fig. 4
        ([0, 0, 3, TYPICAL_PIECES + 4], [(3, TYPICAL_PIECES), (TYPICAL_PIECES + 4, 0)]),
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

    monkeypatch.setattr(compiling, "object_files", lambda: range(counted()))
    monkeypatch.setattr(compiling, "WATCH_INTERVAL", 0.001)
    with TerminalDisplay(as_json=False) as shown:
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

    monkeypatch.setattr(compiling, "object_files", lambda: range(counted()))
    monkeypatch.setattr(compiling, "WATCH_INTERVAL", 0.001)
    with TerminalDisplay(as_json=True):
        assert told_twice.wait(60.0)
    told = capsys.readouterr()
    assert told.out == "" and told.err == "compiling, once: some 10 s, more on a busy machine\n"


def test_a_run_that_is_refused_before_anything_is_compiled_does_not_speak_of_it(monkeypatch, capsys):
    monkeypatch.setattr(compiling, "object_files", list)
    monkeypatch.setattr(compiling, "WATCH_INTERVAL", 0.001)
    with TerminalDisplay(as_json=True):
        time.sleep(0.02)
    assert capsys.readouterr().err == ""


def test_runs_follow_one_another_and_the_next_step_names_all_of_them(heard: Heard, tmp_path: Path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    with TerminalDisplay(as_json=False) as shown:
        for name in ("a", "b"):
            folder = tmp_path / "results" / name / "2026"
            folder.mkdir(parents=True)
            shown.on_note({"experiment": name, "folder": str(folder), "duration": 20.0})
            shown.show(5, 10)
            shown.on_note({"run": RUN | {"recording": str(folder / "run.mcap")}})
    assert heard.told[1:] == [("a", 20.0), 0.5, ("b", 20.0), 0.5]
    out = capsys.readouterr().out
    assert out.endswith("  next       twin report results/a/2026 results/b/2026\n")
    assert re.findall(r"recording +(.*)", out) == ["results/a/2026/run.mcap", "results/b/2026/run.mcap"]


def test_the_clock_keeps_its_width_and_speed_is_simulated_over_wall_time(monkeypatch: pytest.MonkeyPatch):
    now = iter([0.0, 10.0, 10.05, 12.0])
    monkeypatch.setattr("twin.cli.terminal.time.monotonic", lambda: next(now))
    line, said = PlainProgress(), list[str]()
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


@pytest.mark.parametrize("line", ["next  twin run a.toml", "  next       twin report a b", "next: twin run a.toml"])
def test_every_next_line_begins_with_what_a_shell_finds(line: str, monkeypatch: pytest.MonkeyPatch, capsys):
    monkeypatch.setattr("sys.argv", ["/some where/twin", "tune"])
    print_answer(Answer(f"twin\n{line}\n  note  twin", {}))
    quoted = line.replace("twin", "'/some where/twin'", 1)
    assert capsys.readouterr().out == f"twin\n{quoted}\n  note  twin\n"


pty = pytest.importorskip("pty", reason="Windows has no pseudo-terminals")

LONG = ["--set", "duration_s=60"]


def seen(root: Path, cwd: Path, columns: int = 80, words: Sequence[str] = (), **environment: str) -> str:
    """Everything that comes to a terminal of so many columns from `twin run`, or from `twin WORDS`."""
    master, slave = pty.openpty()
    fcntl.ioctl(slave, termios.TIOCSWINSZ, struct.pack("HHHH", 24, columns, 0, 0))
    inherited = {key: value for key, value in os.environ.items() if key not in ("NO_COLOR", "COLUMNS")}
    process = subprocess.Popen(
        [sys.executable, "-m", "twin", *(words or ("run", str(root / FIG4), *LONG))],
        cwd=cwd, stdout=slave, stderr=slave, env=inherited | {"TERM": "xterm-256color"} | environment,
    )  # fmt: skip
    os.close(slave)
    parts = []
    while True:
        try:
            part = os.read(master, 65536)
        # Linux reports the end of a terminal as an error
        except OSError:
            break
        if not part:
            break
        parts.append(part)
    os.close(master)
    assert process.wait() == 0
    return b"".join(parts).decode()


@pytest.mark.slow
def test_a_terminal_shows_how_far_the_run_is_and_then_only_the_summary(root: Path, tmp_path: Path):
    text = seen(root, tmp_path)
    assert "loading" in text and re.search(r"\d+\.\d / 60\.0 s", text)
    # the line is erased before the summary
    assert "\x1b[2K" in text.rpartition("fig4_force_position  60 s at ")[0]
    assert "\x1b" not in text.rpartition("fig4_force_position  60 s at ")[2].partition("next")[0]


@pytest.mark.endurance
def test_the_first_run_of_all_counts_what_it_compiles(root: Path, tmp_path: Path):
    text = seen(root, tmp_path, NUMBA_CACHE_DIR=str(tmp_path / "compiled"))
    counted = [int(count) for count in re.findall(rf"compiling, once: (\d+) of about {TYPICAL_PIECES}", text)]
    assert counted == sorted(counted) and len(set(counted)) > 3
    # "about": within a fifth
    assert abs(len(list((tmp_path / "compiled").rglob("*.o"))) - TYPICAL_PIECES) < 0.2 * TYPICAL_PIECES


@pytest.mark.slow
def test_without_colour_there_is_no_escape_code_and_no_line_is_too_long(root: Path, tmp_path: Path):
    columns = 40
    text = seen(root, tmp_path, columns, NO_COLOR="1")
    assert "\x1b" not in text
    progress = [part for part in re.split(r"[\r\n]+", text) if " / 60.0 s" in part]
    assert progress and max(map(len, progress)) < columns


@pytest.mark.slow
def test_a_dumb_terminal_gets_what_a_pipe_gets(root: Path, tmp_path: Path):
    text = seen(root, tmp_path, TERM="dumb")
    assert text.startswith("fig4_force_position  60 s at ")
    assert "\x1b" not in text and "\r" not in text.replace("\r\n", "\n")


@pytest.mark.slow
def test_a_study_shows_what_it_is_doing_how_much_is_over_and_leaves_only_its_answer(root: Path, tmp_path: Path):
    words = ("drive", "compare", "ideal_velocity", "--experiment", "step_z_air", "--experiment", "step_z_low")
    text = seen(root, tmp_path, words=words)
    first, second = (text.index(f"{name} with ideal_velocity, {n} of 2") for n, name in enumerate(words[4::2], 1))
    assert " 0%" in text[first:second] and " 50%" in text[second:]
    assert "\x1b[2K" in text[second:] and "\x1b" not in text.rpartition("energy: no output")[2]
    plain = seen(root, tmp_path, words=words, NO_COLOR="1")
    assert "step_z_low with ideal_velocity, 2 of 2  50%" in plain and "\x1b" not in plain


def test_what_is_left_is_told_once_it_can_be_known(monkeypatch: pytest.MonkeyPatch):
    now = [0.0]
    monkeypatch.setattr("twin.cli.terminal.time.monotonic", lambda: now[0])
    line, said = PlainProgress(), list[str]()
    monkeypatch.setattr(line, "say", said.append)
    steps = (
        (0.0, "a", 0.0),
        (60.0, "first of 774", 1 / 774),
        (200.0, "b", 0.25),
        (201.0, "c", None),
        (799.5, "d", 0.9995),
    )
    for at, what, share in steps:
        now[0] = at
        line.step(what, share)
    # the first of many has compiled: by it the others would take 13 hours
    assert said == ["a  0%", "first of 774  0%", "b  25%  about 10 minutes left", "c", "d  100%"]
