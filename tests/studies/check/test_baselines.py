"""Every experiment that has baselines comes to what they say, with every drive: the CI run of `twin check`."""

from pathlib import Path

import pytest

from tests.conftest import ROOT
from twin import check
from twin.robot.assembly.load import load_experiment
from twin.studies.check.baseline import baseline_file, fingerprint, read_baseline, stored_drives, stored_experiments

FOLDER = ROOT / "tests" / "baselines"
EXPERIMENTS = stored_experiments(FOLDER)
DRIVES = sorted(fmu.stem for fmu in ROOT.glob("fmus/*/*.fmu"))
TOO_SLOW = {"track_chirp": ["xl330"]}
"""It lags by more than the 0.1 s that the experiment looks for."""


def measured(experiment: str) -> list[str]:
    return [drive for drive in DRIVES if drive not in TOO_SLOW.get(experiment, [])]


@pytest.mark.slow
@pytest.mark.parametrize("experiment", EXPERIMENTS)
def test_an_experiment_comes_to_what_its_baselines_say(experiment: str):
    assert [str(deviation) for deviation in check(ROOT / f"experiments/{experiment}.toml", baselines=FOLDER)] == []


@pytest.mark.parametrize("experiment", EXPERIMENTS)
def test_a_baseline_is_of_the_experiment_as_it_is_written_now(experiment: str):
    for drive in measured(experiment):
        loaded = load_experiment(ROOT / f"experiments/{experiment}.toml", drive=drive)
        assert read_baseline(baseline_file(FOLDER, experiment, drive)).fingerprint == fingerprint(loaded), drive


@pytest.mark.parametrize("experiment", EXPERIMENTS)
def test_every_drive_of_the_repository_has_a_baseline(experiment: str):
    assert stored_drives(FOLDER, experiment) == measured(experiment)


def test_every_baseline_says_why_it_is_as_it_is():
    files: list[Path] = sorted(FOLDER.glob("*/*.toml"))
    assert [file for file in files if not all(entry.reason for entry in read_baseline(file).history)] == []
