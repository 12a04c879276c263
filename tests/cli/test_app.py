import os
from pathlib import Path

import pytest
from typer.testing import CliRunner

from tests.cli.commands import COMMANDS
from tests.command_line import twin, twin_process
from twin import __version__
from twin.cli.app import app, as_spelt_now


def test_the_version_is_that_of_the_package(tmp_path: Path):
    done = twin_process("--version", cwd=tmp_path)
    assert (done.returncode, done.stdout) == (0, f"twin {__version__}\n")


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["rnu"], "twin: no such command 'rnu'; did you mean 'run'?"),
        (["drive", "chekc"], "twin drive: no such command 'chekc'; did you mean 'check'?"),
        (["nonsense"], "twin: no such command 'nonsense'; see twin --help"),
        (["run"], "twin run: missing argument 'EXPERIMENT'; see twin run --help"),
        (["run", "x.toml", "--bodi", "back"], "twin run: no such option: --bodi "),
    ],
)
def test_a_mistake_in_the_command_line_is_one_sentence_and_exit_code_2(arguments: list[str], said: str, tmp_path: Path):
    done = twin(*arguments, cwd=tmp_path)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith(said) and len(done.stderr.splitlines()) == 1


def test_a_group_without_a_command_shows_its_help(tmp_path: Path):
    done = twin("drive", cwd=tmp_path)
    assert done.returncode == 2
    assert "qualify" in done.stdout and done.stderr == ""


@pytest.mark.parametrize("words", ["", "drive", *COMMANDS])
def test_help_fits_80_columns(words: str, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("COLUMNS", "80")
    shown = CliRunner(env=os.environ | {"COLUMNS": "80"}).invoke(app, [*words.split(), "--help"])
    assert shown.exit_code == 0
    assert max(len(line) for line in shown.stdout.splitlines()) <= 80


@pytest.mark.parametrize(
    ("words", "now"),
    [
        ("", ""),
        ("tune x.toml --no-isolate", "tune x.toml --isolate=none"),
        ("tune --isolate x.toml", "tune --isolate=run x.toml"),
        ("tune x.toml --isolate", "tune x.toml --isolate=run"),
        ("tune x.toml --isolate none", "tune x.toml --isolate none"),
        ("run x.toml --isolate drive", "run x.toml --isolate drive"),
        ("run x.toml --isolate=drive", "run x.toml --isolate=drive"),
        ("run --realtime x.toml", "run --realtime=1 x.toml"),
        ("run x.toml --realtime=2", "run x.toml --realtime=2"),
    ],
)
def test_isolation_as_it_was_once_asked_for_and_real_time_without_a_factor_work(words: str, now: str):
    assert as_spelt_now(words.split()) == now.split()
