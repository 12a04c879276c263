"""`twin sweep` as a user types it."""

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
import uuid
from pathlib import Path

import pytest

from tests.command_line import twin
from tests.studies.sweep.definitions import STIFFNESS, stiffness_text, written

COST = ("seconds", "stepping_s")


def rows(folder: Path) -> list[dict]:
    """Of a sweep's folder, by run, without their cost."""
    found = [json.loads(line) for line in (folder / "rows.jsonl").read_text().splitlines()]
    return sorted(({k: v for k, v in row.items() if k not in COST} for row in found), key=lambda row: row["run"])


def long_text(root: Path, runs: int) -> str:
    """A sweep file of runs of 20 s simulated."""
    values = str([500 + 100 * number for number in range(runs)])
    return stiffness_text(root, values).replace("0.02", "20.0")


@pytest.fixture(scope="module")
def long(root: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A sweep file of 24 runs of 20 s simulated, and beside it what they come to, in a folder "whole"."""
    folder = tmp_path_factory.mktemp("long")
    path = written(folder, long_text(root, 24), "long.toml")
    done = twin("sweep", path, "--out", "whole", "-j", 1, cwd=folder)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("long  24 runs: smallest hold_error_N ")
    return path


class Begun:
    """`twin sweep` in the background, in which some rows are there already."""

    def __init__(self, file: Path, cwd: Path, *options: str):
        self.token = uuid.uuid4().hex
        self.out = cwd / "results" / "sweeps" / file.stem
        self.process = subprocess.Popen(
            [sys.executable, "-m", "twin", "sweep", str(file), *options],
            cwd=cwd, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
            env={**os.environ, "TWIN_TEST_TOKEN": self.token},
        )  # fmt: skip
        deadline = time.monotonic() + 120
        while self.finished() < 2 and self.process.poll() is None and time.monotonic() < deadline:
            time.sleep(0.01)

    def finished(self) -> int:
        file = self.out / "rows.jsonl"
        return file.read_bytes().count(b"\n") if file.exists() else 0

    def survivors(self) -> int:
        """Processes that it left behind, after a moment to end."""
        deadline = time.monotonic() + 20
        while (left := self._alive()) and time.monotonic() < deadline:
            time.sleep(0.05)
        return left

    def _alive(self) -> int:
        count = 0
        for process in Path("/proc").glob("[0-9]*"):
            # it may end while we look
            with contextlib.suppress(OSError):
                count += self.token.encode() in (process / "environ").read_bytes()
        return count


@pytest.mark.slow
def test_a_sweep_that_is_killed_goes_on_where_it_was(long: Path, tmp_path: Path):
    begun = Begun(long, tmp_path)
    begun.process.kill()
    begun.process.communicate()
    before = begun.finished()
    assert 2 <= before < 24
    assert begun.survivors() == 0
    done = twin("sweep", long, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert rows(begun.out) == rows(long.parent / "whole")


@pytest.mark.slow
def test_ctrl_c_keeps_what_is_finished_and_says_how_to_go_on(root: Path, long: Path, tmp_path: Path):
    # begins as the long one does, and takes ten minutes: it cannot be over before the Ctrl-C, however late that comes
    endless = written(tmp_path, long_text(root, 2000), "endless.toml")
    begun = Begun(endless, tmp_path)
    begun.process.send_signal(signal.SIGINT)
    out, err = begun.process.communicate(timeout=60)
    finished = begun.finished()
    assert begun.process.returncode == 130 and out == ""
    assert err == (
        f"interrupted; {finished} of 2000 runs are kept in results/sweeps/endless; the same command runs the others\n"
    )
    assert begun.survivors() == 0
    whole = {row["run"]: row for row in rows(long.parent / "whole")}
    known = [row for row in rows(begun.out) if row["run"] in whole]
    assert known and known == [whole[row["run"]] for row in known]


def test_another_sweep_is_not_mixed_into_the_same_folder(root: Path, long: Path):
    before = rows(long.parent / "whole")
    other = written(long.parent, stiffness_text(root, "[500]"), "other.toml")
    done = twin("sweep", other, "--out", "whole", cwd=long.parent)
    assert done.returncode == 2
    assert "whole: holds rows of another configuration" in done.stderr and "choose another --out" in done.stderr
    assert rows(long.parent / "whole") == before


def test_a_hundred_thousand_runs_are_not_begun_unasked(root: Path, tmp_path: Path):
    table = f'[[vary]]\nkey = "{STIFFNESS}"\nfrom = 500\nto = 900\ncount = 100000\n'
    file = written(tmp_path, f'experiment = "{root}/experiments/fig4_force_position.toml"\n{table}')
    done = twin("sweep", file, cwd=tmp_path)
    assert done.returncode == 2
    assert done.stderr.startswith(f"{file}: makes up to 100,000 runs; add --yes if that is intended")
    assert not (tmp_path / "results").exists()


def test_a_dry_run_counts_and_estimates_and_leaves_nothing(root: Path, tmp_path: Path):
    file = written(tmp_path, stiffness_text(root, "[500, 600, 700]"))
    done = twin("sweep", file, "--dry-run", "--json", cwd=tmp_path)
    facts = json.loads(done.stdout)
    assert (facts["runs"], facts["first"]["status"]) == (3, "done")
    assert facts["seconds"] > 0.0 and facts["MB"] > 0.0
    assert not (tmp_path / "results").exists()


def test_a_sweep_of_which_every_run_fails_ends_with_exit_code_1(root: Path, tmp_path: Path):
    text = (
        stiffness_text(root, "[500]")
        .replace("fig4_force_position", "step_z_air")
        .replace(STIFFNESS, "measure.1.signal")
    )
    done = twin(
        "sweep", written(tmp_path, text.replace("[500]", '["plant.p_A[2]"]').replace("0.02", "2.0")), cwd=tmp_path
    )
    assert done.returncode == 1, done.stderr
    assert rows(tmp_path / "results/sweeps/s")[0]["status"] == "refused"


def test_twin_run_sweep_is_the_same_in_short(root: Path, long: Path, tmp_path: Path):
    experiment = root / "experiments/fig4_force_position.toml"
    done = twin("run", experiment, "--sweep", f"{STIFFNESS}=500:700:3", "--set", "duration_s=20.0", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("fig4_force_position  3 runs: smallest hold_error_N ")
    (folder,) = (tmp_path / "results" / "sweeps").iterdir()
    whole = rows(long.parent / "whole")[:3]
    assert [row["metrics"] for row in rows(folder)] == [row["metrics"] for row in whole]
    shown = twin("sweep", "show", folder, cwd=tmp_path)
    assert shown.returncode == 0 and "best runs by hold_error_N" in shown.stdout
    assert "margins of the force loop" in shown.stdout


@pytest.mark.parametrize("options", [["--sweep", "a=1:2"], ["--sweep", "a=1:2:2", "--live"]])
def test_a_range_that_cannot_be_is_refused(root: Path, tmp_path: Path, options: list[str]):
    done = twin("run", root / "experiments/fig4_force_position.toml", *options, cwd=tmp_path)
    assert done.returncode == 2 and done.stderr.startswith("--sweep")


@pytest.mark.parametrize("experiment", ["pressing", "experiments/pressing.toml"])
def test_an_experiment_in_place_of_a_sweep_file_is_refused_with_the_command_to_type(root: Path, experiment: str):
    done = twin("sweep", experiment, cwd=root)
    assert done.returncode == 2 and len(done.stderr.splitlines()) == 1
    assert f"type twin run {experiment} --sweep robot.k_s_Nm_per_rad=0.5:3:6" in done.stderr


def test_a_metric_that_is_not_there_is_refused_with_the_closest(long: Path):
    for command in (["run", long, "--out", "whole", "--by", "peak"], ["show", "whole", "--by", "peak"]):
        done = twin("sweep", *command, cwd=long.parent)
        assert done.returncode == 2
        assert "--by peak: no such metric; did you mean 'peak_N'?" in done.stderr


def test_rows_become_parquet_with_a_column_per_parameter_and_metric(long: Path):
    pq = pytest.importorskip("pyarrow.parquet")
    done = twin("sweep", "show", "whole", "--parquet", cwd=long.parent)
    assert done.returncode == 0, done.stderr
    table = pq.read_table(long.parent / "whole" / "rows.parquet").to_pydict()
    found = rows(long.parent / "whole")
    assert table["run"] == [row["run"] for row in found]
    assert table["force_error_N"] == [row["metrics"]["force_error_N"] for row in found]
    assert table[STIFFNESS] == [row["parameters"][STIFFNESS] for row in found]
