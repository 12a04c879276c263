"""An FMU that changes the working directory takes no output along, whatever the command and whenever it does so."""

from collections.abc import Callable
from functools import cache
from pathlib import Path

import pytest

from tests.command_line import twin_process
from tests.kernel.fmi.compiled import compiled_drive
from tests.studies.sweep.definitions import stiffness_text

FIG4 = "fig4_force_position"
MOVED = 'static void moved(void) { if (chdir("THERE") != 0) { } }\n'
COMMANDS = {
    "cosim": ["cosim", "DRIVE", "--tick-ms", "1", "--stop-s", "0.01"],
    "run": ["run", FIG4, "--drive", "DRIVE", "--set", "duration_s=0.05"],
    "drive check": ["drive", "check", "DRIVE"],
    "build": ["build", FIG4, "--ssp", "--drive", "DRIVE"],
    "sweep": ["sweep", "sweep.toml", "-j", "1"],
}


MOMENTS = ("when it is loaded", "in its first step")


@pytest.fixture(scope="module")
def moving(root: Path, tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], tuple[Path, Path, str]]:
    """What makes a drive that changes the working directory: the drive, the folder, and --out of the command."""
    return cache(lambda when: moving_drive(root, tmp_path_factory.mktemp("moving"), when))


def moving_drive(root: Path, folder: Path, when: str) -> tuple[Path, Path, str]:
    there = folder / "there"
    there.mkdir()
    moved = MOVED.replace("THERE", str(there))

    def edited(text: str) -> str:
        if when == "when it is loaded":
            return f"#include <unistd.h>\n__attribute__((constructor)) {moved}{text}"
        head, step, rest = text.partition("fmi2Status fmi2DoStep(")
        arguments, brace, body = rest.partition("{")
        assert body
        return f"#include <unistd.h>\n{moved}{head}{step}{arguments}{brace} moved(); {body}"

    out = "mine" if when == "when it is loaded" else ""
    return compiled_drive(root, folder, "drive", {"lifecycle.c": edited}), there, out


ONCE = {"drive check": "when it is loaded", "build": "in its first step", "sweep": "when it is loaded"}
"""When a drive moves that a long command is given in the tiers; the other time is left to endurance."""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("when", "words"),
    [
        pytest.param(when, words, id=f"{name} {when}", marks=[pytest.mark.endurance] * (ONCE.get(name, when) != when))
        for when in MOMENTS
        for name, words in COMMANDS.items()
    ],
)
def test_outputs_are_where_the_command_was_called(
    when: str, words: list[str], moving: Callable[[str], tuple[Path, Path, str]], root: Path, tmp_path: Path
):
    drive, there, out = moving(when)
    (tmp_path / "sweep.toml").write_text(f"drives = ['{drive}']\n" + stiffness_text(root, "[500, 600]"))
    done = twin_process(
        *(word.replace("DRIVE", str(drive)) for word in words), *(["--out", out] if out else []), cwd=tmp_path
    )
    assert done.returncode in ((0, 1) if "check" in words else (0,)), done.stderr
    assert [str(path) for path in there.rglob("*")] == []
    assert (tmp_path / (out or "results")).exists()
    # every path that is printed is there
    for word in done.stdout.split():
        if word.startswith((f"{out or 'results'}/",)):
            assert (tmp_path / word.rstrip(",.;:")).exists(), word
