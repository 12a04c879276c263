"""Rows of docs/keys.md, made of the declarations of the keys; `python -m tests.docs.schema_rows` writes them."""

import re
from typing import Any, Literal, get_args, get_origin

import annotated_types
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

from tests.conftest import ROOT
from twin.kernel.settings import Settings
from twin.robot.assembly.declared import DECLARED_TABLES
from twin.robot.controller.program import TASK_KINDS
from twin.robot.experiment import fault, measure, schema, stand_in
from twin.robot.experiment.experiment import TopLevelKeys
from twin.robot.experiment.schema import nested_tables

PAGE = ROOT / "docs/keys.md"
ELSEWHERE = ("controller.model", "estimator", "body")
"""Tables of which the page says that they are as another one."""
_DECLARED = {
    path: model for name, table in DECLARED_TABLES.tables.items() for path, model in nested_tables(table, name).items()
}
_ARRAYS = {"controller.force.schedule": "[[controller.force.schedule]]"}
TABLES: dict[str, type[Settings]] = {
    "top of the file": TopLevelKeys,
    **{_ARRAYS.get(path, f"[{path}]"): model for path, model in _DECLARED.items() if path not in ELSEWHERE},
    "[drive]": schema.Drive,
    "[drive.velocity_loop]": schema.VelocityLoop,
    "[drive.position_command]": schema.PositionCommand,
    "[drive.rotor]": schema.Rotor,
    "[drive.unpowered]": schema.UnpoweredDrive,
    "[drive.parts.NAME]": schema.DrivePart,
    "a third-party part": stand_in.StandIn,
    **{f'[[task]] kind = "{kind}"': table for kind, table in TASK_KINDS.items()},
    "[[fault]]": fault.FaultTable,
    "[[change]]": schema.ChangeTable,
    **{f'[[measure]] kind = "{kind}"': table for kind, table in measure.MEASURE_KINDS.items()},
}
ROWS = re.compile(r"(^\|---.*\n)(?:\|.*\n)*", re.MULTILINE)
SIGNS = {annotated_types.Gt: ">", annotated_types.Ge: ">=", annotated_types.Lt: "<", annotated_types.Le: "<="}


def rows(model: type[Settings]) -> dict[str, str]:
    """Return the row of each key of a table; [plant] has only the keys that [robot] does not have."""
    tables = DECLARED_TABLES.tables
    inherited = tables["robot"].model_fields if model is tables["plant"] else {}
    return {
        (key := field.alias or name): f"| `{key}` | {' | '.join(_cells(name, field))} |"
        for name, field in model.model_fields.items()
        if name not in inherited and not _is_table(field)
    }


def _cells(name: str, field: FieldInfo) -> tuple[str, ...]:
    """Unit, default, allowed values and meaning of a key."""
    return _unit(name, field), _default(field), _allowed(field), field.description or ""


def _is_table(field: FieldInfo) -> bool:
    """Whether the key opens a table that has rows of its own."""
    kinds = (field.annotation, *get_args(field.annotation))
    return any(isinstance(kind, type) and issubclass(kind, Settings) for kind in kinds)


def _unit(name: str, field: FieldInfo) -> str:
    if field.alias is None:
        return ""
    over, *under = [
        " ".join(part.replace("Nm", "N_m").strip("_").split("_"))
        for part in field.alias.removeprefix(f"{name}_").split("per")
    ]
    below = " per ".join(f"({part})" if " " in part and len(under) == 1 else part for part in under)
    return f"{over or '1'}/{below}" if below else over


def _default(field: FieldInfo) -> str:
    if field.default is PydanticUndefined:
        return "" if field.default_factory else "needed"
    match field.default:
        case None:
            return ""
        case bool(value):
            return f"`{value}`".lower()
        case str(value):
            return f'`"{value}"`'
        case tuple(value):
            return f"`{[int(part) if part == int(part) else part for part in value]}`"
        case value:
            return f"`{value:g}`"


def _allowed(field: FieldInfo) -> str:
    kind: Any = next((k for k in get_args(field.annotation) if get_origin(k) is Literal), field.annotation)
    if get_origin(kind) is Literal:
        return ", ".join(f'"{value}"' if isinstance(value, str) else str(value) for value in get_args(kind))
    bounds = [
        f"{SIGNS[type(bound)]} {_limit(bound):g}"
        for bound in field.metadata
        if type(bound) in SIGNS and _limit(bound) < 2**62
    ]
    return ", ".join(bounds)


def _limit(bound: Any) -> float:
    return getattr(bound, {">": "gt", ">=": "ge", "<": "lt", "<=": "le"}[SIGNS[type(bound)]])


def completed(page: str) -> str:
    """Return the text of `page` with the rows of its tables."""
    first, *sections = page.split("\n## ")
    return "\n## ".join([first, *(_with_rows(section) for section in sections)])


def _with_rows(section: str) -> str:
    model = TABLES.get(section.partition("\n")[0].replace("`", ""))
    if model is None:
        return section
    body = "".join(f"{row}\n" for row in rows(model).values())
    return ROWS.sub(lambda head: head[1] + body, section + "\n")[:-1]


if __name__ == "__main__":
    PAGE.write_text(completed(PAGE.read_text()))
