"""Where a run comes from: its drives with hashes, its time, and how to make it again.

The experiment's values with unit and source, and which of them differ between runs.
"""

import base64
import json
import shlex
from collections.abc import Mapping, Sequence
from typing import Any

from twin.report.page.markup import Markup, element, joined, table
from twin.report.page.measures import number
from twin.report.page.run import ReportRun
from twin.robot.assembly.declared import DECLARED
from twin.robot.experiment.recorded import FROM_ROBOT, differing, flat, name_and_unit, options, recorded_facts, told
from twin.robot.experiment.source import COMMAND_LINE


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


def command(run: ReportRun) -> str:
    """What makes this recording again, from the repository: `twin run experiments/... --set ...`."""
    words = ["twin", "run", f"experiments/{run.name}.toml", *options(run.values, run.origins)]
    return shlex.join(words)


def provenance(run: ReportRun) -> Markup:
    """Command, seed, hash of the recording, versions; the whole experiment to take away."""
    versions = run.recording.metadata.get("versions", {})
    rows = [
        ("command of its experiment" if run.recording.deviations else "command", element("code", command(run))),
        ("seed of the noise", told(run.values.get("seed", 0))),
        ("recording", run.recording.path.name),
        ("its sha256", element("code", run.sha256)),
        ("versions", ", ".join(f"{name} {text}" for name, text in versions.items())),
    ]
    values = json.dumps(run.values, indent=2, ensure_ascii=False)
    link = "data:application/json;base64," + base64.b64encode(values.encode()).decode("ascii")
    whole = element("details", element("summary", "The whole experiment, as it was checked"), element("pre", values))
    save = element("a", "Save it as JSON", href=link, download=f"{run.name}.json")
    same = ["The same versions on the same kind of machine give the same recording, byte for byte."]
    said = [element("p", f"{text[0].upper()}{text[1:]}.") for text in run.recording.deviations or same]
    return joined([table(("", "is"), rows, f"provenance of {run.label}"), *said, element("p", save), whole])


def drives(run: ReportRun) -> Markup:
    """Every FMU: which joint, file, model, FMI version, tool, hash, what was set, how its names were mapped."""
    joints: dict[str, list[str]] = {}
    for name, fmu in run.fmus.items():
        joints.setdefault(json.dumps(fmu), []).append(name.removeprefix("drive_"))
    rows = []
    for text, names in joints.items():
        fmu = json.loads(text)
        given = fmu["set"] | ({"tolerance of its solver": fmu["tolerance"]} if fmu["tolerance"] else {})
        given |= {"solver": fmu["solver"]} if fmu["solver"] else {}
        given |= {"longest step of the solver (s)": fmu["solver_step"]} if fmu["solver_step"] else {}
        settings = ", ".join(f"{key} = {told(value)}" for key, value in given.items())
        rows.append(
            (
                ", ".join(names),
                fmu["file"],
                fmu["model"],
                fmu["fmi"] + (" model exchange" if fmu["kind"] == "model_exchange" else ""),
                fmu["generation_tool"] or "not said",
                element("code", fmu["sha256"]),
                settings or "nothing",
                joined([element("div", text) for text in fmu["mapped"]]),
            )
        )
    head = ("joint", "file", "model", "FMI", "made by", "sha256", "set", "signals")
    return table(head, rows, f"drives of {run.label}")


def timing(runs: Sequence[ReportRun]) -> Markup:
    """How long the runs took, and each component's share where it was measured."""
    rows = []
    for text, key, unit in (
        ("simulated", "simulated", "s"),
        ("stepping", "stepping", "s"),
        ("recording", "writing", "s"),
        ("times as fast as the real robot", "real_time_factor", ""),
    ):
        rows.append((text, *(_told(run.summary.get(key), unit) for run in runs)))
    measured = [run.summary.get("microseconds") for run in runs]
    shares: list[dict[str, Any]] = [share if isinstance(share, dict) else {} for share in measured]
    for name in dict.fromkeys(name for share in shares for name in share):
        rows.append((f"{name}, per tick", *(_told(share.get(name), "us") for share in shares)))
    text = "Time by component was not measured, or the run did not get to its end." if not any(shares) else ""
    head = ("", *(run.label if len(runs) > 1 else "time" for run in runs))
    return joined([table(head, rows, "time that the runs took"), element("p", text)])


def _told(value: object, unit: str) -> str:
    return number(value, unit) if isinstance(value, float) else "not recorded"
