import math
import tomllib
from pathlib import Path

import pytest

from tests.laws.runs import EXPERIMENTS
from twin.errors import InputRefused
from twin.runs.assembly.load import load_experiment
from twin.studies.lines import WIDTH
from twin.studies.tune.fragment import fragment
from twin.studies.tune.gains import gains_of
from twin.studies.tune.goals import Goals
from twin.studies.tune.text import tuning_text
from twin.studies.tune.tuned import Tuned, tuned

AIR = EXPERIMENTS / "step_z_air.toml"


@pytest.fixture(scope="module")
def in_air() -> Tuned:
    """A step in free air, from gains that are unstable."""
    return tuned([load_experiment(AIR, ["controller.position.kp_per_s=60"])], Goals())


def test_unstable_gains_become_stable_and_the_co_simulation_agrees(in_air: Tuned):
    assert [miss.goal for miss in in_air.before.misses] == ["stability"]
    assert in_air.met and in_air.contradictions == []
    assert in_air.before.trials == {} and len(in_air.after.trials) == 1


def test_the_gains_written_are_the_gains_found(in_air: Tuned, tmp_path: Path):
    file = tmp_path / "tuned.toml"
    file.write_text(fragment(in_air, AIR, tmp_path, ()))
    experiment = load_experiment(file)
    assert gains_of(experiment).kp == in_air.after.gains.kp
    assert "M_s at most 1.6" in experiment.origins["controller.position.kp_per_s"]
    assert "force" not in tomllib.loads(file.read_text())["controller"]


def test_gains_that_were_off_while_tuning_are_off_in_what_is_written(in_air: Tuned, tmp_path: Path):
    experiment = tmp_path / "mine.toml"
    experiment.write_text(f'extends = "{AIR}"\n[controller.position]\nki_per_s2 = 3\n')
    setting = "controller.position.ki_per_s2=0"
    file = tmp_path / "tuned.toml"
    file.write_text(fragment(in_air, experiment, tmp_path, ("--set", setting)))
    assert gains_of(load_experiment(file)).kp == in_air.after.gains.kp
    assert f"--set {setting}" in file.read_text().splitlines()[0]


def test_what_is_written_finds_its_experiment_from_anywhere(in_air: Tuned, tmp_path: Path, monkeypatch):
    (tmp_path / "mine.toml").write_text(f'extends = "{AIR}"\n')
    monkeypatch.chdir(tmp_path)
    for folder, name in ((tmp_path / "results", "mine.toml"), (tmp_path.parent, str(tmp_path / "mine.toml"))):
        written = fragment(in_air, Path("mine.toml"), folder, ())
        assert tomllib.loads(written)["extends"] == name


def test_the_text_begins_with_the_verdict_and_keeps_to_80_columns(in_air: Tuned):
    lines = tuning_text(in_air).splitlines()
    assert lines[0].startswith("step_z_air  GOALS MET")
    assert max(map(len, lines)) <= WIDTH


def test_a_goal_that_cannot_be_met_is_named_with_the_best_that_was_found():
    done = tuned([load_experiment(AIR)], Goals(bandwidth=2.0 * math.pi * 50.0))
    assert not done.met
    assert [miss.goal for miss in done.after.misses] == ["bandwidth"]
    assert "bandwidth at least 50 Hz: it is" in tuning_text(done)


def test_gains_that_are_not_tuned_are_refused():
    with pytest.raises(InputRefused, match=r"controller\.position\.ki_per_s2 is not 0"):
        gains_of(load_experiment(AIR, ["controller.position.ki_per_s2=1"]))


def test_a_range_of_stiffness_is_refused_where_nothing_is_pressed_on():
    with pytest.raises(InputRefused, match="nothing is pressed on"):
        tuned([load_experiment(AIR)], Goals(), (300.0, 5000.0))
