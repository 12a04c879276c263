"""Third-party parts of the robot: tables that name an FMU or a Python class in place of twin's component."""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from pydantic import Field, model_validator

from twin.kernel.errors import InputRefused
from twin.kernel.settings import Settings
from twin.robot.experiment.drive_files import complete_drive
from twin.robot.experiment.mistakes import check_table, toml_keys
from twin.robot.experiment.schema import DeclaredTables, Parameter
from twin.robot.experiment.source import FILE_KEYS, RETAINED_KEYS, names_stand_in
from twin.robot.paths import locate_file

Names = dict[str, str | tuple[str, ...]]


class StandIn(Settings):
    """[controller], [estimator], [monitor], [scale], [body]: a third-party part.

    Either `fmu`, with names and units of the FMU's own, or `python`, whose class names its ports itself.
    """

    fmu: str | None = Field(
        None, examples=["fmus/parts/paper_law"], description=".fmu or .ssp file, mapping, or folder with a mapping"
    )
    python: str | None = Field(
        None, examples=["my_controller.py:Controller"], description="class in a Python file, FILE:CLASS; instead of fmu"
    )
    sha256: str | None = Field(
        None, examples=["00000000..."], description="hash of the file; any other file is refused"
    )
    inputs: Names = Field(default_factory=dict, description="port = name in the FMU, or an array with a name per value")
    outputs: Names = Field(
        default_factory=dict, description="port = name in the FMU, or an array with a name per value"
    )
    parameters: dict[str, Parameter] = Field(
        default_factory=dict, description="names and units of the FMU, or arguments of the class"
    )
    tolerance: float | None = Field(
        None, gt=0, examples=[1e-9], description="relative tolerance of the FMU's solver; without it, its default"
    )

    @model_validator(mode="after")
    def _consistent(self) -> "StandIn":
        if (self.fmu is None) == (self.python is None):
            raise ValueError('expected either fmu = "..." or python = "FILE:CLASS"')
        if self.python is not None:
            if not all(self.python.rpartition(":")[::2]):
                raise ValueError(f'python = "{self.python}": expected "FILE:CLASS", a file and a class in it')
            given = [key for key in ("inputs", "outputs", "tolerance") if getattr(self, key)]
            if given:
                raise ValueError(f"python: {' and '.join(given)} are an FMU's; the class names its ports itself")
        return self

    @property
    def file(self) -> Path:
        """Path of the FMU, or of the Python file with the class."""
        return Path(self.fmu if self.fmu is not None else (self.python or "").rpartition(":")[0])

    @property
    def class_name(self) -> str:
        """Name of a third-party part's Python class; "" for an FMU."""
        return (self.python or "").rpartition(":")[2]

    @property
    def label(self) -> str:
        """Name of a third-party part for messages: its file name without folder, followed by the class."""
        return f"{self.file.name}:{self.class_name}" if self.python else self.file.name


class ThirdPartyTable(NamedTuple):
    """Table of a third-party part, split into the part's own keys and the keys that twin still uses."""

    stand_in: StandIn | None
    rest: Settings | None


def check_third_party_table(
    declared: DeclaredTables, role: str, table: Mapping[str, Any], folder: Path, mistakes: list[str]
) -> ThirdPartyTable:
    """Check the table of a third-party part, and split it into its own keys and those that twin still uses.

    Files are looked up in `folder`.
    """
    own_keys, model = toml_keys(StandIn), declared.tables[role]
    own = {key: value for key, value in table.items() if key in own_keys}
    rest = {key: value for key, value in table.items() if key not in own_keys}
    idle = [key for key in rest if key in toml_keys(model) and key not in RETAINED_KEYS[role]]
    if idle:
        named = " and ".join(f'{key} = "{own[key]}"' for key in FILE_KEYS if key in own)
        mistakes.append(
            f"[{role}] {', '.join(idle)}: of twin's own {role}, and {named} is another one; remove "
            + ("it" if len(idle) == 1 else "them")
        )
    try:
        own = _with_file(role, own, folder)
    except InputRefused as problem:
        mistakes.append(f"[{role}] {problem}")
        return ThirdPartyTable(None, None)
    passed = {key: value for key, value in rest.items() if key not in idle}
    if model is StandIn:
        return ThirdPartyTable(check_table(StandIn, {**own, **passed}, role, mistakes), None)
    return ThirdPartyTable(
        check_table(StandIn, own, role, mistakes), check_table(declared.third_party_model(role), passed, role, mistakes)
    )


def retained_settings(declared: DeclaredTables, role: str, table: Mapping[str, Any]) -> Settings:
    """Return the settings that twin still uses from the checked table of a third-party part."""
    return declared.third_party_model(role).model_validate(
        {key: value for key, value in table.items() if key in RETAINED_KEYS[role]}
    )


def _with_file(role: str, own: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """Return a third-party part's table with an absolute path, completed from the mapping file that it names."""
    table = dict(own)
    if isinstance(python := table.get("python"), str) and ":" in python:
        file, _, name = python.rpartition(":")
        path = locate_file(file, folder)
        if not os.path.isfile(path):
            raise InputRefused(f'python = "{python}": no file {path}; expected "FILE:CLASS"')
        table["python"] = f"{path.absolute()}:{name}"
    if isinstance(table.get("fmu"), str):
        table = complete_drive(table, folder)
        if "parts" in table:
            raise InputRefused(f'fmu = "{own["fmu"]}": a drive made of parts; a {role} is one FMU')
    return table


def find_stand_in_table(values: Mapping[str, Any], role: str) -> Mapping[str, Any] | None:
    """Return the table of a robot part in an experiment's values if it names a third-party file, else None."""
    table = values.get(role)
    return table if isinstance(table, Mapping) and names_stand_in(table) else None
