"""Nothing that a file says is obeyed by a terminal."""

import io
import shlex
import time
from pathlib import Path

import pytest

from tests.command_line import twin
from twin.cli import ask
from twin.cli.progress import Bar, PlainLine, Progress
from twin.cli.terminal import Harmless
from twin.studies.command import JobIsolation

NAME = "\x1b]0;owned\x07[bold]x[/y]\x9b31m"


def test_control_characters_are_written_out_and_colours_stay():
    stream = io.StringIO()
    print("\x1b[1;31mtwin\x1b[0m µ\t" + NAME + "\b\0", file=Harmless(stream))  # type: ignore[arg-type]
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
    line: type[Progress], root: Path, monkeypatch: pytest.MonkeyPatch
):
    seen = Terminal()
    monkeypatch.setattr("sys.stderr", seen)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setattr(ask, "progress", line)
    names = ("step_z_air", "step_z_low")
    asked = {
        "experiments": [root / f"experiments/{name}.toml" for name in names],
        "drives": ["velocity_servo"],
        "baselines": root / "tests/no_such_folder",
        "out": root / "results/check",
        "isolate": JobIsolation.NONE,
    }
    answer = ask.answer_of("twin.studies.check.study:check", asked)
    # there is no baseline
    assert answer.exit_code == 2
    # a bar is drawn a few times a second only
    assert "of 2 checks" in seen.getvalue()
    # written over, or erased
    assert seen.getvalue().endswith((" \r", "\x1b[2K"))
