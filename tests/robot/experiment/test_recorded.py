"""What a recording says of its experiment."""

import json
import shlex
from pathlib import Path

import pytest

from twin.kernel.errors import InputRefused
from twin.robot.assembly.declared import DECLARED_TABLES
from twin.robot.assembly.load import load_experiment
from twin.robot.experiment.command_words import repeating_words, run_command, run_words
from twin.robot.experiment.differences import robot_values
from twin.robot.experiment.experiment import Experiment
from twin.robot.experiment.recorded import recorded_fmus, recorded_values
from twin.robot.experiment.template import start_experiment

WHERE = Path("run.mcap")


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ("", "run.mcap: its experiment: not valid JSON"),
        ("[" * 100_000, "nested too deeply"),
        ("null", "expected tables of values"),
        ("[1, 2]", "expected tables of values"),
        ('{"a":' * 50 + "1" + "}" * 50, "nested too deeply"),
        ('{"plant": 5}', "[plant]"),
        ('{"plant": {"N": "two"}}', '[plant] N = "two": expected a number'),
        ('{"plant": {"N": NaN}}', "[plant] N = nan: expected a finite number"),
        ('{"contact": {"height_mm": []}}', "[contact] height_mm = []: expected a number"),
        ('{"contact": {"shape": "torus"}}', "[contact] shape"),
        ('{"controller": {"mode": {}}}', "[controller] mode = {}: expected"),
        ('{"task": {"kind": "press"}}', "[task]: expected an array of tables"),
        ('{"fault": [1]}', "[fault]: expected an array of tables"),
        ('{"drive": "mine.fmu"}', "[drive]: expected a table"),
        ('{"drive": {"joint_1": {"fmu": 7}}}', "[drive]: expected a table whose fmu is text"),
        ('{"title": 3}', "title = 3: expected text"),
    ],
)
def test_values_that_are_no_experiments_are_refused_in_a_sentence(values: str, said: str):
    with pytest.raises(InputRefused) as refused:
        recorded_values(DECLARED_TABLES, {"experiment": {"values": values}}, WHERE)
    assert said in str(refused.value)
    assert len(str(refused.value).splitlines()) == 1


def test_values_of_another_version_are_read_as_they_are():
    values = {"plant": {"N": 2.0, "made_up_later": 1}, "made_up": {"x": [1, {"y": None}]}, "seed": -1}
    assert recorded_values(DECLARED_TABLES, {"experiment": {"values": json.dumps(values)}}, WHERE) == values
    assert recorded_values(DECLARED_TABLES, {}, WHERE) == {}


@pytest.mark.parametrize("text", ["", "null", "[]", "{}", '{"file": 1}', '{"sha256": "x"}'])
def test_an_fmu_that_is_none_is_refused_in_a_sentence(text: str):
    with pytest.raises(InputRefused, match=r"^run\.mcap: its FMU of drive_1: ") as refused:
        recorded_fmus({"fmu": {"drive_1": text}}, WHERE)
    assert len(str(refused.value).splitlines()) == 1


@pytest.mark.parametrize(
    ("file", "start", "said"),
    [
        ("a.toml", "taping", "--from taping: no such experiment; did you mean 'tapping'?"),
        ("a.toml", "xyz", "--from xyz: no such experiment; known are calibration, "),
        ("a.yaml", "tapping", "a.yaml: expected a name that ends with .toml"),
        ("/proc/nowhere/a.toml", "tapping", "/proc/nowhere: cannot be created"),
    ],
)
def test_what_cannot_be_started_is_refused_and_nothing_is_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, file: str, start: str, said: str
):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputRefused) as refusal:
        start_experiment(DECLARED_TABLES, Path(file), start)
    assert str(refusal.value).startswith(said)
    assert not list(tmp_path.iterdir())


def counts(experiment: Experiment) -> dict[str, int]:
    return robot_values(experiment.values, experiment.origins)


def test_values_of_ones_own_robot_are_counted_apart_from_inherited_assumptions(root: Path, tmp_path: Path):
    shipped = root / "experiments/fig4_position.toml"
    # the paper prints three values, and Eq. 18 has the fourth
    assert counts(load_experiment(shipped)) == {"own": 0, "assumed": 18}
    own = tmp_path / "own.toml"
    own.write_text(
        f'extends = "{shipped}"\n[robot]\na_mm = 50.5\nm_a_g = {{ value = 41.0, source = "assumed: of the drawing" }}\n'
    )
    assert counts(load_experiment(own)) == {"own": 2, "assumed": 16}
    assert counts(load_experiment(own, ["robot.b_mm=31", "robot.joint_zero_deg.2=1"])) == {"own": 4, "assumed": 14}
    # the value of the paper is no assumption, whoever changes it
    assert counts(load_experiment(own, ["robot.k_s_Nm_per_rad=2"])) == {"own": 3, "assumed": 16}


@pytest.mark.parametrize("source", ["assumed: weighed by hand", "datasheet of the rods"])
def test_a_value_that_is_restated_with_a_source_of_ones_own_is_own(root: Path, tmp_path: Path, source: str):
    shipped, own = root / "experiments/fig4_position.toml", tmp_path / "own.toml"
    own.write_text(f'extends = "{shipped}"\n[robot]\nm_b_g = {{ value = 30.0, source = "{source}" }}\n')
    assert load_experiment(own).values["robot"] == load_experiment(shipped).values["robot"]
    assert counts(load_experiment(own)) == {"own": 1, "assumed": 17}


def test_a_robot_that_was_written_out_is_still_assumed(root: Path, tmp_path: Path):
    file, _ = start_experiment(DECLARED_TABLES, tmp_path / "mine.toml", "pressing")
    assert counts(load_experiment(file)) == {"own": 0, "assumed": 18}


@pytest.mark.parametrize("drive", [None, "pmsm_foc", "my drives/it's mine.toml"])
def test_words_of_a_run_are_read_by_the_shell_as_they_were_typed(drive: str | None):
    words = run_words("my lab/press here.toml", ['title="it\'s"', "seed=3"], drive, "back")
    assert shlex.split(run_command(words)) == ["twin", "run", *words]
    assert repeating_words({"typed": list(words)}, "press here", []) == list(words)
