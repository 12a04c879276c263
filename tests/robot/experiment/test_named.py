"""Experiments are found by path or by name, those nearby first."""

import shutil
from pathlib import Path

import pytest

from twin.kernel.errors import InputRefused
from twin.robot.assembly.load import load_experiment
from twin.robot.experiment.experiment_files import experiment_file, known_experiments

NAME = "fig4_force_position"


def test_a_name_and_a_path_of_the_repository_are_found_from_any_folder(root: Path, tmp_path: Path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    there = root / "experiments" / f"{NAME}.toml"
    assert experiment_file(NAME) == experiment_file(f"experiments/{NAME}.toml") == there
    assert load_experiment(NAME, ["duration_s=1"]).name == NAME


def test_what_lies_nearby_comes_first(root: Path, tmp_path: Path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for mine in (Path(f"experiments/{NAME}.toml"), Path(f"{NAME}.toml")):
        mine.parent.mkdir(exist_ok=True)
        shutil.copy(root / "experiments" / f"{NAME}.toml", mine)
        assert (tmp_path / experiment_file(NAME)).samefile(tmp_path / mine)
        assert experiment_file(str(mine)) == mine


def test_a_name_that_nothing_has_is_refused_with_the_closest_one(tmp_path: Path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputRefused, match=r"^fig4_forc_position: no such experiment; did you mean 'fig4_force_pos"):
        experiment_file("fig4_forc_position")
    with pytest.raises(InputRefused, match=r"^xyz: no such experiment; known are .*pressing"):
        experiment_file("xyz")


def test_a_path_that_leads_nowhere_and_a_folder_are_left_to_whoever_reads_them(tmp_path: Path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "folder").mkdir()
    for path in ("nowhere.toml", "no/where", "folder"):
        assert experiment_file(path) == Path(path)


def test_the_experiments_that_come_with_twin_are_those_of_the_repository(root: Path):
    assert known_experiments() == {path.stem: path for path in (root / "experiments").glob("*.toml")}
