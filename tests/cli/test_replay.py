from pathlib import Path

import pytest

from tests.cli.test_run import twin
from tests.replay.logs import FIG4, ran, softened


@pytest.mark.parametrize(("settings", "code"), [((), 0), ((softened((1, 2, 3), 10.0),), 1)])
def test_the_exit_code_says_whether_robot_and_twin_match(tmp_path: Path, settings: tuple[str, ...], code: int):
    done = twin("replay", ran(FIG4, *settings).path, "--out", "x", cwd=tmp_path)
    assert done.returncode == code, done.stderr
    assert done.stdout.startswith(f"{FIG4}: robot and twin {'match' if code == 0 else 'part'}")


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["nowhere.csv"], "nowhere.csv"),
        (["."], "no recording"),
        (["here.csv"], "an empty file"),
    ],
)
def test_what_is_no_log_is_one_sentence_and_exit_code_2(tmp_path: Path, arguments: list[str], said: str):
    (tmp_path / "here.csv").write_text("")
    done = twin("replay", *arguments, cwd=tmp_path)
    assert done.returncode == 2
    assert said in done.stderr
    assert "Traceback" not in done.stderr
