"""What differs in the experiments of two runs is what was made to differ."""

from pathlib import Path

from tests.command_line import twin
from twin.recording.recording import Recording
from twin.studies.compare.experiments import differences_text, experiments_differ


def test_two_runs_say_what_differs_in_their_experiments(force_position: Recording, position: Recording, tmp_path: Path):
    done = twin("compare", force_position.path, position.path, "--signal", "plant.p_B", cwd=tmp_path)
    lines = done.stdout.splitlines()
    place = lines.index("What differs in the experiments, A and B:")
    assert lines[place + 1 : place + 2] == ["  controller.mode  force_position and position"]
    assert max(map(len, lines[place:-2])) <= 80


def test_the_same_experiment_differs_in_nothing(force_position: Recording):
    differ = experiments_differ(force_position.path, force_position.path)
    assert differ == {} and differences_text(differ) == ["", "Nothing differs in the experiments."]


def test_a_log_of_somebody_else_says_of_no_experiment(force_position: Recording, tmp_path: Path):
    (tmp_path / "log.csv").write_text("t\n0\n")
    assert experiments_differ(force_position.path, tmp_path / "log.csv") is None
    assert differences_text(None) == []
