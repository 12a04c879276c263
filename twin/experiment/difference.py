"""What differs between experiments: their values key by key, as people write them."""

from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

from twin.experiment import schema, task
from twin.experiment.declared import Declared, nested
from twin.experiment.fault import FaultTable
from twin.experiment.fault_catalogue import CATALOGUE
from twin.experiment.recorded import Metadata, recorded_fmus, recorded_values
from twin.settings import Settings

FROM_ROBOT = ("plant", "controller.model")
"""Tables that hold the robot's own values wherever they do not say otherwise."""
SHORT = 12
"""Characters of a hash by which files are told apart."""

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
    tables: dict[str, type[Settings]] = {**declared.tables, "drive": schema.Drive, "fault": FaultTable, **task.KINDS}
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


def told(value: Any) -> str:
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
    said = {key: told(value) for key, value in flat(values) if key != "title"}
    return said | {f"sha256 of {file}": sha256[:SHORT] for file, sha256 in hashes.items()}


def differing(facts: Sequence[Facts]) -> dict[str, tuple[str, ...]]:
    """What is not the same in all of `facts`: its value in each, "-" where there is none, by key.

    What follows from the robot's own values is told once, and no hash of a file that only one has.
    """
    found = {}
    for key in dict.fromkeys(key for one in facts for key in one):
        values = tuple(one.get(key, "-") for one in facts)
        of_another_file = key.startswith("sha256 of ") and "-" in values
        if len(set(values)) > 1 and not of_another_file and not _follows(key, facts):
            found[key] = values
    return found


def _follows(key: str, facts: Sequence[Facts]) -> bool:
    """Whether a value differs only because the robot's own does, which is told once."""
    for filled in FROM_ROBOT:
        own = f"robot{key.removeprefix(filled)}"
        if key.startswith(f"{filled}.") and all(one.get(own) == one.get(key) for one in facts):
            return True
    return False
