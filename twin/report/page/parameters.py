"""The experiment's values with unit and source, and which of them differ between runs."""

from collections.abc import Mapping, Sequence

from twin.experiment.difference import FROM_ROBOT, differing, flat, name_and_unit, recorded_facts, told
from twin.experiment.source import COMMAND_LINE
from twin.report.page.markup import Markup, element, table
from twin.report.page.run import ReportRun
from twin.runs.assembly.declared import DECLARED


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
        name, unit = name_and_unit(DECLARED, key)
        origin = source(key, run.origins)
        said = element("mark", origin) if origin == COMMAND_LINE else origin
        rows.append((name, told(value), unit, said))
    return table(("value of", "is", "unit", "source"), rows, f"parameters of {run.label}")


def differences(runs: Sequence[ReportRun]) -> list[tuple[str, ...]]:
    """(what, unit, its value in each run ...) of every parameter, FMU and version that is not the same in all."""
    return [
        (*name_and_unit(DECLARED, key), *values) for key, values in differing([_facts(run) for run in runs]).items()
    ]


def _facts(run: ReportRun) -> dict[str, str]:
    versions = {f"version of {name}": text for name, text in run.recording.metadata.get("versions", {}).items()}
    return recorded_facts(DECLARED, run.recording.metadata, run.recording.path) | versions
