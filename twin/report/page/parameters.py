"""The experiment's values with unit and source, and which of them differ between runs."""

from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from typing import Any

from twin.experiment import contact, fault, monitor, robot, schema, task
from twin.experiment.fault_catalogue import CATALOGUE
from twin.experiment.quantity import Section
from twin.report.page.markup import Markup, element, table
from twin.report.page.run import ReportRun

FROM_ROBOT = ("plant", "controller.model")
"""Tables that hold the robot's own values wherever they do not say otherwise."""


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
def _names() -> dict[str, str]:
    """Key of an experiment file -> its name without the unit, of every key that has one."""
    tables = [table for module in (contact, fault, monitor, robot, schema, task) for table in vars(module).values()]
    models = [table for table in tables if isinstance(table, type) and issubclass(table, Section)]
    fields = {field.alias: name for model in models for name, field in model.model_fields.items() if field.alias}
    magnitudes = {kind.magnitude_key: "magnitude" for kind in CATALOGUE.values() if kind.magnitude_key}
    return fields | magnitudes


def name_and_unit(key: str) -> tuple[str, str]:
    """`controller.force.kp_mm_per_N` as `controller.force.kp`, `mm/N`; a drive's parameters keep names of their own."""
    tables, dot, last = key.rpartition(".")
    name = _names().get(last, last) if ".parameters" not in tables else last
    words = last.removeprefix(f"{name}_").split("_") if name != last else []
    above, below = words, []
    if "per" in words:
        above, below = words[: words.index("per")], words[words.index("per") + 1 :]
    unit = " ".join(above) or "1" * bool(below)
    unit += f"/{' '.join(below)}" if len(below) == 1 else f"/({' '.join(below)})" if below else ""
    return f"{tables}{dot}{name}", unit.replace("Nm", "N m").replace("m2", "m²").replace("s2", "s²")


def source(key: str, origins: Mapping[str, str]) -> str:
    """Where the value of `key` comes from; the robot's own source where a table was filled from it."""
    for filled in FROM_ROBOT:
        if key not in origins and key.startswith(f"{filled}."):
            said = origins.get(f"robot{key.removeprefix(filled)}")
            return f"robot: {said}" if said else ""
    item, _, field = key.rpartition(".")
    return origins.get(key) or (origins.get(item, "") if field else "")


def parameters(run: ReportRun) -> Markup:
    """Every value of the experiment, table by table; those that were set on the command line are marked."""
    rows = []
    for key, value in flat(run.values):
        name, unit = name_and_unit(key)
        origin = source(key, run.origins)
        said = element("mark", origin) if origin == "set on the command line" else origin
        rows.append((name, told(value), unit, said))
    return table(("value of", "is", "unit", "source"), rows, f"parameters of {run.label}")


def differences(runs: Sequence[ReportRun]) -> list[tuple[str, ...]]:
    """(what, unit, its value in each run ...) of every parameter, FMU and version that is not the same in all."""
    facts = [_facts(run) for run in runs]
    keys = dict.fromkeys(key for one in facts for key in one)
    rows = []
    for key in keys:
        values = [one.get(key, "-") for one in facts]
        if len(set(values)) > 1 and not _follows(key, facts):
            rows.append((*name_and_unit(key), *values))
    return rows


def told(value: Any) -> str:
    """A value of a TOML file as people write it."""
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:.12g}" if isinstance(value, float) else str(value)


def _facts(run: ReportRun) -> dict[str, str]:
    values = {key: told(value) for key, value in flat(run.values) if key != "title"}
    hashes = {f"{name}, sha256 of {fmu['file']}": str(fmu["sha256"])[:12] for name, fmu in run.fmus.items()}
    versions = {f"version of {name}": text for name, text in run.recording.metadata.get("versions", {}).items()}
    return {**values, **hashes, **versions}


def _follows(key: str, facts: Sequence[Mapping[str, str]]) -> bool:
    """Whether a value differs only because the robot's own does, which is told once."""
    for filled in FROM_ROBOT:
        own = f"robot{key.removeprefix(filled)}"
        if key.startswith(f"{filled}.") and all(one.get(own) == one.get(key) for one in facts):
            return True
    return False
