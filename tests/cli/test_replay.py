from pathlib import Path

import pytest

from tests.command_line import twin
from tests.studies.replay.logs import FIG4, ran, softened


def test_a_robot_that_drifts_ends_with_exit_code_1(tmp_path: Path):
    done = twin("replay", ran(FIG4, softened((1, 2, 3), 10.0)).path, "--out", "x", cwd=tmp_path)
    assert done.returncode == 1, done.stderr
    assert done.stdout.startswith(f"{FIG4}: robot and twin diverge since ")


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["nowhere.csv"], "nowhere.csv: no such file"),
        (["here.csv"], "here.csv: an empty file"),
    ],
)
def test_what_is_no_log_is_one_sentence_and_exit_code_2(tmp_path: Path, arguments: list[str], said: str):
    (tmp_path / "here.csv").write_text("")
    done = twin("replay", *arguments, cwd=tmp_path)
    assert done.returncode == 2
    assert said in done.stderr
    assert "Traceback" not in done.stderr
