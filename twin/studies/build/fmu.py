"""The .fmu file of a part: its steps emitted, FMI's calls compiled in front of them, linked and packed."""

import io
import zipfile
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from twin.drive.compiling import fmi_headers
from twin.studies.build.description import model_description
from twin.studies.build.emission import emitted_steps, object_files
from twin.studies.build.layout import Layout
from twin.studies.build.linking import c_files, guid_of, shared_library, universal
from twin.studies.build.part import RobotPart
from twin.studies.build.platforms import HERE, Platform
from twin.studies.build.tables import sizes, tables

EPOCH = (1980, 1, 1, 0, 0, 0)
"""The earliest date that an archive can hold; the true one would make every build another file."""


def packed(
    part: RobotPart,
    layout: Layout,
    fmi: str,
    platforms: Sequence[Platform],
    about: str,
    readme: str,
    wanted: Path,
    say: Callable[[str], None],
) -> bytes:
    """The archive.

    Args:
        part: what is built.
        layout: of it.
        fmi: "2.0" or "3.0".
        platforms: for which.
        about: for the description.
        readme: documentation.
        wanted: the file, for sentences.
        say: told what is being done.

    Raises:
        InputRefused: a step cannot leave Python, or the compiler refuses.
    """
    steps = emitted_steps(layout, platforms, say)
    variables = layout.variables if fmi == "3.0" else layout.scalars()
    experiment = part.experiment
    tick, duration = experiment.cosim.tick, experiment.duration_ticks * experiment.cosim.tick

    def description(guid: str) -> bytes:
        return model_description(fmi, part.name, guid, about, variables, tick, duration)

    source = tables(layout, variables)
    front = f"fmi{fmi[0]}.c"
    ceremony = c_files("part.h", "part.c", "instance.h", "instance.c", front)
    # of the steps for this platform: the others are the same ones
    guid = guid_of(*(step.content for step in steps[HERE]), source.encode(), description(""), *ceremony.values())
    files = ceremony | {"sizes.h": sizes(layout, variables, guid, tick).encode(), "tables.c": source.encode()}
    options = ("-DFMI3_OVERRIDE_FUNCTION_PREFIX", "-isystem", str(fmi_headers()))

    def library(platform: Platform) -> bytes:
        return shared_library(part.name, front, platform, files | object_files(steps[platform]), options, wanted)

    say("linking")
    with ThreadPoolExecutor() as threads:
        libraries = dict(zip(platforms, threads.map(library, platforms), strict=True))
    return archive(
        {
            "modelDescription.xml": description(guid),
            "documentation/README.md": readme.encode(),
            **_binaries(part.name, fmi, libraries),
        }
    )


def archive(entries: dict[str, bytes]) -> bytes:
    """A zip of contents by name; the same contents give the same bytes."""
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as packing:
        for name, content in sorted(entries.items()):
            entry = zipfile.ZipInfo(name, date_time=EPOCH)
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.external_attr = 0o644 << 16
            packing.writestr(entry, content)
    return file.getvalue()


def _binaries(name: str, fmi: str, libraries: dict[Platform, bytes]) -> dict[str, bytes]:
    """Libraries by their places in the archive; FMI 2.0 has one for all processors of macOS."""
    places: dict[str, dict[str, bytes]] = {}
    for platform, library in libraries.items():
        folder = platform.name if fmi == "3.0" else platform.fmi2
        places.setdefault(f"binaries/{folder}/{name}.{platform.suffix}", {})[platform.triple] = library
    return {place: next(iter(s.values())) if len(s) == 1 else universal(s) for place, s in places.items()}
