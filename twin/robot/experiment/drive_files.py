"""The files that an experiment names: experiments, bodies, drives, third-party parts.

Experiments that come with twin, and the file that is meant by a name or a path.

From [contact] body = "back" to a complete [contact]: the body's file fills in what the experiment does not say.

From [drive] to one complete table per joint: drive folders bring their own mapping, joints their differences.

A third-party part of the robot: an FMU or a Python class where twin has a component of its own.
"""

import copy
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from pydantic import Field, ValidationError, model_validator

from twin.kernel.errors import InputRefused, nearest
from twin.kernel.files import meant
from twin.kernel.settings import Settings
from twin.robot.experiment import schema
from twin.robot.experiment.mistakes import checked, keys, sentences
from twin.robot.experiment.schema import TOLERANCE, Declared, Parameter
from twin.robot.experiment.source import NAMING, RETAINED, Source, laid_over, names_stand_in, read_source, rules_for
from twin.robot.places import HOME, located

SWEEPS = "experiments/sweeps"


def known_experiments() -> dict[str, Path]:
    """The files of the experiments that come with twin, by name."""
    return {path.stem: path for path in sorted(HOME.glob("experiments/*.toml"))}


def experiment_file(experiment: str | Path) -> Path:
    """The file of an experiment.

    Args:
        experiment: a path as seen from the current folder, or from the repository if it is not there; or a name:
            NAME.toml here, in experiments/ here or above, or of those that come with twin.

    Raises:
        InputRefused: nothing has that name. Else a path that leads nowhere is returned, to be refused when it is read.
    """
    path = Path(experiment)
    found = _experiment_file(path, "experiments")
    if found:
        return found
    if os.path.isdir(path):
        return path
    raise InputRefused(f"{path}: no such experiment; {nearest(path.name, known_experiments())}")


def sweep_file(sweep: Path) -> Path:
    """The file of a sweep: a path or a name, looked up as `experiment_file` does, names in experiments/sweeps/.

    Raises:
        InputRefused: nothing has that name. Else a path that leads nowhere is returned, to be refused when it is read.
    """
    found = _experiment_file(sweep, SWEEPS)
    if found:
        return found
    known = [path.stem for path in sorted(HOME.glob(f"{SWEEPS}/*.toml"))]
    raise InputRefused(f"{sweep}: no such sweep file; {nearest(sweep.name, known)}")


def _experiment_file(path: Path, shelf: str) -> Path | None:
    """The file meant by `path`; of a name that of `shelf`, None if there is none."""
    # not Path.is_file, which raises where a name is too long
    if os.path.isfile(path):
        return path
    if path.suffix == ".toml" or len(path.parts) > 1:
        return HOME / path if os.path.isfile(HOME / path) else path
    candidates = (Path(f"{path}.toml"), located(f"{shelf}/{path}.toml", Path.cwd()))
    return next((candidate for candidate in candidates if os.path.isfile(candidate)), None)


FOLDERS = ("bodies", "experiments/bodies")


def fill_from_body(source: Source, folder: Path) -> None:
    """Complete the [contact] of `source` from the body file that it names, values and origins, in place.

    What [contact] says itself stays. Without `body` nothing is done.

    Args:
        folder: the experiment's, from which bodies are looked up like `extends` and fmus/.

    Raises:
        InputRefused: no such body, or its file is not a [contact] table.
    """
    contact = source.values.get("contact")
    if not isinstance(contact, dict) or "body" not in contact:
        return
    path = _body_file(contact["body"], folder)
    body = read_source(path)
    filling = body.values.get("contact")
    if body.values.keys() != {"contact"} or not isinstance(filling, dict) or "body" in filling:
        raise InputRefused(f"{path}: expected one table [contact], without 'body'")
    source.values["contact"] = laid_over(filling, contact)
    source.origins = {**body.origins, **source.origins}


def _body_file(name: Any, folder: Path) -> Path:
    if not isinstance(name, str):
        raise InputRefused(f"[contact] body = {name!r}: expected the name of a body in quotes")
    if name.endswith(".toml"):
        return located(name, folder)
    shelves = [located(shelf, folder) for shelf in FOLDERS]
    known = sorted({path.stem for shelf in shelves for path in shelf.glob("*.toml")})
    for shelf in shelves:
        # not Path.is_file, which raises for a name that is too long
        if os.path.isfile(shelf / f"{name}.toml"):
            return shelf / f"{name}.toml"
    raise InputRefused(f'[contact] body = "{name}": no such body; {nearest(name, known)}')


MAPPING = "mapping.toml"
JOINTS = ("joint_1", "joint_2", "joint_3")
FILE = "file:"
"""Before the name of a file that is a parameter of a drive, as seen from the file that says it."""
MOST_MAPPINGS = 8
"""Mappings that name another mapping as their drive."""


def joint_tables(drive: dict[str, Any], folder: Path) -> list[dict[str, Any]]:
    """The three joints' tables, FMUs as absolute paths.

    Args:
        drive: the experiment's [drive] with its joint tables.
        folder: the experiment's, where names are looked up.

    A drive named by its folder takes what stands in the folder's mapping.toml wherever [drive] does not say otherwise.

    Raises:
        InputRefused: no such drive, or a mapping that is not TOML.
    """
    common = {key: value for key, value in drive.items() if key not in JOINTS}
    tables = []
    for joint in JOINTS:
        own = drive.get(joint, {})
        if not isinstance(own, dict):
            raise InputRefused(f"[drive.{joint}] = {own!r}: expected a table")
        tables.append(completed(own if rules_for("drive", own) else laid_over(common, own), folder))
    return tables


def lone_drive(fmu: str, folder: Path) -> schema.Drive:
    """The drive that a user names on the command line: an .fmu, a mapping, a folder, or a name in fmus/.

    Args:
        fmu: as seen from the current folder; or a name in fmus/ as seen from `folder` upwards.

    Raises:
        InputRefused: no such drive, or its mapping has mistakes.
    """
    table = joint_tables({"fmu": shelved(fmu, folder)}, folder)[0]
    try:
        return schema.Drive.model_validate(table)
    except ValidationError as error:
        raise InputRefused(f"{fmu}: " + "; ".join(sentences(error, schema.Drive, "drive"))) from None


def drives_in(shelf: Path) -> list[str]:
    """The names of the folders in `shelf` that hold a drive, sorted."""
    return sorted(f.name for f in shelf.glob("*") if (f / MAPPING).is_file() or any(f.glob("*.fmu")))


def shelved(fmu: str, folder: Path) -> str:
    """`fmu` as an absolute path: as seen from the current folder, else in fmus/ as seen from `folder` upwards."""
    path = Path(fmu)
    # not Path.exists, which raises for a name that is too long
    if not os.path.exists(path):
        on_shelf = located(f"fmus/{fmu}", folder)
        path = on_shelf if os.path.exists(on_shelf) else path
    return str(path.absolute())


def completed(table: dict[str, Any], folder: Path, mappings: int = MOST_MAPPINGS) -> dict[str, Any]:
    """`table` of a drive, or of another part, with its mapping file, which may name another, and absolute paths."""
    table = copy.deepcopy(table)
    if isinstance(table.get("fmu"), str):
        path = located(table["fmu"], folder)
        mapping = path / MAPPING if os.path.isdir(path) else path
        if mapping.suffix == ".toml" and os.path.isfile(mapping):
            if not mappings:
                raise InputRefused(f"{mapping}: more than {MOST_MAPPINGS} mappings name one another; expected an .fmu")
            del table["fmu"]
            named = completed(read_source(mapping).values, Path(os.path.realpath(mapping)).parent, mappings - 1)
            table = laid_over(named, _by_part(table, named.get("parts")))
        else:
            table["fmu"] = str(_archive(path, folder))
    _find_files(table, folder)
    parts = table.get("parts")
    if isinstance(parts, dict):
        table = _by_part(table, parts)
        for part in table["parts"].values():
            _find_files(part, folder)
            if isinstance(part, dict) and isinstance(part.get("fmu"), str):
                part["fmu"] = str(_archive(located(part["fmu"], folder), folder))
    return table


def _find_files(table: Any, folder: Path) -> None:
    """Make the paths of files among the parameters of `table` absolute."""
    given = table.get("parameters") if isinstance(table, dict) else None
    if not isinstance(given, dict):
        return
    for name, value in given.items():
        many = isinstance(value, (list, tuple))
        given[name] = [_found(text, folder) for text in value] if many else _found(value, folder)


def _found(value: Any, folder: Path) -> Any:
    if not (isinstance(value, str) and value.startswith(FILE)):
        return value
    return FILE + str(located(value.removeprefix(FILE), folder))


def _by_part(table: dict[str, Any], parts: Any) -> dict[str, Any]:
    """`table` with the parameters "part.name" of a drive made of `parts` where those of the part stand.

    Raises:
        InputRefused: one is of no part, or is given in both places.
    """
    given, own = table.get("parameters"), table.get("parts", {})
    # what is no table is refused with all other mistakes
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
    return laid_over(rest, {"parts": moved}) if moved else rest


def _are_tables(parts: Any) -> bool:
    tables = [parts, *parts.values()] if isinstance(parts, dict) else [parts]
    return all(isinstance(table, dict) and isinstance(table.get("parameters", {}), dict) for table in tables)


def _archive(path: Path, folder: Path) -> Path:
    """The .fmu file meant by `path`: itself, or `<folder>/<folder>.fmu` for a drive's folder."""
    if os.path.isdir(path):
        inside = path / f"{path.name}.fmu"
        if os.path.isfile(inside):
            return inside
        raise InputRefused(f"{path}: a folder without {inside.name} or {MAPPING}; name the .fmu file itself")
    if not os.path.isfile(path) and path.suffix in (".fmu", ".ssp"):
        raise InputRefused(f"{path}: no such {path.suffix[1:].upper()}{meant(path)}")
    if not os.path.isfile(path):
        shelf = located("fmus", folder)
        beside = meant(path).removeprefix("; ")
        hint = nearest(path.stem, drives_in(shelf), beside or "expected an .fmu file or a folder of fmus/")
        # a name without folders became a path here; its user looks for the name
        shown = path.name if path.parent == Path.cwd() else path
        raise InputRefused(f"{shown}: no such drive; {hint}")
    return path


Names = dict[str, str | tuple[str, ...]]


class StandIn(Settings):
    """[controller], [estimator], [monitor], [scale], [body]: a third-party part.

    Either `fmu`, with names and units of the FMU's own, or `python`, whose class names its ports itself.
    """

    fmu: str | None = Field(
        None, examples=["fmus/parts/paper_law"], description="an .fmu or .ssp file, or a folder of fmus/parts/"
    )
    python: str | None = Field(None, examples=["my_controller.py:Controller"], description="a file and a class in it")
    sha256: str | None = Field(None, examples=["00000000..."], description="refuse any other file")
    inputs: Names = Field(default_factory=dict, description="our name = the FMU's, or one for each value")
    outputs: Names = Field(default_factory=dict, description="our name = the FMU's, or one for each value")
    parameters: dict[str, Parameter] = Field(default_factory=dict, description="the FMU's or the class's own names")
    tolerance: float | None = Field(None, gt=0, examples=[1e-9], description=TOLERANCE)

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
        """The FMU, or the file of the class."""
        return Path(self.fmu if self.fmu is not None else (self.python or "").rpartition(":")[0])

    @property
    def class_name(self) -> str:
        """Of a Python class; "" for an FMU."""
        return (self.python or "").rpartition(":")[2]

    @property
    def label(self) -> str:
        """The file, without its folder, and the class."""
        return f"{self.file.name}:{self.class_name}" if self.python else self.file.name


class Apart(NamedTuple):
    """A table of a third-party part: what is said of that, and what of the table still acts."""

    stand_in: StandIn | None
    rest: Settings | None


def checked_apart(declared: Declared, role: str, table: Mapping[str, Any], folder: Path, mistakes: list[str]) -> Apart:
    """The table [role], which names an FMU or a class.

    Args:
        declared: what may be said in it where twin's own component has the role.
        folder: from which files are looked up.
        mistakes: gets a sentence for each mistake.
    """
    own_keys, model = keys(StandIn), declared.tables[role]
    own = {key: value for key, value in table.items() if key in own_keys}
    rest = {key: value for key, value in table.items() if key not in own_keys}
    idle = [key for key in rest if key in keys(model) and key not in RETAINED[role]]
    if idle:
        mistakes.append(
            f"[{role}] {', '.join(idle)}: of twin's own {role}, and {_named(own)} is another one; remove "
            + ("it" if len(idle) == 1 else "them")
        )
    try:
        own = _with_file(role, own, folder)
    except InputRefused as problem:
        mistakes.append(f"[{role}] {problem}")
        return Apart(None, None)
    passed = {key: value for key, value in rest.items() if key not in idle}
    if model is StandIn:
        return Apart(checked(StandIn, {**own, **passed}, role, mistakes), None)
    return Apart(checked(StandIn, own, role, mistakes), checked(declared.rest(role), passed, role, mistakes))


def rest_of(declared: Declared, role: str, table: Mapping[str, Any]) -> Settings:
    """What of the checked table [role] of a third-party part still acts."""
    return declared.rest(role).model_validate({key: value for key, value in table.items() if key in RETAINED[role]})


def _named(own: Mapping[str, Any]) -> str:
    return " and ".join(f'{key} = "{own[key]}"' for key in NAMING if key in own)


def _with_file(role: str, own: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """`own` with its file as an absolute path, completed from a mapping if it names one.

    Raises:
        InputRefused: there is no such file.
    """
    table = dict(own)
    if isinstance(python := table.get("python"), str) and ":" in python:
        file, _, name = python.rpartition(":")
        path = located(file, folder)
        if not os.path.isfile(path):
            raise InputRefused(f'python = "{python}": no file {path}; expected "FILE:CLASS"')
        table["python"] = f"{path.absolute()}:{name}"
    if isinstance(table.get("fmu"), str):
        table = completed(table, folder)
        if "parts" in table:
            raise InputRefused(f'fmu = "{own["fmu"]}": a drive made of parts; a {role} is one FMU')
    return table


def role_named(values: Mapping[str, Any], role: str) -> Mapping[str, Any] | None:
    """The table [role] of an experiment's values, if it names an FMU or a class."""
    table = values.get(role)
    return table if isinstance(table, Mapping) and names_stand_in(table) else None
