"""Standard streams that are closed, full, or read by nobody any more."""

import io
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from twin.cli import app, line
from twin.cli.streams import READER_GONE, BestEffortStderr, NoReader, Outlet, share_width, standard_streams
from twin.kernel.errors import NotWritten
from twin.kernel.process.black_box import BlackBox
from twin.studies.result import WIDTH_VARIABLE, text_width

FULL = pytest.mark.skipif(not os.path.exists("/dev/full"), reason="only Linux has a disk that is always full")


class Refusing(io.StringIO):
    """A stream that takes nothing."""

    def __init__(self, problem: OSError):
        super().__init__()
        self.problem = problem

    def write(self, text: str) -> int:
        raise self.problem

    def flush(self) -> None:
        raise self.problem


def shell(command: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    """`twin` as a shell runs it, with what it makes of the streams."""
    full = command.replace("twin", f"'{sys.executable}' -P -m twin", 1)
    # unbuffered, nothing would be left to be written at the end
    env = {name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"}
    return subprocess.run(["bash", "-c", full], cwd=cwd, env=env, capture_output=True, text=True, timeout=300)


def test_output_that_is_not_taken_is_one_sentence_and_a_reader_that_has_gone_is_none() -> None:
    full, gone = Outlet(Refusing(OSError(28, "No space left on device"))), Outlet(Refusing(BrokenPipeError(32, "gone")))
    acts: list[Callable[[], object]] = [lambda: full.write("x"), full.flush]
    for act in acts:
        with pytest.raises(NotWritten, match=r"^standard output: cannot be written: No space left on device$"):
            act()
    for act in (lambda: gone.write("x"), gone.flush):
        with pytest.raises(NoReader):
            act()


def test_what_standard_error_does_not_take_is_lost() -> None:
    aside = BestEffortStderr(Refusing(OSError(28, "No space left on device")))
    assert aside.write("four") == 4
    aside.flush()
    assert aside.encoding is None


@pytest.mark.parametrize("columns", [60, 100])
def test_text_is_as_wide_as_the_terminal_and_a_pipe_has_80_columns(monkeypatch: pytest.MonkeyPatch, columns: int):
    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    monkeypatch.setenv(WIDTH_VARIABLE, "7")
    monkeypatch.setattr("shutil.get_terminal_size", lambda: os.terminal_size((columns, 24)))
    for stream, width in ((Terminal(), columns), (io.StringIO(), 80)):
        monkeypatch.setattr(sys, "stdout", stream)
        share_width()
        assert text_width() == width


def test_streams_are_given_back() -> None:
    before = sys.stdin, sys.stdout, sys.stderr
    with standard_streams():
        assert isinstance(sys.stdout, Outlet)
        assert isinstance(sys.stderr, BestEffortStderr)
    assert (sys.stdin, sys.stdout, sys.stderr) == before


@pytest.mark.parametrize(
    ("problem", "code", "told"),
    [
        (NoReader(), READER_GONE, ""),
        (NotWritten("x: cannot be written: why"), 3, "x: cannot be written: why\n"),
        (
            OSError(28, "No space left on device", "results/x"),
            3,
            "results/x: refused by the operating system: No space left on device\n",
        ),
        (OSError(24, "Too many open files"), 3, "twin: refused by the operating system: Too many open files\n"),
        (SystemExit(4), 4, ""),
    ],
)
def test_every_end_has_its_code_and_no_traceback(
    problem: BaseException, code: int, told: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def failing(words: list[str]) -> None:
        raise problem

    monkeypatch.setattr(app, "run_command_line", failing)
    with pytest.raises(SystemExit) as end:
        line.main()
    assert end.value.code == code
    assert capsys.readouterr() == ("", told)


@FULL
@pytest.mark.parametrize(
    ("command", "code", "said"),
    [
        ("twin schema > /dev/full", 3, "standard output: cannot be written: No space left on device\n"),
        ("twin --version > /dev/full", 3, "standard output: cannot be written: No space left on device\n"),
        ("twin schema --out /dev/full", 2, "/dev/full: a pipe or device; expected the name of a file"),
        ("twin run nowhere.toml 2> /dev/full", 2, ""),
        ("twin schema >&- 2>&- <&-", 0, ""),
        ("twin schema | true; exit ${PIPESTATUS[0]}", READER_GONE, ""),
    ],
)
def test_a_shell_sees_no_traceback(command: str, code: int, said: str, tmp_path: Path) -> None:
    done = shell(command, tmp_path)
    assert (done.returncode, done.stdout) == (code, "")
    assert done.stderr.startswith(said)
    assert len(done.stderr.splitlines()) == bool(said)


def test_a_run_needs_no_stream_at_all(root: Path, tmp_path: Path) -> None:
    """The guard's shared memory would get the number of one that is closed, and be another file in the child."""
    experiment = root / "experiments/fig4_force_position.toml"
    done = shell(f"twin run '{experiment}' --set duration_s=0.1 --out x <&- >&- 2>&-", tmp_path)
    assert done.returncode == 0
    assert (tmp_path / "x" / "run.mcap").exists()


@pytest.mark.skipif(os.name != "posix", reason="processes are guarded on POSIX only")
def test_the_guards_memory_never_takes_the_number_of_a_standard_stream() -> None:
    kept = os.dup(0), os.dup(1)
    os.close(0)
    os.close(1)
    try:
        box = BlackBox()
        number = box.fd
        box.close()
    finally:
        for stream, copy in enumerate(kept):
            os.dup2(copy, stream)
            os.close(copy)
    assert number > 2
