"""`--realtime` and `--live` as a user types them."""

import json
from pathlib import Path

import pytest

from tests.cli.test_run import FIG4
from tests.command_line import twin


@pytest.mark.parametrize(("option", "factor"), [("--realtime", 1.0), ("--realtime=4", 4.0)])
def test_realtime_needs_no_factor(root: Path, tmp_path: Path, option: str, factor: float):
    done = twin("run", option, root / FIG4, "--set", "duration_s=0.2", "--json", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["punctuality"]["factor"] == factor


def test_a_paced_run_says_how_it_went_and_an_unpaced_one_does_not(root: Path, tmp_path: Path):
    arguments = ("run", root / FIG4, "--set", "duration_s=0.1")
    paced, free = (twin(*arguments, *more, cwd=tmp_path) for more in (["--realtime"], ["--realtime=0"]))
    assert "deadlines missed" in paced.stdout.splitlines()[1]
    assert "deadlines" not in free.stdout


@pytest.mark.parametrize("option", ["--realtime=inf", "--realtime=-1", "--realtime=fast"])
def test_what_is_no_factor_is_refused(root: Path, tmp_path: Path, option: str):
    done = twin("run", option, root / FIG4, cwd=tmp_path)
    assert done.returncode == 2
    assert "--realtime" in done.stderr
    assert not (tmp_path / "results").exists()
