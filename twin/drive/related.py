"""Related files that an FMU carries and lists: its manifest of the layered standard FMI-LS-REF 1.0.0-alpha.1.

https://modelica.github.io/fmi-ls-ref/main
"""

import posixpath
import re
import zipfile
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import unquote

from twin.drive.archive import entries, place
from twin.errors import InputRefused
from twin.files import LIMIT, xml_of

HOME = "extra/org.fmi-standard.fmi-ls-ref"
MANIFEST = f"{HOME}/fmi-ls-manifest.xml"
STANDARD = "org.fmi-standard.fmi-ls-ref"
NAMESPACE = "{http://fmi-standard.org/fmi-ls-manifest}"
MOST_RELATED = 1_000
"""Files of one manifest; an honest one lists a dozen."""


@dataclass(frozen=True)
class Related:
    """A file that the manifest lists.

    Attributes:
        role, type, source, description: as the manifest says; `source` is a URI, relative to the manifest.
        labels: names of its labels.
        entry: its name in the archive; "": the source is no file of this FMU.
    """

    role: str
    type: str
    source: str
    description: str
    labels: tuple[str, ...]
    entry: str


def related(file: Path) -> tuple[Related, ...]:
    """What the manifest of the FMU `file` lists, in its order; nothing if it has none.

    Raises:
        InputRefused: no archive that can be unpacked safely, or a manifest that is none.
    """
    names = entries(file)
    if MANIFEST not in names:
        return ()
    where = f"{file}: {MANIFEST}"
    root = xml_of(content_of(file, MANIFEST), where)
    named = root.get(f"{NAMESPACE}fmi-ls-name")
    if root.tag != "fmiReferences" or named != STANDARD:
        raise InputRefused(f"{where}: <{root.tag}> of '{named}'; expected <fmiReferences> of '{STANDARD}'")
    listed = root.findall("Related")
    if len(listed) > MOST_RELATED:
        raise InputRefused(f"{where}: lists {len(listed)} files; expected at most {MOST_RELATED}")
    found = []
    for element in listed:
        if not (source := element.get("source", "")):
            raise InputRefused(f"{where}: a <Related> without a source; expected the name of a file")
        found.append(
            Related(
                role=element.get("role", "other"),
                type=element.get("type", "application/octet-stream"),
                source=source,
                description=element.get("description", ""),
                labels=tuple(label.get("name", "") for label in element.findall("Label")),
                entry=entry_of(source, names),
            )
        )
    return tuple(found)


def entry_of(source: str, names: dict[str, int], base: str = MANIFEST) -> str:
    """The entry among `names` that the relative URI `source` means; "": it is none of them.

    Args:
        base: entry in which the URI stands.
    """
    if re.match(r"[A-Za-z][A-Za-z0-9+.-]*:|/", source):
        return ""
    path = unquote(re.split(r"[?#]", source)[0])
    # what leads out of the archive is none of its entries
    name = posixpath.normpath(posixpath.join(posixpath.dirname(base), path))
    return name if name in names else ""


def content_of(file: Path, entry: str, limit: int = LIMIT) -> bytes:
    """The content of an entry of the FMU `file`, whose archive `entries` has found sound.

    Raises:
        InputRefused: it has more than `limit` bytes.
    """
    with zipfile.ZipFile(file) as archive:
        info = next(info for info in archive.infolist() if place(info) == entry)
        if info.file_size > limit:
            raise InputRefused(
                f"{file}: {entry}: {info.file_size / 2**20:.0f} MB; expected at most {limit / 2**20:g} MB"
            )
        return archive.read(info)
