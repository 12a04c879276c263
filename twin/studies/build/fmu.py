"""The .fmu file of a part: its steps emitted, FMI's calls compiled in front of them, linked and packed.

modelDescription.xml of a part, for FMI 2.0 and 3.0.
"""

import io
import xml.etree.ElementTree as ET
import zipfile
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from twin.kernel.fmi.compiling import fmi_headers
from twin.kernel.units import Unit, known_unit
from twin.studies.build.layout import Kind, Layout, Variable, sizes, tables
from twin.studies.build.linking import (
    HERE,
    Platform,
    c_files,
    emitted_steps,
    guid_of,
    object_files,
    shared_library,
    universal,
)
from twin.studies.build.part import RobotPart

TOOL = "twin"
_CAUSALITY: dict[Kind, str] = {"parameter": "parameter", "tunable": "parameter", "input": "input", "output": "output"}
_VARIABILITY: dict[Kind, str] = {
    "parameter": "fixed",
    "tunable": "tunable",
    "input": "continuous",
    "output": "continuous",
}


def model_description(
    fmi: str, name: str, guid: str, about: str, variables: Sequence[Variable], tick: float, duration: float
) -> bytes:
    """modelDescription.xml, UTF-8, the same bytes for the same part.

    Args:
        fmi: "2.0" or "3.0".
        name: modelName and modelIdentifier.
        guid: that the binary knows.
        about: what the part is, and what delay its steps mean.
        variables: of scalars in FMI 2.0; the value reference is the place in it.
        tick: of the experiment (s).
        duration: of the experiment (s).
    """
    new = fmi == "3.0"
    root = ET.Element(
        "fmiModelDescription",
        {
            "fmiVersion": fmi, "modelName": name, "instantiationToken" if new else "guid": guid, "description": about,
            "generationTool": TOOL, "variableNamingConvention": "structured",
        },
    )  # fmt: skip
    ET.SubElement(
        root,
        "CoSimulation",
        {
            "modelIdentifier": name,
            "canHandleVariableCommunicationStepSize": "true",
            "canGetAndSetFMUState" if new else "canGetAndSetFMUstate": "true",
            "canSerializeFMUState" if new else "canSerializeFMUstate": "true",
        }
        | (
            {"fixedInternalStepSize": repr(tick), "hasEventMode": "false"}
            if new
            else {"canNotUseMemoryManagementFunctions": "true"}
        ),
    )
    _append_units(root, variables, new)
    categories = ET.SubElement(root, "LogCategories")
    ET.SubElement(categories, "Category", name="logStatusError", description="Why a call was refused")
    ET.SubElement(root, "DefaultExperiment", startTime="0.0", stopTime=repr(duration), stepSize=repr(tick))
    inside = ET.SubElement(root, "ModelVariables")
    for reference, variable in enumerate(variables):
        (_append_array if new else _append_scalar)(inside, variable, reference)
    structure = ET.SubElement(root, "ModelStructure")
    if new:
        ET.SubElement(
            inside, "Float64", name="time", valueReference=str(len(variables)), causality="independent",
            variability="continuous", description="Time reached", unit="s",
        )  # fmt: skip
    _append_structure(structure, variables, new)
    ET.indent(root)
    return ET.tostring(root, encoding="UTF-8", xml_declaration=True) + b"\n"


def _append_units(root: ET.Element, variables: Sequence[Variable], new: bool) -> None:
    units: dict[str, Unit] = {variable.text: variable.unit for variable in variables}
    second = known_unit("s")
    if new and second is not None:
        units["s"] = second
    definitions = ET.SubElement(root, "UnitDefinitions")
    for text in sorted(units):
        unit = units[text]
        powers = {base: str(power) for base, power in unit.dimension._asdict().items() if power}
        factor = {} if unit.scale == 1.0 else {"factor": repr(unit.scale)}
        ET.SubElement(ET.SubElement(definitions, "Unit", name=text), "BaseUnit", powers | factor)


def _attributes(variable: Variable, reference: int) -> dict[str, str]:
    attributes = {
        "name": variable.name,
        "valueReference": str(reference),
        "causality": _CAUSALITY[variable.kind],
        "variability": _VARIABILITY[variable.kind],
        "description": variable.meaning,
    }
    return attributes | ({"initial": "calculated"} if variable.kind == "output" else {})


def _bounds(variable: Variable) -> dict[str, str]:
    above, at_least, below, at_most = variable.limits
    lower, upper = at_least if above is None else above, at_most if below is None else below
    return {name: repr(float(x)) for name, x in (("min", lower), ("max", upper)) if x is not None}


def _append_scalar(inside: ET.Element, variable: Variable, reference: int) -> None:
    scalar = ET.SubElement(inside, "ScalarVariable", _attributes(variable, reference))
    start = {} if variable.kind == "output" else {"start": repr(variable.start[0])}
    ET.SubElement(scalar, "Real", {"unit": variable.text} | _bounds(variable) | start)


def _append_array(inside: ET.Element, variable: Variable, reference: int) -> None:
    start = {} if variable.kind == "output" else {"start": " ".join(map(repr, variable.start))}
    attributes = _attributes(variable, reference) | {"unit": variable.text} | _bounds(variable) | start
    array = ET.SubElement(inside, "Float64", attributes)
    if len(variable.start) > 1:
        ET.SubElement(array, "Dimension", start=str(len(variable.start)))


def _append_structure(structure: ET.Element, variables: Sequence[Variable], new: bool) -> None:
    # outputs change with a step, never with an input at the same instant; at the start they follow from all there is
    outputs = [reference for reference, variable in enumerate(variables) if variable.kind == "output"]
    if new:
        for tag, more in (("Output", {"dependencies": ""}), ("InitialUnknown", {})):
            for reference in outputs:
                ET.SubElement(structure, tag, {"valueReference": str(reference)} | more)
        return
    for tag, more in (("Outputs", {"dependencies": ""}), ("InitialUnknowns", {})):
        unknowns = ET.SubElement(structure, tag)
        for reference in outputs:
            ET.SubElement(unknowns, "Unknown", {"index": str(reference + 1)} | more)


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
