"""A drive written in Python, packed by pythonfmu."""

import subprocess
import sys
import xml.etree.ElementTree as ET
import zipfile
from pathlib import Path

from .archive import write_zip
from .drive import FMUS, source_guid

OPTIONS = ["--no-external-tool", "--handle-state", "--serialize-state"]


def python_drive_names() -> list[str]:
    """Names of the drives written in Python, sorted: the folders that hold `<folder>.py`."""
    return sorted(path.parent.name for path in FMUS.glob("*/*.py") if path.stem == path.parent.name)


def pack_python_drive(name: str, scratch: Path, target: Path) -> None:
    """Run `python -m pythonfmu build` under `scratch` and pack what it made into `target`.

    pythonfmu stamps its work with the hour and a random GUID. Neither means anything to its binary, so both are
    replaced: the same source and the same pythonfmu give the same bytes.

    Raises:
        subprocess.CalledProcessError: pythonfmu is not installed or refused.
    """
    scratch.mkdir(parents=True, exist_ok=True)
    source = FMUS / name / f"{name}.py"
    stamped = scratch / f"{name}.fmu"
    command = [sys.executable, "-m", "pythonfmu", "build", "-f", str(source), "-d", str(stamped), *OPTIONS]
    subprocess.run(command, check=True)
    content = scratch / "content"
    with zipfile.ZipFile(stamped) as archive:
        archive.extractall(content)
        names = archive.namelist()
    description = content / "modelDescription.xml"
    description.write_bytes(_unstamped(description.read_bytes(), source_guid((source,))))
    entries = {name: content / name for name in names}
    entries["documentation/README.md"] = FMUS / name / "README.md"
    write_zip(target, entries)


def _unstamped(description: bytes, guid: str) -> bytes:
    root = ET.fromstring(description)
    root.set("guid", guid)
    del root.attrib["generationDateAndTime"]
    return ET.tostring(root, encoding="UTF-8", xml_declaration=True)
