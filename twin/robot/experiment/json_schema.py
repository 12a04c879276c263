"""JSON Schema (draft 2020-12) of experiment files, for editors that complete and check TOML.

It is generated from the models that check an experiment, so both always agree. It describes a single file, which may
leave any key to the file that it extends; requirements on a whole experiment are checked by `load_experiment`.
"""

import json
from collections.abc import Mapping
from typing import Any

from pydantic import BaseModel
from pydantic.json_schema import GenerateJsonSchema

from twin.robot.experiment import schema
from twin.robot.experiment.drive_files import JOINT_TABLES
from twin.robot.experiment.experiment import TopLevelKeys
from twin.robot.experiment.fault import FAULT_KINDS, fault_table_model
from twin.robot.experiment.measure import MEASURE_KINDS as MEASURES
from twin.robot.experiment.schema import ChangeTable, DeclaredTables
from twin.robot.experiment.source import RETAINED_KEYS
from twin.robot.experiment.stand_in import StandIn

SCHEMA_DIALECT = "https://json-schema.org/draft/2020-12/schema"
SCHEMA_FILE = "experiment.schema.json"
"""Default file name of the schema."""

Node = dict[str, Any]


def schema_text(declared: DeclaredTables) -> str:
    """Return the JSON Schema of experiment files as the text of a file."""
    return json.dumps(experiment_json_schema(declared), indent=1) + "\n"


def experiment_json_schema(declared: DeclaredTables) -> Node:
    """Build the JSON Schema of an experiment file, and of the robots and bodies that it extends."""
    defined: Node = {}
    head = _table(TopLevelKeys, defined)
    tables = {name: _table(model, defined) for name, model in declared.tables.items()}
    for role in RETAINED_KEYS:
        tables[role]["properties"] |= _table(StandIn, defined)["properties"]
    defined["Drive"] = _table(schema.Drive, defined)
    joints = {name: {"$ref": "#/$defs/Drive"} for name in JOINT_TABLES}
    drive = {**defined["Drive"], "properties": {**defined["Drive"]["properties"], **joints}}
    changed = {"enum": list(declared.changeable), "description": "What changes."}
    changes = "Scheduled changes of the controller."
    extends = {"type": "string", "description": "File with values for all keys that this one does not set."}
    return {
        "$schema": SCHEMA_DIALECT,
        "title": "Experiment of twin",
        "type": "object",
        "additionalProperties": False,
        "properties": {
            "extends": extends,
            **head["properties"],
            **tables,
            "drive": drive,
            "task": _array(
                _by_kind(declared.tasks, defined),
                "Tasks of the robot, one after the other; instead of [reference].",
            ),
            "fault": _array(_faults(defined), "What breaks."),
            "change": _array([_array_item(ChangeTable, {"key": changed}, defined)], changes),
            "measure": _array(_by_kind(MEASURES, defined), "Measures of twin check."),
        },
        "$defs": defined,
    }


class _SchemaGenerator(GenerateJsonSchema):
    """Generator of JSON Schema that leaves out titles derived from keys, because editors show the key itself."""

    def field_title_should_be_set(self, schema: Any) -> bool:
        return False


def _by_kind(kinds: Mapping[str, type[BaseModel]], defined: Node) -> list[Node]:
    return [_array_item(model, {"kind": {"const": kind}}, defined) for kind, model in kinds.items()]


def _faults(defined: Node) -> list[Node]:
    tables = []
    for name, kind in FAULT_KINDS.items():
        target = {"enum": list(kind.targets), "default": kind.targets[0], "description": "What breaks."}
        tables.append(_array_item(fault_table_model(kind), {"kind": {"const": name}, "target": target}, defined))
    return tables


def _array(tables: list[Node], description: str) -> Node:
    return {"type": "array", "description": description, "items": {"oneOf": tables}}


def _array_item(model: type[BaseModel], known: Node, defined: Node) -> Node:
    """Return the JSON Schema of a table in an array; as it extends no other file, keys can be required."""
    table = _table(model, defined)
    required = [info.alias or name for name, info in model.model_fields.items() if info.is_required()]
    return {**table, "properties": {**table["properties"], **known}, "required": required}


def _table(model: type[BaseModel], defined: Node) -> Node:
    """Return the JSON Schema of a table; schemas that it refers to are added to `defined`."""
    made = model.model_json_schema(schema_generator=_SchemaGenerator)
    defined |= {name: _as_toml(node) for name, node in made.pop("$defs", {}).items()}
    return _as_toml(made)


def _as_toml(table: Node) -> Node:
    """Convert a pydantic model's JSON Schema to that of a TOML table: no key is required, values may have a source."""
    properties = {key: _value(node) for key, node in table["properties"].items()}
    return {
        "type": "object",
        "description": table["description"],
        "additionalProperties": False,
        "properties": properties,
    }


def _value(node: Node) -> Node:
    """Return the JSON Schema of a value that may be bare or `{ value = .., source = ".." }`."""
    described = {key: node[key] for key in ("description", "default", "examples") if node.get(key) is not None}
    bare = _without_null({key: node[key] for key in node if key not in ("description", "default", "examples")})
    if "$ref" in bare:
        return bare
    if bare.get("type") == "object":
        return {**bare, "additionalProperties": _value(bare["additionalProperties"]), **described}
    sourced = {
        "type": "object",
        "properties": {"value": bare, "source": {"type": "string"}},
        "required": ["value"],
        "additionalProperties": False,
    }
    return {"anyOf": [bare, sourced], **described}


def _without_null(node: Node) -> Node:
    """Remove null from a JSON Schema, because TOML has no null and missing keys are left out."""
    kinds = [kind for kind in node.get("anyOf", ()) if kind != {"type": "null"}]
    node = kinds[0] if len(kinds) == 1 else node
    entries = node.get("prefixItems", ())
    if entries and all(entry == entries[0] for entry in entries):
        # many editors are limited to older dialects, which know this but not prefixItems
        node = {**{key: node[key] for key in node if key != "prefixItems"}, "items": _without_null(entries[0])}
    if "items" in node:
        node = {**node, "items": _without_null(node["items"])}
    return node
