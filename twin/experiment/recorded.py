"""The experiment that a recording carries with it, ready to run again."""

import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError

from twin.errors import InputRefused
from twin.experiment.experiment import ARRAYS, OPTIONAL_TABLES, TABLES, Experiment, Head, checked_experiment
from twin.experiment.mistakes import sentences, type_mistakes
from twin.experiment.quantity import Section
from twin.experiment.schema import Drive
from twin.experiment.source import Source, located
from twin.files import json_of

Metadata = Mapping[str, Mapping[str, str]]
NAME = re.compile(r"(?!\.{1,2}$)[^/\\\x00-\x1f\x7f]{1,150}")
"""Of an experiment: that of a file, without the suffix."""
MANY = 3
"""So many mistakes of a recording are told: nobody mends them."""


class RecordedFmu(BaseModel):
    """An FMU as `twin.execution.provenance` tells of it."""

    file: str
    sha256: str
    model: str
    fmi: str
    generation_tool: str | None
    set: dict[str, Any]
    mapped: list[str]


def recorded_name(metadata: Metadata, where: Path) -> str:
    """Name of the experiment that a recording was made of; "unknown experiment" if it does not say.

    Raises:
        InputRefused: what it says is no name: folders of results are called so, and a recording may come from anybody.
    """
    name = metadata.get("experiment", {}).get("name", "unknown experiment")
    if not NAME.fullmatch(name):
        raise InputRefused(f"{where}: calls its experiment {name!r}, which is no name of one")
    return name


def recorded_values(metadata: Metadata, where: Path) -> dict[str, Any]:
    """The checked values of the experiment that a recording was made of, keys with units; empty if it holds none.

    Keys that are not known any more, or that were not known yet, are no mistake: the recording may be of another
    version.

    Raises:
        InputRefused: no JSON, or values of other types than an experiment's.
    """
    text = metadata.get("experiment", {}).get("values", "{}")
    values = json_of(text, f"{where}: its experiment")
    mistakes = [] if isinstance(values, dict) else ["expected tables of values"]
    if not mistakes:
        mistakes = _wrong_types(values)
    if mistakes:
        raise InputRefused(f"{where}: its experiment is none: {'; '.join(mistakes)}")
    return values


def recorded_fmus(metadata: Metadata, where: Path) -> dict[str, dict[str, Any]]:
    """What a recording says of each drive's FMUs, by `drive_1` or `drive_1.part`: the fields of `RecordedFmu`.

    Raises:
        InputRefused: it says something else.
    """
    fmus = {}
    for name, text in metadata.get("fmu", {}).items():
        facts = json_of(text, f"{where}: its FMU of {name}")
        try:
            fmus[name] = RecordedFmu.model_validate(facts).model_dump()
        except ValidationError as error:
            told = "; ".join(sentences(error, RecordedFmu, name)[:MANY])
            raise InputRefused(f"{where}: its FMU of {name}: {told}") from None
    return fmus


def recorded_experiment(metadata: Metadata, where: Path) -> Experiment:
    """The experiment of a recording with the very FMUs that it was made with.

    A recording names its FMUs by file name and SHA-256, not by where they lay: they are looked up as those of an
    experiment file beside it, and in fmus/. Every drive pins its recorded SHA-256, so that no other file is taken.

    Args:
        metadata: of the recording. where: the recording.

    Raises:
        InputRefused: it carries no experiment, was made with substitutes or changed by hand while it ran, or an FMU is
            not found.
    """
    name, values = recorded_name(metadata, where), recorded_values(metadata, where)
    if "drive" not in values:
        raise InputRefused(f"{where}: carries no experiment that could be run again")
    fmus = {drive: facts["sha256"] for drive, facts in recorded_fmus(metadata, where).items()}
    drive = values["drive"]
    if "substituted" in metadata:
        parts = ", ".join(metadata["substituted"])
        raise InputRefused(f"{where}: was made with a substitute for {parts}, so its experiment does not make it again")
    if "changed" in metadata:
        raise InputRefused(f"{where}: was changed by hand while it ran, so its experiment does not make it again")
    if not fmus:
        raise InputRefused(f"{where}: carries no FMUs, so its experiment cannot be run again as it was")
    folder = where.resolve().parent
    # the body's file has filled [contact] in already
    values.get("contact", {}).pop("body", None)
    source = Source()
    source.put(values | {"drive": _with_paths(drive, where, folder)}, "recorded")
    experiment = checked_experiment(source, name, where, folder)
    one, two, three = (
        _pinned(drive, f"drive_{number}", fmus) for number, drive in enumerate(experiment.drives, start=1)
    )
    return replace(experiment, drives=(one, two, three))


def _with_paths(table: dict[str, Any], where: Path, folder: Path) -> dict[str, Any]:
    """[drive] with paths of FMUs where it has names."""
    return {
        key: _with_paths(value, where, folder)
        if isinstance(value, dict)
        else _path(value, where, folder)
        if key == "fmu"
        else value
        for key, value in table.items()
    }


def _path(name: str, where: Path, folder: Path) -> str:
    # a recording may come from anybody: it names a file, and no way to one
    name = Path(name).name
    # fmus/ first: a run may lie in a folder that is called like its drive
    for candidate in (f"fmus/{name}", f"fmus/{Path(name).stem}/{name}", name):
        path = located(candidate, folder)
        if path.is_file() or (path.exists() and candidate != name):
            return str(path)
    raise InputRefused(f"{where}: its drive {name} is neither in fmus/ nor beside it; put it there to run it again")


def _pinned(drive: Drive, name: str, fmus: Mapping[str, str]) -> Drive:
    parts = {
        part: table.model_copy(update={"sha256": fmus.get(f"{name}.{part}")}) for part, table in drive.parts.items()
    }
    return drive.model_copy(update={"sha256": fmus.get(name), "parts": parts})


def _wrong_types(values: dict[str, Any]) -> list[str]:
    source = Source()
    mistakes: list[str] = []
    models: dict[str, type[Section]] = {"head": Head, **TABLES, **OPTIONAL_TABLES}
    source.put(values, "recorded")
    head = {key: value for key, value in source.values.items() if not isinstance(value, dict)}
    for name, model in models.items():
        try:
            model.model_validate(head if name == "head" else source.values.get(name, {}))
        except ValidationError as error:
            mistakes += type_mistakes(error, model, name)
    for name in ARRAYS:
        items = values.get(name, [])
        if not isinstance(items, list) or not all(isinstance(item, dict) for item in items):
            mistakes.append(f"[{name}]: expected an array of tables")
    drive = values.get("drive", {})
    tables = [drive, *drive.values()] if isinstance(drive, dict) else [None]
    files = [table["fmu"] for table in tables if isinstance(table, dict) and "fmu" in table]
    if None in tables or not all(isinstance(file, str) for file in files):
        mistakes.append("[drive]: expected a table whose fmu is text")
    return mistakes[:MANY]
