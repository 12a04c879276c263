"""The drives of fmus/: what each is, and whether it fits this robot's drive contract."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from twin.errors import InputRefused
from twin.experiment.drive_files import drives_in, lone_drive
from twin.experiment.source import located
from twin.runs.assembly.drives import planned
from twin.studies.lines import wrapped

SHELF = "fmus"


@dataclass(frozen=True)
class ShelvedDrive:
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
    """The drives of fmus/, as seen from folder `start` upwards, by name.

    Raises:
        InputRefused: there is no fmus/.
    """
    shelf = located(SHELF, start)
    if not shelf.is_dir():
        raise InputRefused(f"{shelf}: no such folder; run this in the project's folder, or name a drive by its path")
    return tuple(_looked_at(shelf / name) for name in drives_in(shelf))


def shelf_text(drives: Sequence[ShelvedDrive]) -> str:
    """One line per drive, a second one where the description or the problem is long."""
    longest = max((len(drive.name) for drive in drives), default=0)
    lines = [f"{'drive':{longest}}  fits  kind   command   FMI  what it is"]
    for drive in drives:
        fits = "no" if drive.problem else "yes"
        head = f"{drive.name:{longest}}  {fits:4}  {drive.kind:5}  {drive.command:8}  {drive.fmi:3}  "
        lines += wrapped(drive.problem or drive.description, head) or [head]
    return "\n".join(line.rstrip() for line in lines)


def _looked_at(folder: Path) -> ShelvedDrive:
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
