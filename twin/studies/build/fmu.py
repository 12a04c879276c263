"""The .fmu file of a part: its steps emitted, FMI's calls compiled in front of them, linked and packed."""

import hashlib
import io
import platform
import sys
import tempfile
import uuid
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from twin.drive.compiling import PATIENCE, call_compiler, compiler, fmi_headers
from twin.errors import InputRefused, disk_refusals
from twin.studies.build.description import model_description
from twin.studies.build.emission import Emitted, emitted
from twin.studies.build.layout import Layout
from twin.studies.build.part import RobotPart
from twin.studies.build.tables import sizes, tables

C = Path(__file__).parent / "c"
FOLDERS = {"2.0": "linux64", "3.0": "x86_64-linux"}
"""Where the library lies in the archive, by version of FMI."""
NAMESPACE = uuid.UUID("0c2f7c0e-6b0e-5d56-9a57-6a0f6f1f3c55")
EPOCH = (1980, 1, 1, 0, 0, 0)
"""The earliest date that an archive can hold; the true one would make every build another file."""
# no contraction to fused multiply-add: the same numbers as here; nothing undefined but libc and libm
FLAGS = (
    "-std=c11", "-O2", "-ffp-contract=off", "-fPIC", "-fvisibility=hidden", "-w", "-shared", "-s", "-Wl,-z,now",
    "-Wl,-z,defs", "-DFMI3_OVERRIDE_FUNCTION_PREFIX",
)  # fmt: skip
# glibc of 2012: what is linked against it runs on every system since
ZIG_TARGET = ("-target", "x86_64-linux-gnu.2.17")


def refuse_platform(wanted: Path) -> None:
    """Refuse where code for Linux on x86-64 cannot be linked and tried.

    Raises:
        InputRefused: this is another system, or there is no C compiler.
    """
    if sys.platform != "linux" or platform.machine() not in ("x86_64", "AMD64"):
        here = f"{platform.machine()} {platform.system()}"
        raise InputRefused(f"{wanted}: FMUs are built on x86-64 Linux for x86-64 Linux; this is {here}")
    compiler(wanted)


def packed(
    part: RobotPart, layout: Layout, fmi: str, about: str, readme: str, wanted: Path, say: Callable[[str], None]
) -> bytes:
    """The archive.

    Args:
        part: what is built.
        layout: of it.
        fmi: "2.0" or "3.0".
        about: for the description.
        readme: documentation.
        wanted: the file, for sentences.
        say: told what is being done.

    Raises:
        InputRefused: a step cannot leave Python, or the compiler refuses.
    """
    steps = []
    for row in layout.rows:
        say(f"compiling {row.component.name}")
        step: Any = row.step
        steps.append(emitted(step, row.symbol))
    variables = layout.variables if fmi == "3.0" else layout.scalars()
    experiment = part.experiment
    tick, duration = experiment.cosim.tick, experiment.duration_ticks * experiment.cosim.tick

    def description(guid: str) -> bytes:
        return model_description(fmi, part.name, guid, about, variables, tick, duration)

    source = tables(layout, variables)
    guid = _guid(*(step.content for step in steps), source.encode(), description(""), *_ceremony(fmi).values())
    say("linking")
    generated = {"sizes.h": sizes(layout, variables, guid, tick), "tables.c": source}
    library = _linked(part.name, fmi, generated, steps, wanted)
    return archive(
        {
            "modelDescription.xml": description(guid),
            f"binaries/{FOLDERS[fmi]}/{part.name}.so": library,
            "documentation/README.md": readme.encode(),
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


def _ceremony(fmi: str) -> dict[str, bytes]:
    """The C that every part shares, by the name of the file."""
    return {name: (C / name).read_bytes() for name in ("part.h", "part.c", f"fmi{fmi[0]}.c")}


def _guid(*contents: bytes) -> str:
    digest = hashlib.sha256()
    for content in contents:
        digest.update(f"{len(content)}\n".encode() + content)
    return "{" + str(uuid.uuid5(NAMESPACE, digest.hexdigest())) + "}"


def _linked(name: str, fmi: str, generated: dict[str, str], steps: list[Emitted], wanted: Path) -> bytes:
    tool = compiler(wanted)
    target = ZIG_TARGET if "ziglang" in tool else ()
    with (
        disk_refusals(Path(tempfile.gettempdir()), "cannot be written to"),
        tempfile.TemporaryDirectory(prefix="twin-build-") as scratch,
    ):
        folder = Path(scratch)
        objects = {f"{step.symbol}.o": step.content for step in steps}
        for file, content in (_ceremony(fmi) | objects).items():
            (folder / file).write_bytes(content)
        for file, text in generated.items():
            (folder / file).write_text(text, encoding="utf-8")
        # relative: the name of a folder would end in the library
        inputs = ["part.c", f"fmi{fmi[0]}.c", "tables.c", *objects]
        library = folder / f"{name}.so"
        command = [*tool, *target, *FLAGS, "-I.", "-isystem", str(fmi_headers()), *inputs, "-lm", "-o", library.name]
        call_compiler(
            command,
            f"{wanted}: does not compile",
            f"{wanted}: its C still compiles after {PATIENCE:g} s; try another compiler",
            folder,
        )
        return library.read_bytes()
