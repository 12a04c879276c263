"""The experiment that a recording carries with it, ready to run again."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from twin.errors import InputRefused
from twin.experiment.experiment import Experiment
from twin.experiment.recorded import Metadata, recorded_fmus, recorded_name, recorded_values
from twin.experiment.schema import Drive
from twin.experiment.source import KEPT, Source
from twin.files import json_of
from twin.places import located
from twin.runs.assembly.declared import DECLARED
from twin.runs.assembly.load import checked_experiment


def recorded_experiment(metadata: Metadata, where: Path) -> Experiment:
    """The experiment of a recording with the very FMUs that it was made with.

    A recording names its FMUs by file name and SHA-256, not by where they lay: they are looked up as those of an
    experiment file beside it, and in fmus/. Every drive pins its recorded SHA-256, so that no other file is taken.

    Raises:
        InputRefused: it carries no experiment, was made with substitutes or changed by hand while it ran, or an FMU is
            not found.
    """
    name, values = recorded_name(metadata, where), recorded_values(DECLARED, metadata, where)
    if "drive" not in values:
        raise InputRefused(f"{where}: carries no experiment that could be run again")
    fmus = {drive: facts["sha256"] for drive, facts in recorded_fmus(metadata, where).items()}
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
    _find_parts(values, metadata, fmus, where, folder)
    source = Source()
    source.put(values | {"drive": _with_paths(values["drive"], where, folder)}, "recorded")
    experiment = checked_experiment(source, name, where, folder)
    one, two, three = experiment.drives
    pinned = (_pinned(one, "drive_1", fmus), _pinned(two, "drive_2", fmus), _pinned(three, "drive_3", fmus))
    return replace(experiment, drives=pinned)


def _find_parts(values: dict[str, Any], metadata: Metadata, fmus: Mapping[str, str], where: Path, folder: Path) -> None:
    """Let parts of another make name the very files that the recording was made with."""
    for role in KEPT:
        table = values.get(role)
        if not isinstance(table, dict):
            continue
        if isinstance(table.get("fmu"), str) and role in fmus:
            values[role] = table | {"fmu": _path(table["fmu"], where, folder, role), "sha256": fmus[role]}
        if isinstance(table.get("python"), str):
            facts = json_of(metadata.get("python", {}).get(role, "{}"), f"{where}: its {role}")
            file, _, kind = table["python"].rpartition(":")
            # a recording may come from anybody: it names a file, and no way to one
            path = located(Path(file).name, folder)
            known = isinstance(facts, dict) and isinstance(facts.get("sha256"), str)
            if not path.is_file() or not known:
                raise InputRefused(
                    f"{where}: its {role} {Path(file).name} is not beside it; put it there to run it again"
                )
            values[role] = table | {"python": f"{path}:{kind}", "sha256": facts["sha256"]}


def _with_paths(table: dict[str, Any], where: Path, folder: Path) -> dict[str, Any]:
    """[drive] with paths of FMUs where it has names."""
    tables = {key: _with_paths(value, where, folder) for key, value in table.items() if isinstance(value, dict)}
    fmu = {"fmu": _path(table["fmu"], where, folder)} if isinstance(table.get("fmu"), str) else {}
    return table | tables | fmu


def _path(name: str, where: Path, folder: Path, part: str = "drive") -> str:
    # a recording may come from anybody: it names a file, and no way to one
    name = Path(name).name
    # fmus/ first: a run may lie in a folder that is called like its drive
    for candidate in (f"fmus/{name}", f"fmus/{Path(name).stem}/{name}", f"fmus/parts/{name}", name):
        path = located(candidate, folder)
        if path.is_file() or (path.exists() and candidate != name):
            return str(path)
    raise InputRefused(f"{where}: its {part} {name} is neither in fmus/ nor beside it; put it there to run it again")


def _pinned(drive: Drive, name: str, fmus: Mapping[str, str]) -> Drive:
    parts = {
        part: table.model_copy(update={"sha256": fmus.get(f"{name}.{part}")}) for part, table in drive.parts.items()
    }
    return drive.model_copy(update={"sha256": fmus.get(name), "parts": parts})
