"""Related files that an FMU carries and lists: its manifest of the layered standard FMI-LS-REF 1.0.0-alpha.1.

https://modelica.github.io/fmi-ls-ref/main
"""

from dataclasses import dataclass
from pathlib import Path

from twin.archive import content_of, entries, entry_of
from twin.errors import InputRefused
from twin.files import xml_of

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
                entry=entry_of(source, names, MANIFEST),
            )
        )
    return tuple(found)
