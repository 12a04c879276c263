"""Experiment stored in a recording: name, values and FMUs."""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError

from twin.kernel.errors import InputRefused
from twin.kernel.files import parse_json
from twin.kernel.settings import Settings
from twin.robot.experiment.experiment import TABLE_ARRAYS, TopLevelKeys
from twin.robot.experiment.mistakes import error_messages, type_error_messages
from twin.robot.experiment.schema import DeclaredTables
from twin.robot.experiment.source import Source

Metadata = Mapping[str, Mapping[str, str]]
NAME_PATTERN = re.compile(r"(?!\.{1,2}$)[^/\\\x00-\x1f\x7f]{1,150}")
"""Pattern of an experiment's name, the stem of a file name."""
MAX_LISTED_ERRORS = 3
"""Maximum number of listed errors of a recording, as recordings are not repaired by hand."""


class RecordedFmu(BaseModel):
    """Description of an FMU in the metadata of a recording, as written by `twin.robot.run.run`."""

    file: str
    sha256: str
    model: str
    fmi: str
    generation_tool: str | None
    set: dict[str, Any]
    mapped: list[str]
    # missing in older recordings; only model exchange uses twin's solver
    kind: str = "co_simulation"
    solver: str | None = None
    solver_step: float | None = None
    tolerance: float | None = None
    stop_time: float | None = None


def recorded_name(metadata: Metadata, where: Path) -> str:
    """Return the name of the experiment stored in a recording; "unknown experiment" if missing.

    Raises:
        InputRefused: the name is invalid. Results folders are named after it, and a recording is untrusted.
    """
    name = metadata.get("experiment", {}).get("name", "unknown experiment")
    if not NAME_PATTERN.fullmatch(name):
        raise InputRefused(f"{where}: calls its experiment {name!r}, which is not a valid name")
    return name


def recorded_values(declared: DeclaredTables, metadata: Metadata, where: Path) -> dict[str, Any]:
    """Return the checked values of the experiment stored in a recording, keys with units; empty if missing.

    Unknown and missing keys are accepted, as the recording may come from another version.
    """
    text = metadata.get("experiment", {}).get("values", "{}")
    values = parse_json(text, f"{where}: its experiment")
    mistakes = [] if isinstance(values, dict) else ["expected tables of values"]
    if not mistakes:
        mistakes = _type_errors(declared, values)
    if mistakes:
        raise InputRefused(f"{where}: its experiment is not valid: {'; '.join(mistakes)}")
    return values


def recorded_fmus(metadata: Metadata, where: Path) -> dict[str, dict[str, Any]]:
    """Return the recorded description of each FMU of the drives, by `drive_1` or `drive_1.part`."""
    fmus = {}
    for name, text in metadata.get("fmu", {}).items():
        facts = parse_json(text, f"{where}: its FMU of {name}")
        try:
            fmus[name] = RecordedFmu.model_validate(facts).model_dump()
        except ValidationError as error:
            problems = "; ".join(error_messages(error, RecordedFmu, name)[:MAX_LISTED_ERRORS])
            raise InputRefused(f"{where}: its FMU of {name}: {problems}") from None
    return fmus


def _type_errors(declared: DeclaredTables, values: dict[str, Any]) -> list[str]:
    source = Source()
    mistakes: list[str] = []
    models: dict[str, type[Settings]] = {"head": TopLevelKeys, **declared.tables}
    source.merge(values, "recorded")
    head = {key: value for key, value in source.values.items() if not isinstance(value, dict)}
    for name, model in models.items():
        try:
            model.model_validate(head if name == "head" else source.values.get(name, {}))
        except ValidationError as error:
            mistakes += type_error_messages(error, model, name)
    for name in TABLE_ARRAYS:
        items = values.get(name, [])
        if not isinstance(items, list) or not all(isinstance(item, dict) for item in items):
            mistakes.append(f"[{name}]: expected an array of tables")
    drive = values.get("drive", {})
    tables = [drive, *drive.values()] if isinstance(drive, dict) else [None]
    files = [table["fmu"] for table in tables if isinstance(table, dict) and "fmu" in table]
    if None in tables or not all(isinstance(file, str) for file in files):
        mistakes.append("[drive]: expected a table whose fmu is text")
    return mistakes[:MAX_LISTED_ERRORS]
