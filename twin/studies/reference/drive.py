"""What came with the FMUs of a drive, as a part of its check."""

from collections.abc import Sequence
from pathlib import Path

from twin.experiment.schema import Drive
from twin.runs.assembly.drives import planned
from twin.studies.answer import Answer
from twin.studies.reference.outcome import References, references
from twin.studies.reference.text import references_text


def came_with(table: Drive, apart: bool) -> list[References]:
    """What came with each FMU of the drive that has something, run bare: its mapping and parameters are not for it.

    Args:
        apart: see `references`.

    Raises:
        InputRefused: no sound archive, a manifest that is none; an FMU that is not the one its mapping pins.
    """
    if table.sha256 or any(part.sha256 for part in table.parts.values()):
        # nothing of it is run before that
        planned(table)
    files = [Path(fmu) for fmu in (table.fmu, *(part.fmu for part in table.parts.values())) if fmu]
    return [found for file in files if (found := references(file, apart))]


def no_drive(came: Sequence[References], refusal: str) -> Answer:
    """The answer where the FMU is refused as a drive, after what came with it has been tried; `refused` says why."""
    facts = {"qualified": False, "refused": refusal, "references": [one.facts() for one in came]}
    return Answer(references_text(came), facts, 2)
