"""An FMU that changes the working directory takes no output along, whatever the command and whenever it does so."""

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


@pytest.fixture(scope="module", params=["when it is loaded", "in its first step"])
def moving(
    request: pytest.FixtureRequest, root: Path, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Path, Path, str]:
    """A drive that changes the working directory, the folder that it changes to, and --out of the command."""
    folder = tmp_path_factory.mktemp("moving")
    there = folder / "there"
    there.mkdir()
    moved = MOVED.replace("THERE", str(there))

    def edited(text: str) -> str:
        if request.param == "when it is loaded":
            return f"#include <unistd.h>\n__attribute__((constructor)) {moved}{text}"
        head, step, rest = text.partition("fmi2Status fmi2DoStep(")
        arguments, brace, body = rest.partition("{")
        assert body
        return f"#include <unistd.h>\n{moved}{head}{step}{arguments}{brace} moved(); {body}"

    return (
        compiled_drive(root, folder, "drive", {"lifecycle.c": edited}),
        there,
        "mine" if request.param == "when it is loaded" else "",
    )


@pytest.mark.slow
@pytest.mark.parametrize("words", COMMANDS.values(), ids=list(COMMANDS))
def test_outputs_are_where_the_command_was_called(
    words: list[str], moving: tuple[Path, Path, str], root: Path, tmp_path: Path
):
    drive, there, out = moving
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
