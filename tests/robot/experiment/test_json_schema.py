import tomllib
from pathlib import Path

import jsonschema
import pytest

from tests.robot.experiment.schema_tables import resolved, tables
from twin.robot.assembly.declared import DECLARED_TABLES
from twin.robot.experiment.json_schema import SCHEMA_DIALECT, experiment_json_schema

SCHEMA = experiment_json_schema(DECLARED_TABLES)
VALIDATOR = jsonschema.Draft202012Validator(SCHEMA)
ROOT = Path(__file__).parents[3] / "experiments"
# sweeps and hazard tables name an experiment and are none
FILES = sorted(set(ROOT.rglob("*.toml")) - {*(ROOT / "sweeps").iterdir(), *(ROOT / "safety").iterdir()})
TASK = {"kind": "press", "point_mm": [0.0, 0.0], "force_N": 8.0, "build_up_s": 3.5, "hold_s": 5.0}
FAULT = {"kind": "surface_jump", "onset_s": 3.0, "magnitude_mm": 2.0}
CHANGE = {"t_s": 8.0, "key": "controller.force.reference_N", "value": 6.0}
SPREAD = {"kind": "spread", "name": "force", "signal": "-plant.F_ee_B[2]"}


def test_the_schema_is_one_of_draft_2020_12():
    assert SCHEMA["$schema"] == SCHEMA_DIALECT
    jsonschema.Draft202012Validator.check_schema(SCHEMA)


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_every_file_of_the_repository_is_right(file: Path):
    assert [error.message for error in VALIDATOR.iter_errors(tomllib.loads(file.read_text()))] == []


@pytest.mark.parametrize(
    "wrong",
    [
        {"titel": "x"},
        {"title": 3},
        {"duration_s": 0.0},
        {"cosim": {"scheme": "gauss"}},
        {"controller": {"force": {"kp_N": 1.0}}},
        {"controller": {"force": {"kp_mm_per_N": {"value": "a lot", "source": "me"}}}},
        {"controller": {"force": {"kp_mm_per_N": {"value": 1.0, "origin": "me"}}}},
        {"controller": {"gravity_compensation": 1}},
        {"reference": {"p_mm": [[0.0, 0.0]]}},
        {"drive": {"joint_2": {"sign": 2}}},
        {"drive": {"parameters": {"droop": True}}},
        {"task": [{"kind": "pres"}]},
        {"task": [{key: TASK[key] for key in TASK if key != "force_N"}]},
        {"task": [TASK | {"radius_mm": 3.0}]},
        {"fault": [FAULT | {"target": "joint_1"}]},
        {"fault": [{key: FAULT[key] for key in FAULT if key != "magnitude_mm"}]},
        {"change": [CHANGE | {"key": "controller.mode"}]},
        {"measure": [SPREAD | {"signal": "the force"}]},
        {"measure": [SPREAD | {"reference": "controller.F_z_ref"}]},
    ],
    ids=str,
)
def test_what_no_file_may_say_is_found(wrong: dict):
    assert not VALIDATOR.is_valid(wrong)


def test_a_file_may_leave_anything_to_the_one_it_extends():
    assert VALIDATOR.is_valid({"extends": "other.toml", "controller": {"force": {"kp_mm_per_N": 3}}})
    assert VALIDATOR.is_valid({"task": [TASK], "fault": [FAULT], "change": [CHANGE], "measure": [SPREAD]})


def test_every_key_says_what_it_means():
    for path, _ in tables(SCHEMA):
        properties = resolved(SCHEMA, path)["properties"]
        assert [key for key, node in properties.items() if not ("$ref" in node or node.get("description"))] == [], path
