"""What is kept, what it was made with, and what goes."""

import html
import json
import re
import shlex
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from tests.command_line import Done, twin
from twin.kernel.errors import InputRefused
from twin.kernel.recording.folder import recording_in
from twin.kernel.recording.reader import last_time, read, read_metadata
from twin.robot.experiment.source import COMMAND_LINE
from twin.studies.results.stored import CurrentExperiments, StoredRun, describe_differences, removable_runs, stored_runs

SHORT = ("--set", "duration_s=0.01")


@pytest.fixture(scope="module")
def home(root: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with an experiment of its own and three runs of it."""
    folder = tmp_path_factory.mktemp("home")
    file = folder / "mine.toml"
    file.write_text('extends = "fig4_force_position.toml"\nduration_s = 0.01\n')
    for words in ((), ("--drive", "pmsm_foc", "--set", "seed=3"), ()):
        done = twin("run", "mine", *words, cwd=folder)
        assert done.returncode == 0, done.stderr
    file.write_text('extends = "fig4_force_position.toml"\nduration_s = 0.02\n')
    (folder / "results/pictures").mkdir()
    (folder / "results/pictures/a.png").write_bytes(bytes(1000))
    return folder


@pytest.fixture
def copied(home: Path, tmp_path: Path) -> Path:
    shutil.copytree(home, tmp_path / "copied", symlinks=True)
    return tmp_path / "copied"


def told(*words: str, cwd: Path) -> Done:
    done = twin("runs", *words, cwd=cwd)
    assert done.returncode == 0, done.stderr
    return done


def test_the_list_says_when_how_large_made_with_what_and_what_has_changed_since(home: Path):
    lines = told(cwd=home).stdout.splitlines()
    assert lines[0].startswith("results: 3 runs of 1 experiment, ")
    assert [line.endswith("never touched  latest") for line in lines if "never touched" in line] == [True, False, False]
    assert lines.count("      twin run mine --drive pmsm_foc --set seed=3") == 1
    assert lines.count("      duration_s was 0.01, is 0.02 now") == 3
    # its drive and seed are what was asked for, and so they would be now
    assert not [line for line in lines if "drive.fmu" in line]
    assert lines[-1] == "also there: pictures 1.0 kB"
    assert max(map(len, lines)) <= 80


@pytest.fixture(scope="module")
def own(root: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[str]]:
    """A folder with a run of files of its user's own, in a folder with blanks and a quote, and what was typed."""
    home = tmp_path_factory.mktemp("own")
    lab = home / "my lab's"
    lab.mkdir()
    shutil.copyfile(root / "fmus/brushed_dc/brushed_dc.fmu", lab / "dc motor.fmu")
    mapping = (root / "fmus/brushed_dc/mapping.toml").read_text()
    (lab / "units.toml").write_text(mapping.replace("brushed_dc.fmu", "dc motor.fmu"))
    shutil.copyfile(root / "experiments/bodies/back.toml", lab / "soft.toml")
    (lab / "press here.toml").write_text(f'extends = "{root}/experiments/fig4_force_position.toml"\nduration_s = 0.2\n')
    typed = ["my lab's/press here.toml", "--drive", "my lab's/units.toml", "--body", "my lab's/soft.toml",
             "--set", 'title="it\'s mine"', "--set", "controller.force.reference_N=4"]  # fmt: skip
    done = twin("run", *typed, cwd=home)
    assert done.returncode == 0, done.stderr
    return home, typed


def in_shell(command: str, cwd: Path) -> None:
    """Run `command` as a shell reads it when it is pasted."""
    words = subprocess.run(["sh", "-c", f'for word in {command}; do printf "%s\\0" "$word"; done'], check=True,
                           capture_output=True, text=True).stdout.split("\0")[:-1]  # fmt: skip
    assert words[:2] == ["twin", "run"]
    done = twin(*words[1:], cwd=cwd)
    assert done.returncode == 0, done.stderr


def test_the_printed_commands_repeat_a_run_of_ones_own_files_byte_for_byte(own: tuple[Path, list[str]]):
    home, typed = own
    recording = recording_in(home / "results/press here").resolve()
    (line,) = [line.strip() for line in told(cwd=home).stdout.splitlines() if line.strip().startswith("twin run ")]
    listed = json.loads(told("--json", cwd=home).stdout)["runs"][0]["command"]
    assert twin("report", str(recording), cwd=home).returncode == 0
    page = recording.with_name("report.html").read_text("utf-8")
    shown = html.unescape(re.findall("<code>(twin run .*?)</code>", page)[0])
    assert line == listed == shown == shlex.join(["twin", "run", *typed])
    in_shell(line, home)
    again = recording_in(home / "results/press here").resolve()
    assert again != recording and again.read_bytes() == recording.read_bytes()


def test_a_recording_has_no_path_of_the_drive_that_was_typed(own: tuple[Path, list[str]]):
    recording = recording_in(own[0] / "results/press here")
    metadata = read_metadata(recording)
    drive = json.loads(metadata.pop("experiment")["values"])["drive"]
    told_of = json.dumps([drive, metadata])
    assert "dc motor.fmu" in told_of and "my lab's" not in told_of


def test_a_run_is_compared_with_the_files_that_were_typed(own: tuple[Path, list[str]], tmp_path: Path):
    home = tmp_path / "home"
    shutil.copytree(own[0], home, symlinks=True)
    told_of = told(cwd=home).stdout
    assert "not compared" not in told_of and " was " not in told_of
    # another file of that name in the current folder is not meant
    (home / "press here.toml").write_text("a secret")
    file = home / "my lab's/press here.toml"
    file.write_text(file.read_text().replace("0.2", "0.3"))
    assert "      duration_s was 0.2, is 0.3 now" in told(cwd=home).stdout.splitlines()


def test_a_run_of_ones_own_controller_is_compared_from_the_folder_where_it_was_typed(tmp_path: Path, root: Path):
    (tmp_path / "laws").mkdir()
    shutil.copyfile(root / "examples/my_controller.py", tmp_path / "laws/mine.py")
    words = ("fig4_force_position", "--set", "controller.python=laws/mine.py:Controller", *SHORT)
    assert twin("run", *words, cwd=tmp_path).returncode == 0
    assert "not compared" not in told(cwd=tmp_path).stdout


@pytest.mark.parametrize("typed", [["mine", "--out", "/elsewhere"], ["--help"], ["mine", "--set"], [3], "mine", []])
def test_a_forged_summary_adds_no_other_option_to_the_command(home: Path, typed: Any):
    (run,) = [run for run in stored_runs(home / "results") if run.start_options]
    told_of = StoredRun(run.folder, run.recording, True)
    told_of.__dict__["summary"] = {"typed": typed}
    assert told_of.words == ["mine", "--drive", "pmsm_foc", "--set", "seed=3"]


def test_a_run_with_a_name_of_its_own_is_listed_with_its_experiment_and_never_goes(copied: Path):
    twin("run", "mine", "--set", "seed=7", "--out", "results/a_name", cwd=copied)
    lines = told(cwd=copied).stdout.splitlines()
    assert lines[0].startswith("results: 4 runs of 1 experiment, ")
    assert [line.split()[0] for line in lines if "never touched" in line][-1] == "a_name"
    assert lines.index("      twin run mine --set seed=7") > lines.index("mine")
    assert lines[-1] == "also there: pictures 1.0 kB"
    assert [run.has_user_name for run in removable_runs(copied / "results", [], 0)] == [False] * 3


def test_a_run_whose_experiment_is_gone_is_listed_and_says_so(copied: Path):
    (copied / "mine.toml").unlink()
    assert "not compared with its file: mine: no such experiment" in told(cwd=copied).stdout


def test_an_unfinished_run_says_how_far_it_got(copied: Path):
    recording = recording_in(copied / "results/mine")
    recording.rename(recording.with_name("run.mcap.partial"))
    assert f"not finished: ends at {last_time(recording_in(copied / 'results/mine')):.3g} s" in told(cwd=copied).stdout


def test_the_newest_of_two_runs_in_a_second_stands_first(tmp_path: Path):
    stamps = ["2026-01-01_120000", "2026-01-01_120000_2", "2026-01-01_120000_10", "2025-12-31_235959"]
    for stamp in stamps:
        (tmp_path / "a" / stamp).mkdir(parents=True)
        (tmp_path / "a" / stamp / "run.mcap").write_bytes(b"")
    assert [run.folder.name for run in stored_runs(tmp_path)] == [stamps[i] for i in (2, 1, 0, 3)]


def test_pruning_lists_first_and_removes_nothing_until_one_says_yes(copied: Path):
    before = sorted(copied.rglob("*"))
    done = told("--prune", cwd=copied)
    assert "      twin run mine --drive pmsm_foc --set seed=3" in done.stdout.splitlines()
    assert done.stdout.startswith("2 runs, ") and done.stdout.endswith("nothing removed; --yes removes them\n")
    assert sorted(copied.rglob("*")) == before
    assert told("--prune", "--yes", cwd=copied).stdout.splitlines()[-1].startswith("removed 2 runs, ")
    assert len(stored_runs(copied / "results")) == 1 and recording_in(copied / "results/mine/latest").is_file()
    assert (copied / "results/pictures/a.png").is_file()
    assert told("--prune", cwd=copied).stdout == "results: nothing to remove; each experiment has 1 at most\n"


def test_pruning_keeps_the_run_that_latest_means_even_if_a_newer_one_is_there(copied: Path):
    latest = copied / "results/mine/latest"
    oldest = stored_runs(copied / "results")[-1].folder.name
    latest.unlink()
    latest.symlink_to(oldest)
    assert oldest not in [run.folder.name for run in removable_runs(copied / "results", (), 1)]
    assert told("--prune", "--yes", "--keep", "0", cwd=copied).returncode == 0
    assert not (copied / "results/mine").exists()


@pytest.mark.parametrize(
    "out", ["results/2020-01-01_120000", "results/kept/2020-01-01_120000", "results/mine/2020-01-01_120000"]
)
def test_a_run_that_was_named_with_out_stays_even_if_its_name_is_a_time(copied: Path, out: str):
    done = twin("run", "mine", "--out", out, cwd=copied)
    assert done.returncode == 0, done.stderr
    assert told("--prune", "--yes", "--keep", "0", cwd=copied).stdout.splitlines()[-1].startswith("removed 3 runs, ")
    assert (copied / out / "run.mcap").is_file()


def test_what_twin_did_not_write_stays_in_the_folder_of_a_run_that_goes_and_is_said(copied: Path, tmp_path: Path):
    old, other = (run.folder for run in stored_runs(copied / "results")[1:])
    for form in ("--csv", "--ros2"):
        assert twin("export", str(old), form, "--rate", "100", cwd=copied).returncode == 0
    (old / "report.html").write_text("a page")
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere/run.mcap").write_bytes(b"another one")
    notes = {old / "notes.txt", old / "pictures/run.mcap", old / "link"}
    (old / "notes.txt").write_text("the spring was cold")
    (old / "pictures").mkdir()
    (old / "pictures/run.mcap").write_bytes(b"mine")
    (old / "link").symlink_to(tmp_path / "elsewhere")
    lines = told("--prune", "--yes", cwd=copied).stdout.splitlines()
    first = lines.index("stays, because twin did not write it:") + 1
    assert lines[first:-1] == sorted(f"  {path.relative_to(copied)}" for path in notes)
    assert lines[-1].startswith("removed 2 runs, ") and lines[-1].endswith("; 3 files that twin did not write stayed")
    assert {path for path in old.rglob("*") if path.name != "pictures"} == notes and not other.exists()
    assert (tmp_path / "elsewhere/run.mcap").is_file()
    assert len(stored_runs(copied / "results")) == 1


def forged(recording: Path, found: dict[str, dict[str, str]], monkeypatch: pytest.MonkeyPatch) -> str:
    """Why a run whose recording says `found` is not compared with its file."""
    monkeypatch.setattr("twin.studies.results.stored.read_metadata", lambda path: found)
    return describe_differences(StoredRun(recording.parent, recording, True), CurrentExperiments())[1]


@pytest.mark.parametrize("name", ["{elsewhere}/secret.toml", "../elsewhere/secret.toml", "secret.toml", "plain"])
def test_of_what_a_recording_calls_its_experiment_only_a_name_is_looked_up(
    home: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
):
    for folder in ("here", "elsewhere"):
        (tmp_path / folder).mkdir()
        for file in ("secret.toml", "plain"):
            (tmp_path / folder / file).write_text("a secret")
    monkeypatch.chdir(tmp_path / "here")
    recording = recording_in(home / "results/mine")
    found = read_metadata(recording)
    found["experiment"]["name"] = name.format(elsewhere=tmp_path / "elsewhere")
    why = forged(recording, found, monkeypatch)
    assert "not a valid name" in why and "TOML" not in why


@pytest.mark.parametrize(("table", "key"), [("drive", "fmu"), ("contact", "body"), ("controller", "python")])
def test_files_that_a_recording_names_by_a_path_are_not_opened(
    home: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, table: str, key: str
):
    secret = tmp_path / f"secret.{'toml' if key == 'body' else 'fmu'}"
    secret.write_text("a secret")
    recording = recording_in(home / "results/mine")
    found = read_metadata(recording)
    values = json.loads(found["experiment"]["values"])
    values.setdefault(table, {})[key] = f"{secret}:Law" if key == "python" else str(secret)
    found["experiment"]["values"] = json.dumps(values)
    found["origins"][f"{table}.{key}"] = COMMAND_LINE
    monkeypatch.chdir(home)
    why = forged(recording, found, monkeypatch)
    assert why and "not valid TOML" not in why and "zip" not in why


def test_a_folder_that_a_link_leads_to_is_neither_listed_nor_removed(copied: Path, tmp_path: Path):
    shutil.move(copied / "results", tmp_path / "elsewhere")
    (copied / "results").mkdir()
    (copied / "results/mine").symlink_to(tmp_path / "elsewhere/mine")
    assert stored_runs(copied / "results") == []


def test_an_experiment_without_runs_is_refused_with_the_nearest(home: Path):
    with pytest.raises(InputRefused, match="no run of it; did you mean 'mine'"):
        stored_runs(home / "results", ["min"])


def test_a_command_that_takes_the_latest_run_says_which_and_what_it_was_made_with(copied: Path):
    runs = stored_runs(copied / "results")
    (copied / "results/mine/latest").unlink()
    (copied / "results/mine/latest").symlink_to(runs[1].folder.name)
    done = twin("export", "results/mine", "--csv", cwd=copied)
    stamp = runs[1].folder.name
    assert done.stderr == f"results/mine: the latest run, {stamp}, made with --drive pmsm_foc --set seed=3\n"
    assert twin("export", f"results/mine/{stamp}", "--csv", "--force", cwd=copied).stderr == ""


@pytest.mark.parametrize(
    "words",
    [
        ("compare", "results/mine", "{run}"),
        ("report", "results/mine"),
        ("shadow", "mine", "--source", "results/mine", "--speed", "0"),
    ],
)
def test_json_names_the_run_that_was_read_as_the_latest_and_what_was_changed_in_it(copied: Path, words: Sequence[str]):
    runs = stored_runs(copied / "results")
    (copied / "results/mine/latest").unlink()
    (copied / "results/mine/latest").symlink_to(runs[1].folder.name)
    read_run = {"run": f"results/mine/{runs[1].folder.name}", "changed": ["--drive", "pmsm_foc", "--set", "seed=3"]}
    done = twin(*(word.format(run=read_run["run"]) for word in words), "--json", cwd=copied)
    assert json.loads(done.stdout)["read"] == [read_run] and ": the latest run, " in done.stderr


def test_replay_names_the_run_as_it_was_typed(own: tuple[Path, list[str]]):
    home, typed = own
    run = recording_in(home / "results/press here").parent.resolve().name
    done = twin("replay", "results/press here", "--baseline", "0.05", "--json", cwd=home)
    assert json.loads(done.stdout)["read"] == [{"run": f"results/press here/{run}", "changed": typed[1:]}], done.stderr


def test_what_is_read_without_samples_is_what_is_read_with_them(home: Path):
    recording = recording_in(home / "results/mine")
    assert read_metadata(recording) == read(recording).metadata
