"""A file that is meant for something else than to be run says in one sentence what it is for."""

from pathlib import Path

import pytest

from twin.errors import InputRefused
from twin.runs.assembly.load import load_experiment


@pytest.mark.parametrize(
    ("file", "told"),
    [
        ("experiments/robots/massage_robot.toml", "a robot, not an experiment; one extends it"),
        ("experiments/bodies/back.toml", "a body, not an experiment; press on it with: twin run pressing --body"),
        ("experiments/sweeps/drives.toml", "a sweep, not an experiment; run it with: twin sweep"),
        ("fmus/modelica_dc/mapping.toml", "the mapping of a drive, not an experiment; use it with: twin run"),
    ],
)
def test_it_is_one_sentence(root: Path, file: str, told: str):
    with pytest.raises(InputRefused) as refusal:
        load_experiment(root / file)
    assert str(refusal.value).startswith(f"{root / file}: {told}") and "\n" not in str(refusal.value)


def test_every_robot_and_body_is_told_apart_and_no_experiment_is(root: Path):
    for folder in ("robots", "bodies", "sweeps"):
        for path in (root / "experiments" / folder).glob("*.toml"):
            with pytest.raises(InputRefused, match="not an experiment"):
                load_experiment(path)
    for path in (root / "experiments").glob("*.toml"):
        load_experiment(path)
