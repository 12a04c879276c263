"""Loading of experiments from a file or a recording, with all checks for this robot."""

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from twin.kernel.errors import InputRefused
from twin.kernel.files import parse_json, parse_toml
from twin.robot.assembly.checks.agreement import disagreements
from twin.robot.assembly.declared import DECLARED_TABLES
from twin.robot.assembly.way_points import load_waypoints
from twin.robot.experiment.command_words import run_words
from twin.robot.experiment.drive_files import locate_drive
from twin.robot.experiment.experiment import Experiment, checked_tables, experiment_of
from twin.robot.experiment.experiment_files import experiment_file
from twin.robot.experiment.mistakes import unit_hints
from twin.robot.experiment.recorded import Metadata, recorded_fmus, recorded_name, recorded_values
from twin.robot.experiment.schema import Drive
from twin.robot.experiment.source import RETAINED_KEYS, Source, apply_overrides, read_source, refuse_other_files
from twin.robot.paths import locate_file

OUT_OF_REACH = "out of reach"
"""Phrase in every error message about an unreachable pose."""


def load_experiment(
    path: str | Path, overrides: Iterable[str] = (), drive: str | None = None, body: str | None = None
) -> Experiment:
    """Load the experiment file at `path`, apply settings, drive and body, and check it.

    Args:
        path: a TOML file, or the name of an experiment, see `experiment_file`.
        overrides: "table.key=value" texts applied to it; within an array of tables "task.1.force_N=4".
        drive: an FMU or a drive of fmus/ that replaces the drive of every joint and its parameters.
        body: a file of bodies/ that replaces all of [contact] but its height.

    Raises:
        InputRefused: with one sentence per error.
    """
    overrides = tuple(overrides)
    typed = run_words(path, overrides, drive, body)
    path = experiment_file(path)
    source = read_source(path)
    refuse_other_files(source.values, path)
    folder = path.resolve().parent
    if drive is not None:
        source.select_file("drive", "fmu", locate_drive(drive, folder))
    if body is not None:
        source.select_file("contact", "body", body)
    apply_overrides(source, overrides)
    return replace(checked_experiment(source, path.stem, path, folder), typed=typed)


def checked_experiment(source: Source, name: str, where: Path, folder: Path) -> Experiment:
    """Check the merged values of an experiment's files, completed in place, and return the experiment.

    `where` is their origin for error messages; bodies and drives are looked up in `folder`.
    """
    mistakes: list[str] = []
    tables = checked_tables(DECLARED_TABLES, source, folder, mistakes)
    reference = load_waypoints(tables, mistakes)
    apart = disagreements(tables, reference, source.values)
    if any(OUT_OF_REACH in mistake for mistake in apart):
        mistakes += unit_hints(source.values)
    mistakes += apart
    if mistakes:
        several = f"{where} has {len(mistakes)} mistakes:" + "".join(f"\n  {mistake}" for mistake in mistakes)
        raise InputRefused(f"{where}: {mistakes[0]}" if len(mistakes) == 1 else several)
    return experiment_of(name, tables, reference, source)


def recorded_experiment(
    metadata: Metadata,
    where: Path,
    duration: float | None = None,
    changed: bool = False,
    settings: Sequence[str] = (),
    faults: Sequence[str] = (),
    body: str | None = None,
) -> Experiment:
    """Load the experiment of a recording, with the same FMUs and optional changes.

    A recording names its FMUs by file name and SHA-256 without a path: they are searched beside it and in fmus/. Every
    drive pins its recorded SHA-256, so that no other file is used, unless a setting of [drive] replaces it.

    Args:
        where: path of the recording.
        duration: new duration (s); None to keep the recorded one.
        changed: whether to accept a run with changes by hand.
        faults: inline TOML tables, added to its own faults.
        settings, body: see `load_experiment`.

    Raises:
        InputRefused: it has no experiment, used substitutes, a remote controller or changes by hand, or lacks an FMU.
    """
    name, values = recorded_name(metadata, where), recorded_values(DECLARED_TABLES, metadata, where)
    if "drive" not in values:
        raise InputRefused(f"{where}: carries no experiment that could be run again")
    fmus = {drive: facts["sha256"] for drive, facts in recorded_fmus(metadata, where).items()}
    if "substituted" in metadata:
        parts = ", ".join(metadata["substituted"])
        raise InputRefused(f"{where}: was made with a substitute for {parts}, so its experiment does not repeat it")
    if "served" in metadata:
        raise InputRefused(f"{where}: a remote controller commanded its drives, so its experiment does not repeat it")
    if "changed" in metadata and not changed:
        raise InputRefused(f"{where}: was changed by hand while it ran, so its experiment does not repeat it")
    if not fmus:
        raise InputRefused(f"{where}: carries no FMUs, so its experiment cannot be run again as it was")
    folder = where.resolve().parent
    values |= {} if duration is None else {"duration_s": duration}
    # [contact] already contains the body's file
    values.get("contact", {}).pop("body", None)
    _find_parts(values, metadata, fmus, where, folder)
    source = Source()
    if faults:
        added = [parse_toml(f"fault = {text}", f"--fault {text}")["fault"] for text in faults]
        values["fault"] = [*values.get("fault", ()), *added]
    source.merge(values | {"drive": _with_paths(values["drive"], where, folder)}, "recorded")
    if body is not None:
        source.select_file("contact", "body", body)
    apply_overrides(source, settings)
    experiment = checked_experiment(source, name, where, folder)
    if any(setting.strip().startswith("drive.") for setting in settings):
        return experiment
    one, two, three = experiment.drives
    pinned = (_pin_hashes(one, "drive_1", fmus), _pin_hashes(two, "drive_2", fmus), _pin_hashes(three, "drive_3", fmus))
    return replace(experiment, drives=pinned)


def _find_parts(values: dict[str, Any], metadata: Metadata, fmus: Mapping[str, str], where: Path, folder: Path) -> None:
    """Replace recorded names of third-party files by the paths of the same files, pinned by SHA-256."""
    for role in RETAINED_KEYS:
        table = values.get(role)
        if not isinstance(table, dict):
            continue
        if isinstance(table.get("fmu"), str) and role in fmus:
            values[role] = table | {"fmu": _fmu_path(table["fmu"], where, folder, role), "sha256": fmus[role]}
        if isinstance(table.get("python"), str):
            facts = parse_json(metadata.get("python", {}).get(role, "{}"), f"{where}: its {role}")
            file, _, kind = table["python"].rpartition(":")
            # a recording is untrusted: only its file names are used, never its paths
            path = locate_file(Path(file).name, folder)
            known = isinstance(facts, dict) and isinstance(facts.get("sha256"), str)
            if not os.path.isfile(path) or not known:
                raise InputRefused(
                    f"{where}: its {role} {Path(file).name} is not in the recording's folder; "
                    "copy it there to run it again"
                )
            values[role] = table | {"python": f"{path}:{kind}", "sha256": facts["sha256"]}


def _with_paths(table: dict[str, Any], where: Path, folder: Path) -> dict[str, Any]:
    """Return a recorded [drive] table with FMU names replaced by the paths of the same files."""
    tables = {key: _with_paths(value, where, folder) for key, value in table.items() if isinstance(value, dict)}
    fmu = {"fmu": _fmu_path(table["fmu"], where, folder)} if isinstance(table.get("fmu"), str) else {}
    return table | tables | fmu


def _fmu_path(name: str, where: Path, folder: Path, part: str = "drive") -> str:
    # a recording is untrusted: only its file names are used, never its paths
    name = Path(name).name
    # fmus/ first, as a run's folder may have the name of its drive
    for candidate in (f"fmus/{name}", f"fmus/{Path(name).stem}/{name}", f"fmus/parts/{name}", name):
        path = locate_file(candidate, folder)
        # not Path.is_file, which raises for a too long name
        if os.path.isfile(path) or (os.path.exists(path) and candidate != name):
            return str(path)
    raise InputRefused(
        f"{where}: its {part} {name} is neither in fmus/ nor in the recording's folder; copy it there to run it again"
    )


def _pin_hashes(drive: Drive, name: str, fmus: Mapping[str, str]) -> Drive:
    parts = {
        part: table.model_copy(update={"sha256": fmus.get(f"{name}.{part}")}) for part, table in drive.parts.items()
    }
    return drive.model_copy(update={"sha256": fmus.get(name), "parts": parts})
