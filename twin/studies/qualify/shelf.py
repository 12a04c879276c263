"""The drives of fmus/: what each is, and whether it fits this robot's drive contract."""

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from twin.kernel.cache_folder import cache_folder, cached_answer, contents
from twin.kernel.errors import InputRefused
from twin.kernel.fmi import COMPILED
from twin.kernel.places import located
from twin.studies.result import Column, Table, laid_out

SHELF = "fmus"


class ShelvedDrive(NamedTuple):
    """A drive's folder.

    Attributes:
        name: of the folder, as `--drive` takes it.
        kind: "servo" (takes a speed), "motor" (our velocity loop is in front of it), "parts" (several FMUs); "" where
            it does not fit.
        command: what it is commanded with.
        fmi: versions.
        description: the FMU's own, one line.
        problem: why it does not fit; empty if it does.
    """

    name: str
    kind: str = ""
    command: str = ""
    fmi: str = ""
    description: str = ""
    problem: str = ""


def shelved_drives(start: Path) -> tuple[ShelvedDrive, ...]:
    """The drives of fmus/, as seen from folder `start` upwards, by name; looked at anew if anything there has changed.

    Raises:
        InputRefused: there is no fmus/.
    """
    shelf = located(SHELF, start)
    if not shelf.is_dir():
        raise InputRefused(f"{shelf}: no such folder; run this in the project's folder, or name a drive by its path")
    answer = cached_answer(
        "drives", lambda: json.dumps(_looked_at(shelf)), lambda: _made_of(shelf), lambda: _is_complete(shelf)
    )
    return tuple(ShelvedDrive(*facts) for facts in json.loads(answer))


COLUMNS = (
    Column("drive", left=True),
    Column("fits", 4, left=True, gap=2),
    Column("kind", 5, left=True, gap=2),
    Column("command", 8, left=True, gap=2),
    Column("FMI", 3, left=True, gap=2),
    Column("what it is", left=True, gap=2, folds=True),
)


def shelf_text(drives: Sequence[ShelvedDrive]) -> str:
    """One line per drive, a second one where the description or the problem is long."""
    rows = [
        (one.name, "no" if one.problem else "yes", one.kind, one.command, one.fmi, one.problem or one.description)
        for one in drives
    ]
    return laid_out([Table(COLUMNS, rows, indent=0)])


def _made_of(shelf: Path) -> str | None:
    """What lies in `shelf`, and what was compiled of such; None if it cannot be read."""
    try:
        lies, compiled = contents(shelf), contents(cache_folder(COMPILED))
    except InputRefused:
        return None
    return f"{lies} {compiled}" if lies and compiled else None


def _is_complete(shelf: Path) -> bool:
    """Whether the drives in `shelf` name no file but those beside them: others may change, or be there one day."""
    from twin.kernel.files import read_toml
    from twin.robot.experiment.drive_files import MAPPING

    try:
        return all(
            (mapping.parent / name).is_file() and name == Path(name).name and not name.endswith(".toml")
            for mapping in shelf.glob(f"*/{MAPPING}")
            for name in _named(read_toml(mapping))
        )
    except InputRefused:
        return False


def _named(node: Any, key: str = "") -> Iterator[str]:
    """The files that a mapping, or the value of a `key` in it, names."""
    if isinstance(node, dict):
        for inner, one in node.items():
            # { value = .., source = .. }
            yield from _named(one, key if inner == "value" else inner)
    elif isinstance(node, list):
        for one in node:
            yield from _named(one, key)
    elif isinstance(node, str) and (key in ("fmu", "extends") or node.startswith("file:")):
        yield node.removeprefix("file:")


def _looked_at(shelf: Path) -> tuple[ShelvedDrive, ...]:
    """The drives in `shelf`; to look at one takes numpy, FMPy and pydantic."""
    from twin.robot.experiment.drive_files import drives_in

    return tuple(_drive(shelf / name) for name in drives_in(shelf))


def _drive(folder: Path) -> ShelvedDrive:
    from twin.robot.assembly.drives import planned
    from twin.robot.experiment.drive_files import lone_drive

    try:
        plan = planned(lone_drive(str(folder), folder))
    except InputRefused as refusal:
        return ShelvedDrive(folder.name, problem=str(refusal).splitlines()[0])
    models = [fmu.model for fmu in plan.parts.values()]
    kind = "servo" if plan.table.velocity_loop is None else "motor"
    return ShelvedDrive(
        name=folder.name,
        kind="parts" if len(models) > 1 else kind,
        command=plan.table.command,
        fmi=", ".join(dict.fromkeys(model.fmiVersion for model in models)),
        description="; ".join(" ".join((model.description or model.modelName).split()) for model in models),
    )
