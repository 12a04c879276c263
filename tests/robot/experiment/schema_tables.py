"""The tables of the experiment's JSON Schema, walked."""

from collections.abc import Iterator
from typing import Any


def tables(schema: dict[str, Any], path: str = "") -> Iterator[tuple[str, set[str]]]:
    """(dotted path, keys) of every table but the joints' drives and the arrays."""
    node = resolved(schema, path)
    joints = {"joint_1", "joint_2", "joint_3"} | (
        {"task", "fault", "change", "measure", "extends"} if not path else set()
    )
    keys = node["properties"].keys() - joints
    yield path, {key for key in keys if not _is_table(node["properties"][key])}
    for key in sorted(keys):
        if _is_table(node["properties"][key]):
            yield from tables(schema, f"{path}.{key}".lstrip("."))


def _is_table(node: dict[str, Any]) -> bool:
    return "$ref" in node or "properties" in node


def resolved(schema: dict[str, Any], path: str) -> dict[str, Any]:
    """The schema of the table at the dotted `path`."""
    node = schema
    for key in filter(None, path.split(".")):
        node = node["properties"][key]
        if "$ref" in node:
            node = schema["$defs"][node["$ref"].rpartition("/")[2]]
    return node
