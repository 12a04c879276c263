"""The example at the end of every command's help, run as a user would after the two runs of Fig. 4."""

import shlex
import shutil
from pathlib import Path

import pytest

from tests.cli.commands import COMMANDS, EXAMPLE, EXAMPLES, paragraphs
from tests.command_line import twin
from tests.kernel.systems.archives import archive, component, structure, system
from twin.kernel.recording.reader import Recording

ENDS = {"falsify": 1}
"""Exit codes: what is shown is a requirement that does not hold."""
SERVES = ("explore", "serve")
"""Last until they are ended, or wait for a controller: tests/browser/explore and tests/studies/serve run them."""
LONG = ("converge", "faults", "safety", "tune")
"""Ten seconds each: `make endurance` tries them, and `make test` what they run by shorter ones of its own."""


@pytest.fixture(scope="module")
def repository(
    root: Path, tmp_path_factory: pytest.TempPathFactory, force_position: Recording, position: Recording
) -> Path:
    """The repository as far as users see it, with the two runs of Fig. 4."""
    folder = tmp_path_factory.mktemp("repository")
    for name in ("experiments", "fmus", "tests/baselines"):
        shutil.copytree(root / name, folder / name)
    for run in (force_position, position):
        name = run.metadata["experiment"]["name"]
        shutil.copytree(run.path.parent, folder / "results" / name / "2026-01-01_120000")
    head = [f"{side}{joint}_deg" for side in ("motor", "link") for joint in (1, 2, 3)]
    (folder / "robot.csv").write_text(f"t_s,{','.join(head)},Fz_N\n0,1,2,3,4,5,6,0\n0.01,1,2,3,4,5,6,5\n")
    shaft = structure(system([component("shaft", "shaft.fmu")]), 0.1)
    archive(folder / "system.ssp", shaft, {"shaft.fmu": root / "fmus/ideal_velocity/ideal_velocity.fmu"})
    return folder


@pytest.mark.parametrize("words", COMMANDS)
def test_every_command_says_its_exit_codes_and_ends_with_an_example_of_its_own(words: str):
    assert EXAMPLES[words].startswith(f"{EXAMPLE}twin {words}") and "\n" not in EXAMPLES[words]
    assert "Exit code: 0 " in (COMMANDS[words].help or "")


@pytest.mark.parametrize("words", COMMANDS)
def test_help_is_written_for_80_columns(words: str):
    lines = [line for paragraph in paragraphs(COMMANDS[words])[:-1] for line in paragraph.splitlines()]
    # help is indented by a column on either side
    assert [line for line in lines[1:] if len(line) > 78] == []


@pytest.mark.slow
@pytest.mark.parametrize(
    "words",
    [
        pytest.param(words, marks=[pytest.mark.endurance] if words in LONG else [])
        for words in COMMANDS
        if words not in SERVES
    ],
)
def test_every_example_works(repository: Path, words: str):
    done = twin(*shlex.split(EXAMPLES[words].removeprefix(f"{EXAMPLE}twin ")), cwd=repository)
    assert done.returncode == ENDS.get(words, 0), done.stderr
    assert done.stdout and "\x1b" not in done.stdout + done.stderr
