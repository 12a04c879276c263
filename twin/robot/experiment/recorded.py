"""The experiment stored in a recording.

A new experiment file and its schema, written.

What differs between experiments: their values key by key, as people write them.

The command line of a run, and of one that repeats a stored run.
"""

import json
import os
import re
import shlex
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError

from twin.kernel.errors import InputRefused, nearest
from twin.kernel.files import json_of
from twin.kernel.settings import Settings
from twin.kernel.writing import made_folder, write_text
from twin.robot.experiment import schema
from twin.robot.experiment.drive_files import known_experiments
from twin.robot.experiment.experiment import ARRAYS, Head
from twin.robot.experiment.fault import CATALOGUE, FaultTable
from twin.robot.experiment.json_schema import ROBOT, SCHEMA_FILE, commented_experiment, schema_text
from twin.robot.experiment.mistakes import sentences, type_mistakes
from twin.robot.experiment.schema import Declared, nested
from twin.robot.experiment.source import COMMAND_LINE, Source, read_source, toml_value
from twin.robot.places import HOME

Metadata = Mapping[str, Mapping[str, str]]
NAME = re.compile(r"(?!\.{1,2}$)[^/\\\x00-\x1f\x7f]{1,150}")
"""Of an experiment: that of a file, without the suffix."""
MANY = 3
"""The most mistakes of a recording that are listed: a recording is not mended."""


class RecordedFmu(BaseModel):
    """An FMU as `twin.robot.run.run` tells of it."""

    file: str
    sha256: str
    model: str
    fmi: str
    generation_tool: str | None
    set: dict[str, Any]
    mapped: list[str]
    # older recordings do not say, and only model exchange has a solver of ours
    kind: str = "co_simulation"
    solver: str | None = None
    solver_step: float | None = None
    tolerance: float | None = None
    stop_time: float | None = None


def recorded_name(metadata: Metadata, where: Path) -> str:
    """Name of the experiment that a recording was made of; "unknown experiment" if it does not say.

    Raises:
        InputRefused: what it says is no name: folders of results are called so, and a recording may come from anybody.
    """
    name = metadata.get("experiment", {}).get("name", "unknown experiment")
    if not NAME.fullmatch(name):
        raise InputRefused(f"{where}: calls its experiment {name!r}, which is not a valid name")
    return name


def recorded_values(declared: Declared, metadata: Metadata, where: Path) -> dict[str, Any]:
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
        mistakes = _wrong_types(declared, values)
    if mistakes:
        raise InputRefused(f"{where}: its experiment is not valid: {'; '.join(mistakes)}")
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
            problems = "; ".join(sentences(error, RecordedFmu, name)[:MANY])
            raise InputRefused(f"{where}: its FMU of {name}: {problems}") from None
    return fmus


def _wrong_types(declared: Declared, values: dict[str, Any]) -> list[str]:
    source = Source()
    mistakes: list[str] = []
    models: dict[str, type[Settings]] = {"head": Head, **declared.tables}
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


def start_experiment(declared: Declared, file: Path, start: str) -> list[Path]:
    """Write an experiment to `file` that does what the experiment `start` of those that come with twin does.

    Returns:
        The files that were written: `file`, and beside it the JSON Schema if none was there.

    Raises:
        InputRefused: `file` exists, or there is no experiment `start`.
        NotWritten: the disk refuses.
    """
    known = known_experiments()
    if start not in known:
        raise InputRefused(f"--from {start}: no such experiment; {nearest(start, known_experiments())}")
    if file.suffix != ".toml":
        raise InputRefused(f"{file}: expected a name that ends with .toml")
    schema = file.parent / SCHEMA_FILE
    text = commented_experiment(declared, file.name, known[start])
    made_folder(file.parent)
    if os.path.lexists(file):
        raise InputRefused(f"{file}: exists, and is never overwritten; choose another name")
    write_text(file, text)
    if os.path.lexists(schema):
        return [file]
    write_text(schema, schema_text(declared))
    return [file, schema]


FROM_ROBOT = ("plant", "controller.model")
"""Tables that hold the robot's own values wherever they do not say otherwise."""
SHORT = 12
"""Characters of a hash by which files are distinguished."""

Facts = Mapping[str, str]
"""Everything by which experiments may differ, as text, by dotted key."""


def flat(values: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """(dotted key, value) of nested tables; items of arrays of tables by their number from 1."""
    for key, value in values.items():
        if isinstance(value, Mapping):
            yield from flat(value, f"{prefix}{key}.")
        elif isinstance(value, list) and value and all(isinstance(item, Mapping) for item in value):
            for number, item in enumerate(value, start=1):
                yield from flat(item, f"{prefix}{key}.{number}.")
        else:
            yield f"{prefix}{key}", value


@cache
def _names(declared: Declared) -> dict[str, str]:
    """Key of an experiment file -> its name without the unit, of every key that has one."""
    tables: dict[str, type[Settings]] = {
        **declared.tables,
        "drive": schema.Drive,
        "fault": FaultTable,
        **declared.tasks,
    }
    models = [model for name, table in tables.items() for model in nested(table, name).values()]
    fields = {field.alias: name for model in models for name, field in model.model_fields.items() if field.alias}
    magnitudes = {kind.magnitude_key: "magnitude" for kind in CATALOGUE.values() if kind.magnitude_key}
    return fields | magnitudes


def name_and_unit(declared: Declared, key: str) -> tuple[str, str]:
    """`controller.force.kp_mm_per_N` as `controller.force.kp`, `mm/N`; a drive's parameters keep names of their own."""
    tables, dot, last = key.rpartition(".")
    name = _names(declared).get(last, last) if ".parameters" not in tables else last
    words = last.removeprefix(f"{name}_").split("_") if name != last else []
    above, below = words, []
    if "per" in words:
        above, below = words[: words.index("per")], words[words.index("per") + 1 :]
    unit = " ".join(above) or "1" * bool(below)
    unit += f"/{' '.join(below)}" if len(below) == 1 else f"/({' '.join(below)})" if below else ""
    return f"{tables}{dot}{name}", unit.replace("Nm", "N m").replace("m2", "m²").replace("s2", "s²")


def toml_text(value: Any) -> str:
    """A value of a TOML file as people write it."""
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:.12g}" if isinstance(value, float) else str(value)


def recorded_facts(declared: Declared, metadata: Metadata, where: Path) -> dict[str, str]:
    """Of the experiment that a recording was made of: its values, and the SHA-256 of every FMU's file.

    Raises:
        InputRefused: as `recorded_values` and `recorded_fmus`.
    """
    fmus = recorded_fmus(metadata, where)
    return experiment_facts(
        recorded_values(declared, metadata, where), {fmu["file"]: fmu["sha256"] for fmu in fmus.values()}
    )


def experiment_facts(values: Mapping[str, Any], hashes: Mapping[str, str]) -> dict[str, str]:
    """The same of checked values and of hashes by file name."""
    stated = {key: toml_text(value) for key, value in flat(values) if key != "title"}
    return stated | {f"sha256 of {file}": sha256[:SHORT] for file, sha256 in hashes.items()}


def differing(facts: Sequence[Facts]) -> dict[str, tuple[str, ...]]:
    """What is not the same in all of `facts`: its value in each, "-" where there is none, by key.

    What follows from the robot's own values is listed once, and no hash of a file that only one has.
    """
    found = {}
    for key in dict.fromkeys(key for one in facts for key in one):
        values = tuple(one.get(key, "-") for one in facts)
        of_another_file = key.startswith("sha256 of ") and "-" in values
        if len(set(values)) > 1 and not of_another_file and not _follows(key, facts):
            found[key] = values
    return found


def _follows(key: str, facts: Sequence[Facts]) -> bool:
    """Whether a value differs only because the robot's own does, which is listed once."""
    for filled in FROM_ROBOT:
        own = f"robot{key.removeprefix(filled)}"
        if key.startswith(f"{filled}.") and all(one.get(own) == one.get(key) for one in facts):
            return True
    return False


def robot_values(values: Mapping[str, Any], origins: Mapping[str, str]) -> dict[str, int]:
    """Count the robot's own values, and the inherited ones that are assumptions.

    A value is inherited if it is the one of the robot that comes with twin, its origin included, whether the experiment
    extends that file or `twin init` wrote it out. All others are own.

    Args:
        values: of the experiment, keys with units.
        origins: by dotted key; an assumption begins with "assumed".
    """
    shipped = read_source(HOME / "experiments" / ROBOT)
    found = {key: value for key, value in values.get("robot", {}).items() if key != "name"}
    inherited = [
        origins[f"robot.{key}"]
        for key, value in found.items()
        if json.dumps(value) == json.dumps(shipped.values["robot"].get(key))
        and f"robot.{key}" in origins
        and origins[f"robot.{key}"] == shipped.origins.get(f"robot.{key}")
    ]
    assumed = sum(origin.startswith("assumed") for origin in inherited)
    return {"own": len(found) - len(inherited), "assumed": assumed}


def robot_values_text(counts: Mapping[str, int]) -> str:
    """Return the counts of `robot_values` as text."""
    own = f"{counts['own']} own value{'s' * (counts['own'] != 1)}"
    return f"{own}, {counts['assumed']} inherited assumptions; twin accuracy ranks them"


WHOLE = {"drive.fmu": "--drive", "contact.body": "--body"}
"""Keys with an option of their own."""


def options(values: Mapping[str, Any], origins: Mapping[str, str]) -> list[str]:
    """The words that have set what was set on the command line: `--drive`, `pmsm_foc.fmu`, `--set`, `seed=3`.

    Args:
        values: of the experiment, as they are recorded.
        origins: by dotted key.
    """
    words: list[str] = []
    stated, whole = dict(flat(values)), set()
    for key, option in WHOLE.items():
        if origins.get(key) == COMMAND_LINE and key in stated:
            words += [option, str(stated[key])]
            whole.add(key)
    for key, value in stated.items():
        if origins.get(key) == COMMAND_LINE and key not in whole and not key.startswith("fault."):
            words += ["--set", f"{key}={_toml(value)}"]
    if any(origin == COMMAND_LINE for key, origin in origins.items() if key.startswith("fault.")):
        words += ["--set", f"fault={_toml(values.get('fault', ()))}"]
    return words


def run_words(
    experiment: str | Path, settings: Iterable[str] = (), drive: str | None = None, body: str | None = None
) -> tuple[str, ...]:
    """Return the words behind `twin run` that run `experiment`; arguments as of `load_experiment`."""
    given = [("--drive", drive), ("--body", body), *(("--set", text) for text in settings)]
    return (str(experiment), *(word for option, value in given if value is not None for word in (option, value)))


def repeating_words(summary: Mapping[str, Any], name: str, words: Sequence[str]) -> list[str]:
    """Return the words behind `twin run` that repeat a stored run.

    A recording names files without their folders, so only the summary beside it has paths as they were typed.

    Args:
        summary: read beside the recording; it may come from anybody.
        name: of the experiment, and `words`: its `options`, as recorded; used where the summary has no such words.
    """
    typed = summary.get("typed")
    if not isinstance(typed, list) or not typed or not all(isinstance(word, str) for word in typed):
        return [name, *words]
    # a summary that was forged adds no other option to a command that is copied into a shell
    plain = not typed[0].startswith("-") and {"--drive", "--body", "--set"}.issuperset(typed[1::2])
    return typed if plain and len(typed) % 2 else [name, *words]


def run_command(words: Iterable[str]) -> str:
    """Return the command `twin run` with `words`, for a shell."""
    return shlex.join(["twin", "run", *words])


def _toml(value: object) -> str:
    """A value as --set takes it."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key} = {_toml(item)}" for key, item in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_toml(item) for item in value) + "]"
    return toml_value(value)
