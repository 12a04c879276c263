"""Differences between experiments, key by key, in readable form."""

import json
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

from twin.kernel.settings import Settings
from twin.robot.experiment.fault import FAULT_KINDS, FaultTable
from twin.robot.experiment.recorded import Metadata, recorded_fmus, recorded_values
from twin.robot.experiment.schema import DeclaredTables, Drive, nested_tables
from twin.robot.experiment.source import read_source
from twin.robot.experiment.template import ROBOT_FILE
from twin.robot.paths import PROJECT_FOLDER

FROM_ROBOT = ("plant", "controller.model")
"""Tables whose missing values are taken from [robot]."""
HASH_LENGTH = 12
"""Number of displayed characters of a file's hash."""

ComparableValues = Mapping[str, str]
"""Text of every value that may differ between experiments, by dotted key."""


def flatten(values: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield (dotted key, value) of nested tables; items of arrays of tables are numbered from 1."""
    for key, value in values.items():
        if isinstance(value, Mapping):
            yield from flatten(value, f"{prefix}{key}.")
        elif isinstance(value, list) and value and all(isinstance(item, Mapping) for item in value):
            for number, item in enumerate(value, start=1):
                yield from flatten(item, f"{prefix}{key}.{number}.")
        else:
            yield f"{prefix}{key}", value


@cache
def _names_by_key(declared: DeclaredTables) -> dict[str, str]:
    """Return the name without unit of each key of an experiment file, such as kp for kp_mm_per_N."""
    tables: dict[str, type[Settings]] = {**declared.tables, "drive": Drive, "fault": FaultTable, **declared.tasks}
    models = [model for name, table in tables.items() for model in nested_tables(table, name).values()]
    fields = {field.alias: name for model in models for name, field in model.model_fields.items() if field.alias}
    magnitudes = {kind.magnitude_key: "magnitude" for kind in FAULT_KINDS.values() if kind.magnitude_key}
    return fields | magnitudes


def name_and_unit(declared: DeclaredTables, key: str) -> tuple[str, str]:
    """Split an experiment key into name and unit: `controller.force.kp_mm_per_N` gives `controller.force.kp`, `mm/N`.

    Names of drive parameters are not split.
    """
    tables, dot, last = key.rpartition(".")
    name = _names_by_key(declared).get(last, last) if ".parameters" not in tables else last
    words = last.removeprefix(f"{name}_").split("_") if name != last else []
    above, below = words, []
    if "per" in words:
        above, below = words[: words.index("per")], words[words.index("per") + 1 :]
    unit = " ".join(above) or "1" * bool(below)
    unit += f"/{' '.join(below)}" if len(below) == 1 else f"/({' '.join(below)})" if below else ""
    return f"{tables}{dot}{name}", unit.replace("Nm", "N m").replace("m2", "m²").replace("s2", "s²")


def toml_text(value: Any) -> str:
    """Format a value of a TOML file for display."""
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:.12g}" if isinstance(value, float) else str(value)


def recorded_comparable_values(declared: DeclaredTables, metadata: Metadata, where: Path) -> dict[str, str]:
    """Return a recorded experiment's values as text by key, for comparison, with the SHA-256 of every FMU."""
    fmus = recorded_fmus(metadata, where)
    return comparable_values(
        recorded_values(declared, metadata, where), {fmu["file"]: fmu["sha256"] for fmu in fmus.values()}
    )


def comparable_values(values: Mapping[str, Any], hashes: Mapping[str, str]) -> dict[str, str]:
    """Return an experiment's values except the title as text by key, with the SHA-256 of its files."""
    stated = {key: toml_text(value) for key, value in flatten(values) if key != "title"}
    return stated | {f"sha256 of {file}": sha256[:HASH_LENGTH] for file, sha256 in hashes.items()}


def differing_values(facts: Sequence[ComparableValues]) -> dict[str, tuple[str, ...]]:
    """Return the values that differ between experiments: key -> one text per experiment, "-" if missing.

    Values derived from [robot] are listed once; hashes of files that only one experiment has are left out.
    """
    found = {}
    for key in dict.fromkeys(key for one in facts for key in one):
        values = tuple(one.get(key, "-") for one in facts)
        of_another_file = key.startswith("sha256 of ") and "-" in values
        if len(set(values)) > 1 and not of_another_file and not _follows(key, facts):
            found[key] = values
    return found


def _follows(key: str, facts: Sequence[ComparableValues]) -> bool:
    """Whether a value differs only because the value of [robot] from which it was filled differs."""
    for filled in FROM_ROBOT:
        own = f"robot{key.removeprefix(filled)}"
        if key.startswith(f"{filled}.") and all(one.get(own) == one.get(key) for one in facts):
            return True
    return False


def robot_values(values: Mapping[str, Any], origins: Mapping[str, str]) -> dict[str, int]:
    """Count an experiment's own values of [robot], and the inherited ones that are assumptions.

    A value is inherited if value and origin match the robot shipped with twin, whether the experiment extends
    that file or `twin init` copied it. All others are own. The origin of an assumption begins with "assumed".
    """
    shipped = read_source(PROJECT_FOLDER / "experiments" / ROBOT_FILE)
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
    """Format the counts of [robot]'s values: `3 own values, 41 inherited assumptions; ...`."""
    own = f"{counts['own']} own value{'s' * (counts['own'] != 1)}"
    return f"{own}, {counts['assumed']} inherited assumptions; twin accuracy ranks them"
