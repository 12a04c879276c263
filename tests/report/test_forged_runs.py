"""Every command that reads a run, given forged ones: it does its work, or refuses in a sentence."""

import time
from collections.abc import Callable
from pathlib import Path
from random import Random

import pytest

from tests.kernel.recording.forgery import data_records, sealed, with_metadata
from tests.memory import growth
from tests.report.attacks import Attack
from twin.kernel.atomic_write import json_text
from twin.kernel.errors import InputRefused, TwinError
from twin.kernel.recording.export.export import export_recording
from twin.kernel.serialise import to_dict
from twin.report.page.page import write_report
from twin.robot.assembly.load import load_experiment
from twin.robot.run.run import SUMMARY_FILE, execute
from twin.studies.compare.comparison import compare_logs, read_logs
from twin.studies.identify import study as identification
from twin.studies.replay import study as replaying

SEED = 12
FEW, MANY = 8, 1500
LONGEST = 60.0
"""s of one command on one run, on a busy machine; whatever hangs takes longer."""
MEMORY = 1e9
"""Bytes that the commands together may take at most: numba and matplotlib are half of them."""
Command = Callable[[Path, Path, Random], object]


def compare(good: Path, forged: Path, draw: Random) -> object:
    return json_text(to_dict(compare_logs(*read_logs(good, forged))))


def export(good: Path, forged: Path, draw: Random) -> object:
    return export_recording(forged, draw.choice(["csv", "mat"]), rate=draw.choice([None, 10.0]), out=forged / "out")


def identify(good: Path, forged: Path, draw: Random) -> object:
    return identification.identify(forged, out=forged / "identify")


def replay(good: Path, forged: Path, draw: Random) -> object:
    return replaying.replay(forged, plant=draw.random() < 0.3, baseline="0.05", out=forged / "replay")


def report(good: Path, forged: Path, draw: Random) -> object:
    return write_report([forged])


COMMANDS: dict[str, Command] = {each.__name__: each for each in (compare, export, identify, replay, report)}


@pytest.fixture(scope="module")
def good(root: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a short run that touches."""
    folder = tmp_path_factory.mktemp("good")
    settings = ["duration_s=0.2", "reference.t_s=[0, 0.1, 0.2]", "reference.p_mm=[[0,0,-101],[0,0,-101.5],[0,0,-101]]"]
    execute(load_experiment(root / "experiments/fig4_force_position.toml", settings), folder)
    return folder


def attacked(good: Path, folder: Path, count: int, commands: dict[str, Command]) -> tuple[int, int]:
    """How often commands on `count` forged runs went through, and how often they refused."""
    attack = Attack(data_records(good / "run.mcap"), (good / SUMMARY_FILE).read_text(), Random(SEED))
    through = refused = 0
    with growth() as grown:
        for number in range(count):
            forged = folder / str(number)
            attack.write(forged)
            went, said = _each(good, forged, number, attack.draw, commands)
            through, refused = through + went, refused + said
        assert grown() < MEMORY
    return through, refused


def _each(good: Path, forged: Path, number: int, draw: Random, commands: dict[str, Command]) -> tuple[int, int]:
    """How many of `commands` went through on the forged run `number`, and how many refused."""
    refused = 0
    for name, command in commands.items():
        began = time.monotonic()
        try:
            command(good, forged, draw)
        except TwinError as problem:
            # 1: nothing can be identified; 3: the plant model left the workspace
            assert problem.exit_code in (1, 2, 3)
            assert str(problem)
            refused += 1
        # anything else goes on from here: with its number it can be made again
        except BaseException as problem:
            problem.add_note(f"twin {name} on forged run {number} of seed {SEED}")
            raise
        assert time.monotonic() - began < LONGEST, f"{name} on forged run {number} of seed {SEED}"
    return len(commands) - refused, refused


@pytest.mark.slow
def test_forged_runs_are_read_or_refused_in_a_sentence(good: Path, tmp_path: Path) -> None:
    through, refused = attacked(good, tmp_path, FEW, COMMANDS)
    # an attack that everything refuses, or nothing, would show nothing
    assert through > FEW
    assert refused > FEW


@pytest.mark.endurance
def test_thousands_of_forged_runs_are_read_or_refused_in_a_sentence(good: Path, tmp_path: Path) -> None:
    attacked(good, tmp_path, MANY, COMMANDS)


@pytest.mark.parametrize("name", ["../../escaped", "a/b", "..", "", "a\0b", "x" * 300])
def test_a_run_cannot_choose_where_its_reports_go(
    good: Path, tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "forged").mkdir()
    data = data_records(good / "run.mcap")
    data = with_metadata(data, lambda which, entries: entries | {"name": name} if which == "experiment" else entries)
    sealed(data, tmp_path / "forged" / "run.mcap")
    for command in (
        lambda: replaying.replay(Path("forged"), baseline="0.05"),
        lambda: identification.identify(Path("forged")),
        lambda: write_report([Path("forged")]),
    ):
        with pytest.raises(InputRefused, match="is not a valid name"):
            command()
    assert [path.name for path in tmp_path.iterdir()] == ["forged"]
