"""Studies as commands: found by their files, with the options that their arguments say; errors of a command line.

Completion as a shell asks for it.
"""

import inspect
import json
import os
import subprocess
import sys
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from tests.cli.commands import COMMANDS
from tests.command_line import twin, twin_process
from twin import __version__
from twin import studies as package
from twin.cli import catalogue
from twin.cli.app import MAX_HELP_LENGTH, current_spelling, twin_command
from twin.cli.catalogue import COMMAND_GROUPS, HELP_SECTIONS, command_texts
from twin.kernel.cache_folder import CACHE_VARIABLE
from twin.kernel.errors import ComponentFailed

STUDY = '''
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated

from twin.kernel.errors import ComponentFailed, InputRefused
from twin.studies.command import Answer
from twin.studies.command import Argument, ArgumentValues, Option, study
from twin.studies.command import Say


def _look(asked: ArgumentValues) -> None:
    if asked["word"] == "early":
        raise InputRefused("looked at first")


@study(before=[_look], on_failure=lambda asked: "Kept until then: nothing.")
def echo(
    word: Annotated[str, Argument("What is said.", "WORD")],
    say: Say,
    more: Annotated[Sequence[str], Option("Said, too.", "WORD", "--and")] = (),
    loud: Annotated[bool, Option("In capitals.")] = False,
    count: Annotated[int, Option("How often.", "N", least=1, most=3)] = 1,
) -> Answer:
    """Say something again.

    Example: twin echo word

    Raises:
        ComponentFailed: the word is `fail`.
    """
    if word == "fail":
        raise ComponentFailed("it failed")
    text = " ".join([word, *more] * count)
    return Answer(text.upper() if loud else text, {"more": more})


@study("log twice")
def repeat(word: Annotated[str, Argument("What is said.", "WORD")], say: Say) -> Iterator[Answer]:
    """Say it as soon as it is known.

    Example: twin log twice word
    """
    yield Answer(word, {"word": word}, 1)
    if word == "fail":
        raise ComponentFailed("it failed")
    yield Answer("the end", {})


@study("log silent", json=False)
def silent() -> None:
    """Say nothing.

    Example: twin log silent
    """
'''

NAMES = tuple(command_texts())
USED = """
import sys
sys.argv = ["twin", *{words!r}]
from twin.cli import main
try:
    main()
except SystemExit:
    print(*sorted({modules!r} & {{*sys.modules}}), file=sys.stderr)
"""


@pytest.fixture
def echo(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Studies in a file of a folder of its own."""
    (tmp_path / "echo.py").write_text(STUDY)
    monkeypatch.setattr(catalogue, "COMMAND_FOLDERS", {"twin.studies": tmp_path})
    monkeypatch.setattr(package, "__path__", [*package.__path__, str(tmp_path)])


def asked(*words: str, code: int = 0) -> str:
    done = CliRunner().invoke(twin_command(), words, catch_exceptions=False)
    assert done.exit_code == code, done.output
    return done.stdout.rstrip("\n")


@pytest.mark.usefixtures("echo")
def test_a_file_that_is_there_is_a_command_after_those_of_twin():
    command = twin_command()
    assert list(command_texts()) == ["echo", "log twice", "log silent"]
    assert list(command.commands) == ["log", "echo"]
    group: Any = command.commands["log"]
    assert list(group.commands) == ["twice", "silent"]
    assert asked("--help").endswith("Others:\n  echo  Say something again.")


@pytest.mark.usefixtures("echo")
def test_its_arguments_are_the_options(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("COLUMNS", "80")
    assert asked("echo", "a", "--and", "b", "--and", "c", "--count", "2", "--loud") == "A B C A B C"
    # a flag has no other that says no, and what is left out is an empty sequence
    assert "--no-loud" not in asked("echo", "--help") and json.loads(asked("echo", "a", "--json")) == {"more": []}


@pytest.mark.usefixtures("echo")
def test_help_is_the_docstring_without_what_is_for_programs():
    assert "Example: twin echo word" in asked("echo", "--help") and "Raises" not in asked("echo", "--help")


@pytest.mark.usefixtures("echo")
@pytest.mark.parametrize("words", [["a", "--count", "0"], ["a", "--count", "4"], []])
def test_bounds_and_missing_arguments_are_refused(words: list[str]):
    assert CliRunner().invoke(twin_command(), ["echo", *words]).exit_code == 2


@pytest.mark.usefixtures("echo")
def test_what_is_asked_is_looked_at_before_the_study_begins():
    done = CliRunner().invoke(twin_command(), ["echo", "early"])
    assert str(done.exception) == "looked at first"


@pytest.mark.usefixtures("echo")
def test_a_component_that_fails_leaves_a_word_about_what_is_kept():
    with pytest.raises(ComponentFailed, match=r"^it failed\nKept until then: nothing\.$"):
        asked("echo", "fail")


@pytest.mark.usefixtures("echo")
def test_answers_are_printed_one_after_the_other_and_the_largest_exit_code_counts():
    assert asked("log", "twice", "word", code=1) == "word\nthe end"
    done = CliRunner().invoke(twin_command(), ["log", "twice", "fail", "--json"])
    assert json.loads(done.stdout) == {"word": "fail"} and str(done.exception) == "it failed"
    assert asked("log", "silent") == "" and "--json" not in asked("log", "silent", "--help")


@pytest.mark.parametrize("words", NAMES)
def test_the_help_read_from_the_file_is_the_docstring(words: str):
    one = command_texts()[words]
    function = getattr(import_module(one.module), one.function)
    own, _, _ = inspect.cleandoc(function.__doc__).partition("\n\nRaises:")
    assert one.help == own and COMMANDS[words].get_short_help_str(MAX_HELP_LENGTH)


def test_every_command_of_twin_stands_in_one_section_of_the_help():
    listed = [name for names in HELP_SECTIONS.values() for name in names]
    assert sorted(listed) == sorted({words.split()[0] for words in NAMES})
    assert {words.split()[0] for words in NAMES if " " in words} == set(COMMAND_GROUPS)
    assert list(twin_command().commands) == listed


@pytest.mark.parametrize(
    ("words", "imported"),
    [
        (["tune", "--help"], "twin.studies.tune.study"),
        (["--version"], ""),
        (["tnue"], ""),
        (["drive", "--help"], ""),
        (["drive", "list"], "twin.studies.qualify.study"),
    ],
)
def test_only_the_command_that_is_asked_for_is_imported(words: list[str], imported: str):
    program = USED.format(words=words, modules={one.module for one in command_texts().values()})
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.stderr.splitlines()[-1] == imported


@pytest.mark.parametrize("words", [["--help"], *([name, "--help"] for name in COMMAND_GROUPS)])
def test_commands_are_listed_with_their_whole_first_sentences(words: list[str]):
    _, commands = CliRunner().invoke(twin_command(), words).stdout.split("Show this message and exit.\n")
    for section in commands.split("\n\n"):
        listed = " ".join(section.split())
        assert "..." not in listed and listed.endswith((".", "now"))


def test_help_is_made_without_what_draws(tmp_path: Path):
    shown = (
        "import sys; sys.argv[1:] = ['--help']; from twin.cli import main\ntry: main()\nfinally: print([*sys.modules])"
    )
    nothing_kept = os.environ | {CACHE_VARIABLE: str(tmp_path)}
    done = subprocess.run([sys.executable, "-c", shown], capture_output=True, text=True, env=nothing_kept)
    assert "run        Run experiments and record them." in done.stdout
    assert "'rich'" not in done.stdout and "'pydantic'" not in done.stdout and "'fractions'" not in done.stdout


def test_the_names_of_drives_are_completed_without_the_tables_of_experiments(root: Path):
    code = (
        "import sys; from twin.cli.completions import drive_names; print(drive_names('vel'), 'pydantic' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=root, capture_output=True, text=True, check=True)
    assert done.stdout == "['velocity_servo'] False\n"


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
        (["run", "x.toml", "--jsno"], "twin run: no such option '--jsno'; did you mean '--json'?"),
        (["run", "x.toml", "--bodi"], "twin run: no such option '--bodi'; did you mean one of '--body', '--drive'?"),
        (["run", "x.toml", "--drive"], "twin run: option '--drive' requires an argument; see twin run --help"),
        (["run", "x.toml", "--port", "70000"], "twin run: invalid value for '--port': 70000 is not in the range"),
        (["run", "x.toml", "--limit-wall", "nan"], "twin run: invalid value for '--limit-wall': 'nan' is not a valid"),
        *(
            (["cosim", "x.fmu", option, text], f"twin cosim: invalid value for '{option}': '{text}' is not a valid")
            for option in ("--stop-s", "--limit-wall", "--tick-ms")
            for text in ("nan", "1_0", "\u0661")
        ),
        (
            ["compare", "a", "b", "--columns", "0_1"],
            "twin compare: invalid value for '--columns': '0_1' is not a valid",
        ),
        (["sweep", "show", "a", "b"], "twin sweep show: got unexpected extra argument (b); see twin sweep show --help"),
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
    shown = CliRunner(env=os.environ | {"COLUMNS": "80"}).invoke(twin_command(), [*words.split(), "--help"])
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
    assert current_spelling(words.split()) == now.split()


def offered(line: str, cwd: Path) -> list[str]:
    words = line.split(" ")
    asked = {"_TWIN_COMPLETE": "bash_complete", "COMP_WORDS": line, "COMP_CWORD": str(len(words) - 1)}
    return [
        line.partition(",")[2] for line in twin_process(cwd=cwd, env=os.environ | asked).stdout.splitlines() if line
    ]


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("twin sch", ["schema"]),
        ("twin drive l", ["list"]),
        ("twin run experiments/fig4_", [f"experiments/fig4_{name}.toml" for name in ("force_position", "imperfect")]),
        ("twin run experiments/pressing.toml --drive pm", ["pmsm_foc"]),
        ("twin drive check st", ["stepper"]),
        ("twin run experiments/pressing.toml --body b", ["back", "belly"]),
        ("twin run experiments/pressing.toml --set controller.force.k", ["controller.force.ki_mm_per_N_s="]),
        ("twin run experiments/nowhere.toml --set contr", []),
        ("twin init --from ta", ["tapping"]),
    ],
)
def test_the_shell_offers_what_there_is(root: Path, line: str, words: list[str]):
    found = offered(line, root)
    assert found[: len(words)] == words and bool(found) == bool(words)


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_the_script_for_each_shell_asks_twin(shell: str, tmp_path: Path):
    done = twin_process(cwd=tmp_path, env=os.environ | {"_TWIN_COMPLETE": f"{shell}_source"})
    assert done.returncode == 0 and f"_TWIN_COMPLETE={shell}_complete" in done.stdout


def test_completing_a_command_imports_no_study(tmp_path: Path):
    program = USED.format(words=[], modules={one.module for one in command_texts().values()})
    asked = {"_TWIN_COMPLETE": "bash_complete", "COMP_WORDS": "twin ", "COMP_CWORD": "1"}
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, env=os.environ | asked)
    assert "plain,run" in done.stdout.splitlines() and done.stderr == "\n"
