"""What a terminal sees: `twin run` with a pseudo-terminal as standard output and error."""

import fcntl
import os
import re
import struct
import subprocess
import sys
import termios
from collections.abc import Sequence
from pathlib import Path

import pytest

from tests.cli.test_run import FIG4
from twin.cli.compiling import PIECES
from twin.cli.progress import Progress

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


def test_a_terminal_shows_how_far_the_run_is_and_then_only_the_summary(root: Path, tmp_path: Path):
    text = seen(root, tmp_path)
    assert "loading" in text and re.search(r"\d+\.\d / 60\.0 s", text)
    # the line is erased before the summary
    assert "\x1b[2K" in text.rpartition("fig4_force_position  60 s at ")[0]
    assert "\x1b" not in text.rpartition("fig4_force_position  60 s at ")[2].partition("next")[0]


@pytest.mark.endurance
def test_the_first_run_of_all_counts_what_it_compiles(root: Path, tmp_path: Path):
    text = seen(root, tmp_path, NUMBA_CACHE_DIR=str(tmp_path / "compiled"))
    counted = [int(count) for count in re.findall(rf"compiling, once: (\d+) of about {PIECES}", text)]
    assert counted == sorted(counted) and len(set(counted)) > 3
    # "about": within a fifth
    assert abs(len(list((tmp_path / "compiled").rglob("*.o"))) - PIECES) < 0.2 * PIECES


def test_without_colour_there_is_no_escape_code_and_no_line_is_too_long(root: Path, tmp_path: Path):
    columns = 40
    text = seen(root, tmp_path, columns, NO_COLOR="1")
    assert "\x1b" not in text
    progress = [part for part in re.split(r"[\r\n]+", text) if " / 60.0 s" in part]
    assert progress and max(map(len, progress)) < columns


def test_a_dumb_terminal_gets_what_a_pipe_gets(root: Path, tmp_path: Path):
    text = seen(root, tmp_path, TERM="dumb")
    assert text.startswith("fig4_force_position  60 s at ")
    assert "\x1b" not in text and "\r" not in text.replace("\r\n", "\n")


def test_a_study_shows_what_it_is_doing_how_much_is_over_and_leaves_only_its_answer(root: Path, tmp_path: Path):
    words = ("drive", "compare", "ideal_velocity", "velocity_servo", "--experiment", "step_z_air")
    text = seen(root, tmp_path, words=words)
    first, second = text.index("step_z_air with ideal_velocity, 1 of 2"), text.index("velocity_servo, 2 of 2")
    assert " 0%" in text[first:second] and " 50%" in text[second:]
    assert "\x1b[2K" in text[second:] and "\x1b" not in text.rpartition("velocity_servo beside")[2]
    plain = seen(root, tmp_path, words=words, NO_COLOR="1")
    assert "step_z_air with velocity_servo, 2 of 2  50%" in plain and "\x1b" not in plain


def test_what_is_left_is_told_once_it_can_be_known(monkeypatch: pytest.MonkeyPatch):
    now = [0.0]
    monkeypatch.setattr("twin.cli.progress.time.monotonic", lambda: now[0])
    line, said = Progress(), list[str]()
    monkeypatch.setattr(line, "say", said.append)
    for at, what, share in ((0.0, "a", 0.0), (200.0, "b", 0.25), (201.0, "c", None), (799.5, "d", 0.9995)):
        now[0] = at
        line.step(what, share)
    assert said == ["a  0%", "b  25%  about 10 minutes left", "c", "d  100%"]
