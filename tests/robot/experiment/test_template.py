import re
import tomllib
from pathlib import Path

import jsonschema
import pytest

from tests.robot.experiment.schema_tables import tables
from twin.robot.assembly.declared import DECLARED_TABLES
from twin.robot.assembly.load import load_experiment
from twin.robot.experiment.json_schema import experiment_json_schema
from twin.robot.experiment.template import commented_experiment

EXPERIMENTS = sorted((Path(__file__).parents[3] / "experiments").glob("*.toml"))


@pytest.mark.parametrize("file", EXPERIMENTS, ids=lambda file: file.stem)
def test_an_experiment_started_from_another_is_that_one(file: Path, tmp_path: Path):
    mine = tmp_path / "mine.toml"
    mine.write_text(commented_experiment(DECLARED_TABLES, mine.name, file))
    started, original = load_experiment(mine), load_experiment(file)
    assert started.values == original.values
    assert started.origins.keys() == original.origins.keys()
    reasons = [{k: v for k, v in e.origins.items() if not v.startswith("set in ")} for e in (started, original)]
    assert reasons[0] == reasons[1]


@pytest.mark.parametrize("base", ["fig4_force_position", "massage"])
def test_what_is_behind_a_mark_is_right_too_and_has_every_key(root: Path, base: str):
    text = commented_experiment(DECLARED_TABLES, "mine.toml", root / "experiments" / f"{base}.toml")
    everything = tomllib.loads(re.sub(r"^#(?=[\[\w])", "", text, flags=re.MULTILINE))
    schema = experiment_json_schema(DECLARED_TABLES)
    assert [error.message for error in jsonschema.Draft202012Validator(schema).iter_errors(everything)] == []
    inherited = {"controller.model", "plant"}
    for path, keys in tables(schema):
        if path not in inherited:
            assert keys <= _at(everything, path).keys(), path


def _at(values: dict, path: str) -> dict:
    for key in filter(None, path.split(".")):
        values = values[key]
    return values


def test_the_change_and_the_measure_behind_a_hash_would_do(tmp_path: Path):
    text = commented_experiment(DECLARED_TABLES, "mine.toml", EXPERIMENTS[0].with_stem("fig4_force_position"))
    start, end = text.index("#[[change]]"), text.index("# The robot as the file")
    mine = tmp_path / "mine.toml"
    # what is set behind a # has no blank after it, what is told has one
    mine.write_text(text[:start] + re.sub(r"(?m)^#(?! )", "", text[start:end]) + text[end:])
    experiment = load_experiment(mine)
    assert (len(experiment.changes), len(experiment.measures)) == (1, 1)
