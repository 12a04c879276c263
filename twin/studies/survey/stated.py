"""What an FMU says of itself, whatever version and kind it is of, and whether or not it can be used here."""

from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from twin.archive import content_of, entries
from twin.drive.description import DESCRIPTION, MOST_DESCRIPTION
from twin.errors import InputRefused
from twin.files import xml_of

KINDS = {
    "CoSimulation": "co-simulation",
    "ModelExchange": "model exchange",
    "ScheduledExecution": "scheduled execution",
}


@dataclass(frozen=True)
class Stated:
    """What stands in modelDescription.xml; "" where it says nothing.

    Attributes:
        model: its name.
        tool: that made it, with its version.
        fmi: version of the standard.
        kinds: values of `KINDS`.
        platforms: folders of binaries.
    """

    model: str
    tool: str
    fmi: str
    kinds: tuple[str, ...]
    platforms: tuple[str, ...]


def stated(file: Path) -> Stated:
    """What the FMU `file` says of itself.

    Raises:
        InputRefused: no sound archive, or no description in it that is XML.
    """
    names = entries(file)
    if DESCRIPTION not in names:
        raise InputRefused(f"{file}: no {DESCRIPTION} inside; this is not an FMU")
    root = xml_of(content_of(file, DESCRIPTION, MOST_DESCRIPTION), f"{file}: {DESCRIPTION}")
    version = root.get("fmiVersion", "")
    kinds = tuple(kind for tag, kind in KINDS.items() if root.find(tag) is not None)
    if version.startswith("1"):
        # FMI 1.0 tells co-simulation by the element that says how it is implemented
        kinds = (KINDS["ModelExchange"] if root.find("Implementation") is None else KINDS["CoSimulation"],)
    folders = {PurePosixPath(name).parts[1] for name in names if name.startswith("binaries/") and name.count("/") > 1}
    tool = " ".join(root.get("generationTool", "").split())
    return Stated(root.get("modelName", ""), tool, version, kinds, tuple(sorted(folders)))
