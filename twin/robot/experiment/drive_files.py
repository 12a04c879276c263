"""Completion of [drive]: the mapping file of its folder, and the differences of each joint."""

import copy
import os
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from twin.kernel.errors import InputRefused, nearest
from twin.kernel.files import suggestion
from twin.robot.experiment import schema
from twin.robot.experiment.experiment_files import MAPPING_FILE, drive_names
from twin.robot.experiment.mistakes import error_messages
from twin.robot.experiment.source import merge_tables, read_source, rules_for
from twin.robot.paths import locate_file

JOINT_TABLES = ("joint_1", "joint_2", "joint_3")
FILE_PREFIX = "file:"
"""Prefix of a file name that is a parameter of a drive, relative to the file with the parameter."""
MAX_MAPPINGS = 8
"""Maximum number of mappings that name another mapping as their drive."""


def joint_tables(drive: dict[str, Any], folder: Path) -> list[dict[str, Any]]:
    """Return the complete drive tables of the three joints, with absolute paths of FMUs.

    A drive named by its folder takes missing values from the folder's mapping.toml. `drive` is [drive] of the
    experiment with its joint tables, `folder` the folder of the experiment, where names are looked up.
    """
    common = {key: value for key, value in drive.items() if key not in JOINT_TABLES}
    tables = []
    for joint in JOINT_TABLES:
        own = drive.get(joint, {})
        if not isinstance(own, dict):
            raise InputRefused(f"[drive.{joint}] = {own!r}: expected a table")
        tables.append(complete_drive(own if rules_for("drive", own) else merge_tables(common, own), folder))
    return tables


def load_drive(fmu: str, folder: Path) -> schema.Drive:
    """Load the drive of the command line: an .fmu, a mapping, a folder, or a name in fmus/, looked up from `folder`."""
    table = joint_tables({"fmu": locate_drive(fmu, folder)}, folder)[0]
    try:
        return schema.Drive.model_validate(table)
    except ValidationError as error:
        raise InputRefused(f"{fmu}: " + "; ".join(error_messages(error, schema.Drive, "drive"))) from None


def locate_drive(fmu: str, folder: Path) -> str:
    """Return a drive's absolute path: from the current folder, or a name in fmus/ in `folder` or above."""
    path = Path(fmu)
    # not Path.exists, which raises for a too long name
    if not os.path.exists(path):
        on_shelf = locate_file(f"fmus/{fmu}", folder)
        path = on_shelf if os.path.exists(on_shelf) else path
    return str(path.absolute())


def complete_drive(table: dict[str, Any], folder: Path, mappings: int = MAX_MAPPINGS) -> dict[str, Any]:
    """Merge the table of a drive or another part with the mapping file that it names; make paths absolute."""
    table = copy.deepcopy(table)
    if isinstance(table.get("fmu"), str):
        path = locate_file(table["fmu"], folder)
        mapping = path / MAPPING_FILE if os.path.isdir(path) else path
        if mapping.suffix == ".toml" and os.path.isfile(mapping):
            if not mappings:
                raise InputRefused(f"{mapping}: more than {MAX_MAPPINGS} mappings name one another; expected an .fmu")
            del table["fmu"]
            named = complete_drive(read_source(mapping).values, Path(os.path.realpath(mapping)).parent, mappings - 1)
            table = merge_tables(named, _distribute_parameters(table, named.get("parts")))
        else:
            table["fmu"] = str(_fmu_file(path, folder))
    _locate_parameter_files(table, folder)
    parts = table.get("parts")
    if isinstance(parts, dict):
        table = _distribute_parameters(table, parts)
        for part in table["parts"].values():
            _locate_parameter_files(part, folder)
            if isinstance(part, dict) and isinstance(part.get("fmu"), str):
                part["fmu"] = str(_fmu_file(locate_file(part["fmu"], folder), folder))
    return table


def _locate_parameter_files(table: Any, folder: Path) -> None:
    """Make file paths among the parameters of a drive table absolute, in place."""
    given = table.get("parameters") if isinstance(table, dict) else None
    if not isinstance(given, dict):
        return
    for name, value in given.items():
        many = isinstance(value, (list, tuple))
        given[name] = [_file_parameter(text, folder) for text in value] if many else _file_parameter(value, folder)


def _file_parameter(value: Any, folder: Path) -> Any:
    if not (isinstance(value, str) and value.startswith(FILE_PREFIX)):
        return value
    return FILE_PREFIX + str(locate_file(value.removeprefix(FILE_PREFIX), folder))


def _distribute_parameters(table: dict[str, Any], parts: Any) -> dict[str, Any]:
    """Move the parameters "part.name" of a drive into the tables of its parts."""
    given, own = table.get("parameters"), table.get("parts", {})
    # values that are not tables are refused later, with all other errors
    if not (isinstance(parts, dict) and isinstance(given, dict) and _are_tables(own)):
        return table
    moved: dict[str, Any] = {}
    for name, value in given.items():
        part, _, inner = name.partition(".")
        if part not in parts or not inner:
            known = [f"{part}.{name.rpartition('.')[2]}" for part in parts]
            raise InputRefused(f"[drive.parameters] {name}: this drive is made of parts; write {' or '.join(known)}")
        if inner in own.get(part, {}).get("parameters", {}):
            raise InputRefused(f"[drive.parameters] {name} and [drive.parts.{part}.parameters] {inner}: keep one")
        moved.setdefault(part, {"parameters": {}})["parameters"][inner] = value
    rest = {key: value for key, value in table.items() if key != "parameters"}
    return merge_tables(rest, {"parts": moved}) if moved else rest


def _are_tables(parts: Any) -> bool:
    tables = [parts, *parts.values()] if isinstance(parts, dict) else [parts]
    return all(isinstance(table, dict) and isinstance(table.get("parameters", {}), dict) for table in tables)


def _fmu_file(path: Path, folder: Path) -> Path:
    """Return the .fmu file of a drive: the path itself, or `<folder>/<folder>.fmu` for a drive's folder."""
    if os.path.isdir(path):
        inside = path / f"{path.name}.fmu"
        if os.path.isfile(inside):
            return inside
        raise InputRefused(f"{path}: a folder without {inside.name} or {MAPPING_FILE}; name the .fmu file itself")
    if not os.path.isfile(path) and path.suffix in (".fmu", ".ssp"):
        raise InputRefused(f"{path}: no such {path.suffix[1:].upper()}{suggestion(path)}")
    if not os.path.isfile(path):
        shelf = locate_file("fmus", folder)
        beside = suggestion(path).removeprefix("; ")
        hint = nearest(path.stem, drive_names(shelf), beside or "expected an .fmu file or a folder of fmus/")
        # a bare name became a path here, but its user looks for the name
        shown = path.name if path.parent == Path.cwd() else path
        raise InputRefused(f"{shown}: no such drive; {hint}")
    return path
