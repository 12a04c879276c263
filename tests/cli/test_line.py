"""Command lines from beginning to end; some are answered before Typer is imported."""

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.command_line import twin
from tests.installations import forget_installation
from twin.cli import app, starting
from twin.cli import line as whole
from twin.kernel import cache_folder as keeping
from twin.kernel.cache_folder import VARIABLE

NEEDED = ("typer", "pydantic", "numpy", "fmpy", "packaging")
"""What takes long to import."""
IMPORTED = f"""
import sys
from twin.cli import main
try:
    main()
except SystemExit as end:
    print(end.code, *sorted(set({NEEDED!r}) & set(sys.modules)), file=sys.stderr)
"""


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setenv(VARIABLE, str(tmp_path / "cache"))
    monkeypatch.delenv("COLUMNS", raising=False)
    yield
    forget_installation()


def as_typer_has_it(words: list[str], capsys: pytest.CaptureFixture[str]) -> tuple[str, object]:
    try:
        code = app.carried_out(words)
    except SystemExit as end:
        code = end.code
    return capsys.readouterr().out, code or 0


@pytest.mark.parametrize("line", [line for line in whole.ANSWERS if not line.startswith("doctor")])
def test_the_answer_is_that_of_the_command(
    line: str, root: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.chdir(root)
    said, code = as_typer_has_it(line.split(), capsys)
    for _ in range(2):
        assert (whole.answered(line.split()) or 0) == code
        assert capsys.readouterr().out == said


def test_the_doctor_says_the_same_to_everybody(
    root: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.chdir(root)
    found = []
    for ask in (app.carried_out, whole.answered, whole.answered):
        ask(["doctor", "--json"])
        # the room on the disk is another from one moment to the next
        found.append([f for f in json.loads(capsys.readouterr().out)["findings"] if f["topic"] != "disk"])
    assert found[0] == found[1] == found[2] and len(found[0]) > 5


@pytest.mark.slow
@pytest.mark.parametrize("line", whole.ANSWERS)
def test_an_answer_that_is_kept_needs_hardly_anything(line: str, root: Path):
    command = [sys.executable, "-c", IMPORTED, *line.split()]
    first, second = (subprocess.run(command, cwd=root, capture_output=True, text=True) for _ in range(2))
    # the room on the disk is another from one moment to the next
    assert first.stdout.split("disk")[0] == second.stdout.split("disk")[0] != ""
    assert len(first.stderr.split()) > 1 and second.stderr.split() == [str(first.stderr.split()[0])]


MADE = {
    "line": ("line._help()", set(whole.ROOMS)),
    "starting": ("starting.schema()", set(starting.ROOMS)),
}


@pytest.mark.parametrize("module", MADE)
def test_an_answer_is_made_with_the_source_that_counts_for_it(module: str):
    makes, rooms = MADE[module]
    # what every command imports before says nothing that is printed
    program = f"""
import sys
from twin.cli import ahead, {module}
from twin.studies.qualify import shelf
before = {{*sys.modules}}
{makes}
for name in {{*sys.modules}} - before:
    if name.startswith("twin.") and not hasattr(sys.modules[name], "__path__"):
        print("/".join(name.split(".")[1:-1]))
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    folders = set(done.stdout.splitlines())
    inside = {(room, folder) for room in rooms for folder in folders if f"{folder}/".startswith(f"{room}/")}
    assert {room for room, _ in inside} == rooms
    # files above a room count, too
    assert folders - {folder for _, folder in inside} <= {"", "kernel"}


@pytest.mark.parametrize(
    "words",
    [
        ["schema", "--out", "x"],
        ["drive"],
        ["drive", "list", "x"],
        ["doctor", "--run"],
        ["--version"],
        [""],
        ["drive list"],
    ],
)
def test_every_other_command_line_is_left_to_typer(words: list[str]):
    assert whole.answered(words) is None


def test_the_shell_that_asks_what_may_follow_gets_no_help(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("_TWIN_COMPLETE", "complete_bash")
    assert whole.answered([]) is None


def test_the_help_fits_the_terminal(tmp_path: Path):
    wide = twin("--help", cwd=tmp_path).stdout
    narrow = twin("--help", cwd=tmp_path, env=os.environ | {"COLUMNS": "60"}).stdout
    assert max(map(len, narrow.splitlines())) <= 60 < max(map(len, wide.splitlines())) <= 80
    assert wide.split() == narrow.split()


def test_the_first_sentence_of_a_command_that_was_changed_is_told(
    tmp_path: Path, root: Path, monkeypatch: pytest.MonkeyPatch
):
    # the source of a package that is changed under a running process is that of the next one
    package = tmp_path / "twin"
    (package / "cli").mkdir(parents=True)
    (package / "cli" / "run.py").write_text("before")
    monkeypatch.setattr(keeping, "PACKAGE", package)
    said = iter(["before", "after"])
    monkeypatch.setattr(whole, "_help", lambda: next(said))
    told = []
    for text in ("before", "before", "after"):
        (package / "cli" / "run.py").write_text(text)
        forget_installation()
        told.append(twin("--help", cwd=tmp_path).stdout)
    assert told == ["before\n", "before\n", "after\n"]
