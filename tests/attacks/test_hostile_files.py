"""What strangers gave `twin` in place of its files: each is one sentence and exit code 2, at once."""

import os
import time
from pathlib import Path

import pytest

from tests.command_line import Done, twin

LONG = "n" * 300


@pytest.fixture
def base(root: Path) -> str:
    return f'extends = "{root}/experiments/pressing.toml"\n'


def refused(*arguments: object, cwd: Path) -> str:
    """The sentence with which `twin ARGUMENTS` refuses."""
    began = time.process_time()
    done: Done = twin(*arguments, cwd=cwd)
    # a hang takes all the time there is; these take tenths of a second
    assert time.process_time() - began < 10.0
    assert done.returncode == 2, done
    assert done.stdout == "" and "Traceback" not in done.stderr
    assert done.stderr.strip() and done.stderr.replace("\n", "").isprintable()
    assert max(map(len, done.stderr.splitlines())) < 2000
    return done.stderr


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"\xef\xbb\xbftitle = 'x'", "begins with a byte order mark"),
        ("title = 'x'".encode("utf-16"), "text in UTF-16"),
        (b"\x89PNG\r\n\x1a\n", "a PNG picture"),
        (b"\x89MCAP0\r\n", "an MCAP recording"),
        (b"x = " + b"[" * 900, "nested too deeply"),
        (b"x = " + b"[" * 100 + b"]" * 100, "nested too deeply"),
        (b"a." * 5000 + b"b = 1", "a key of more than 32 parts"),
        (b"[" + b"a." * 5000 + b"b]", "a key of more than 32 parts"),
        (b"seed = " + b"9" * 5000, "not valid TOML"),
        (b"seed = 0x" + b"f" * 5000, "more than 64 bits"),
        (b"x = 1\n" * 500_000, "more than 2 MB"),
    ],
)
def test_what_is_no_experiment_is_told_for_what_it_is(tmp_path: Path, content: bytes, said: str):
    (tmp_path / "x.toml").write_bytes(content)
    assert said in refused("run", "x.toml", "--isolate", "none", cwd=tmp_path)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('[drive]\nfmu = "a\\u0000b"', "no such drive"),
        (f'[drive]\nfmu = "{LONG}"', "no such drive"),
        ('[drive]\nfmu = "loop"', "no such drive"),
        ('[drive]\nfmu = "~nobody/x"', "no such drive"),
        ('[drive]\nfmu = "itself.toml"', "more than 8 mappings name one another"),
        ('[contact]\nbody = "a\\u0000b"', "no such body"),
        (f'[contact]\nbody = "{LONG}"', "no such body"),
        (f'[contact]\nbody = "{LONG}.toml"', "cannot be read"),
        ('[contact]\nbody = "~nobody/x.toml"', "no such experiment file"),
        ('[contact]\nbody = "pipe.toml"', "not a regular file"),
        ("[[task]]\nkind = { a = 1 }", "[task 1] kind"),
        ("[[task]]\nkind = [{ a = 1 }]", "[task 1] kind"),
        ("[[fault]]\nkind = { a = 1 }", "[[fault]] 1 kind"),
        ("[[fault]]\nkind = 'breathing'\nmagnitude_mm = 1.0\nonset_s = 1e308", "onset_s"),
        ("[[measure]]\nkind = [[{ a = 1 }]]", "[measure 1] kind"),
        ("plant = []", "[plant]"),
        ("contact = [[1]]", "[contact]"),
        ("duration_s = 1e308", "more than 1e+12 ticks"),
        ("[cosim]\ntick_ms = 1e-300", "more than 1e+12 ticks"),
        ("[approach]\nheight_mm = 1e15", "out of reach"),
        ("[task.1]\npoint_mm = [1e308, 0]", "[task 1]"),
    ],
)
def test_a_value_of_another_kind_is_one_sentence(tmp_path: Path, base: str, text: str, said: str):
    os.mkfifo(tmp_path / "pipe.toml")
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    (tmp_path / "itself.toml").write_text('fmu = "itself.toml"')
    top = text.startswith(("plant", "contact", "duration_s"))
    (tmp_path / "x.toml").write_text(f"{base}{text}" if top or "[" in text else text)
    assert said in refused("run", "x.toml", "--isolate", "none", cwd=tmp_path)


@pytest.mark.parametrize("name", ["pipe", "/dev/zero", "loop", "folder", LONG, "a/" * 3000])
def test_what_is_no_regular_file_is_never_waited_for(tmp_path: Path, name: str):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    (tmp_path / "folder").mkdir()
    (tmp_path / "log.csv").write_text("t_s,F_N\n0,1\n1,2\n")
    for arguments in (
        ("run", name, "--isolate", "none"),
        ("sweep", "run", name),
        ("compare", "log.csv", name),
        ("compare", "log.csv", "log.csv", "--map", name),
        ("replay", name),
        ("report", name),
        ("export", name, "--csv"),
        ("identify", name),
        ("drive", "info", name),
    ):
        refused(*arguments, cwd=tmp_path)
    checked = twin("check", name, cwd=tmp_path)
    assert checked.returncode == 2 and "Traceback" not in checked.stdout + checked.stderr and len(checked.stdout) < 2000
    (tmp_path / "x.toml").write_text(f'extends = "{name}"')
    refused("run", "x.toml", "--isolate", "none", cwd=tmp_path)


def test_a_chain_of_files_that_extend_each_other_is_short(tmp_path: Path, base: str):
    for number in range(40):
        (tmp_path / f"{number}.toml").write_text(f'extends = "{number + 1}.toml"')
    (tmp_path / "40.toml").write_text(base)
    assert "extends a chain of more than 32 files" in refused("run", "0.toml", "--isolate", "none", cwd=tmp_path)
    # 32 are read, and refused for what is wrong with the last
    assert "no such experiment file" not in twin("run", "9.toml", "--set", "duration_s=0.1", cwd=tmp_path).stderr


@pytest.mark.parametrize(
    "options",
    [
        ("--set", "a." * 5000 + "b=1"),
        ("--set", "robot.a_mm=" + "[" * 900),
        ("--set", "robot.a_mm=" + "9" * 5000),
        ("--set", "robot.a_mm=" + "x" * 100_000),
        ("--set", "robot.a_mm=\x1b[31m\x07"),
        ("--set", "\x1b[31m"),
        ("--drive", LONG),
        ("--drive", "~nobody/x"),
        ("--body", LONG),
        ("--body", "\x1b]0;owned\x07"),
    ],
)
def test_options_are_no_better_than_files(tmp_path: Path, root: Path, options: tuple[str, str]):
    refused("run", root / "experiments/pressing.toml", "--isolate", "none", *options, cwd=tmp_path)


def test_whoever_completes_a_line_sees_no_traceback(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    from twin.cli.completions import body_names, drive_names, setting_keys

    monkeypatch.chdir(tmp_path)
    os.mkfifo(tmp_path / "pipe.toml")
    (tmp_path / "loop.toml").symlink_to(tmp_path / "loop.toml")
    (tmp_path / "deep.toml").write_text("x = " + "[" * 900)
    monkeypatch.setenv("COMP_WORDS", f"twin run pipe.toml loop.toml deep.toml {LONG}.toml /dev/zero.toml --set")
    assert setting_keys("") == []
    assert "velocity_servo" in drive_names("") and "back" in body_names("")
