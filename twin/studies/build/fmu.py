"""The .fmu file of a robot part: compiled steps, FMI functions in C, modelDescription.xml for FMI 2.0 and 3.0."""

import xml.etree.ElementTree as ET
from collections.abc import Callable, Sequence
from pathlib import Path

from twin.kernel.archive import zip_bytes
from twin.kernel.atomic_write import make_folder, refuse_unwritable, write_bytes
from twin.kernel.fmi.unpacked import fmi_headers
from twin.kernel.units import Unit, known_unit
from twin.robot.assembly.load import load_experiment
from twin.studies.build import linking
from twin.studies.build.layout import (
    CAUSALITY_BY_KIND,
    ExportedVariable,
    Layout,
    layout_of,
    sizes_header,
    tables_source,
)
from twin.studies.build.part import RobotPart, fixed_keys, open_parameters, part_of
from twin.studies.command import Answer

GENERATION_TOOL = "twin"
RESULTS_FOLDER = Path("results/build")


def model_description(
    fmi: str, name: str, guid: str, about: str, variables: Sequence[ExportedVariable], tick: float, duration: float
) -> bytes:
    """Format modelDescription.xml of an exported part as UTF-8, reproducible byte for byte.

    Args:
        guid: the GUID compiled into the binary.
        variables: scalars in FMI 2.0; the value reference is the index.
    """
    new = fmi == "3.0"
    root = ET.Element(
        "fmiModelDescription",
        {
            "fmiVersion": fmi, "modelName": name, "instantiationToken" if new else "guid": guid, "description": about,
            "generationTool": GENERATION_TOOL, "variableNamingConvention": "structured",
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


def _append_units(root: ET.Element, variables: Sequence[ExportedVariable], new: bool) -> None:
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


def _attributes(variable: ExportedVariable, reference: int) -> dict[str, str]:
    attributes = {
        "name": variable.name,
        "valueReference": str(reference),
        "causality": CAUSALITY_BY_KIND[variable.kind],
        "variability": {"parameter": "fixed", "tunable": "tunable"}.get(variable.kind, "continuous"),
        "description": variable.meaning,
    }
    return attributes | ({"initial": "calculated"} if variable.kind == "output" else {})


def _bounds(variable: ExportedVariable) -> dict[str, str]:
    above, at_least, below, at_most = variable.limits
    lower, upper = at_least if above is None else above, at_most if below is None else below
    return {name: repr(float(x)) for name, x in (("min", lower), ("max", upper)) if x is not None}


def _append_scalar(inside: ET.Element, variable: ExportedVariable, reference: int) -> None:
    scalar = ET.SubElement(inside, "ScalarVariable", _attributes(variable, reference))
    start = {} if variable.kind == "output" else {"start": repr(variable.start[0])}
    ET.SubElement(scalar, "Real", {"unit": variable.text} | _bounds(variable) | start)


def _append_array(inside: ET.Element, variable: ExportedVariable, reference: int) -> None:
    start = {} if variable.kind == "output" else {"start": " ".join(map(repr, variable.start))}
    attributes = _attributes(variable, reference) | {"unit": variable.text} | _bounds(variable) | start
    array = ET.SubElement(inside, "Float64", attributes)
    if len(variable.start) > 1:
        ET.SubElement(array, "Dimension", start=str(len(variable.start)))


def _append_structure(structure: ET.Element, variables: Sequence[ExportedVariable], new: bool) -> None:
    # outputs change only with a step, never with an input at the same instant; at the start they depend on everything
    outputs = [reference for reference, variable in enumerate(variables) if variable.kind == "output"]
    for tag, more in (("Output", {"dependencies": ""}), ("InitialUnknown", {})):
        unknowns = structure if new else ET.SubElement(structure, f"{tag}s")
        for reference in outputs:
            if new:
                ET.SubElement(unknowns, tag, {"valueReference": str(reference)} | more)
            else:
                ET.SubElement(unknowns, "Unknown", {"index": str(reference + 1)} | more)


def pack_fmu(
    part: RobotPart,
    layout: Layout,
    fmi: str,
    platforms: Sequence[linking.Platform],
    about: str,
    readme: str,
    wanted: Path,
    say: Callable[[str], None],
) -> bytes:
    """Compile and link an exported part for all platforms and return the bytes of the FMU."""
    steps = linking.emit_steps(layout, platforms, say)
    variables = layout.variables if fmi == "3.0" else layout.scalars()
    experiment = part.experiment
    tick, duration = experiment.cosim.tick, experiment.duration_ticks * experiment.cosim.tick

    def description(guid: str) -> bytes:
        return model_description(fmi, part.name, guid, about, variables, tick, duration)

    source = tables_source(layout, variables)
    front = f"fmi{fmi[0]}.c"
    ceremony = linking.c_files("part.h", "part.c", "instance.h", "instance.c", front)
    # hash only the steps for this platform: the others are compiled from the same modules
    guid = linking.guid_of(
        *(step.content for step in steps[linking.HOST_PLATFORM]), source.encode(), description(""), *ceremony.values()
    )
    files = ceremony | {"sizes.h": sizes_header(layout, variables, guid, tick).encode(), "tables.c": source.encode()}
    options = ("-DFMI3_OVERRIDE_FUNCTION_PREFIX", "-isystem", str(fmi_headers()))

    def library(platform: linking.Platform) -> bytes:
        return linking.shared_library(
            part.name, front, platform, files | linking.object_files(steps[platform]), options, wanted
        )

    libraries = linking.link_all(platforms, library, say)
    return zip_bytes(
        {
            "modelDescription.xml": description(guid),
            "documentation/README.md": readme.encode(),
            **_binaries(part.name, fmi, libraries),
        }
    )


def _binaries(name: str, fmi: str, libraries: dict[linking.Platform, bytes]) -> dict[str, bytes]:
    """Return an FMU's libraries by their paths in the archive; FMI 2.0 has one for all processors of macOS."""
    places: dict[str, dict[str, bytes]] = {}
    for platform, library in libraries.items():
        folder = platform.name if fmi == "3.0" else platform.fmi2
        places.setdefault(f"binaries/{folder}/{name}.{platform.suffix}", {})[platform.triple] = library
    return {place: next(iter(s.values())) if len(s) == 1 else linking.universal(s) for place, s in places.items()}


def build_fmu(
    experiment: Path,
    part: str,
    fmi: str,
    platforms: Sequence[str],
    out: Path | None,
    settings: Sequence[str],
    say: Callable[[str], None],
) -> Answer:
    """Write a part of the robot as a co-simulation FMU with native code; options as in `twin build`."""
    targets = linking.select_platforms(platforms, fmi)
    loaded = load_experiment(experiment, settings)
    file = out or RESULTS_FOLDER / loaded.name / f"{part}.fmu"
    if out is not None:
        refuse_unwritable(file)
    found = part_of(loaded, part)
    linking.refuse_platform(file, targets)
    offered = open_parameters(found)
    layout, closed = layout_of(found, offered), fixed_keys(found, offered)
    page = readme(found, layout, closed, targets)
    content = pack_fmu(found, layout, fmi, targets, part_description(found), page, file, say)
    if out is None:
        make_folder(file.parent)
    write_bytes(file, content)
    components = [component.name for component in found.components]
    inputs, outputs = _names(layout, "input"), _names(layout, "output")
    text = linking.summary(f"{found.name} of {loaded.name}, FMI {fmi} co-simulation, {len(content) / 1000:.0f} KB", {
        "runs on": linking.names_of(targets),
        "holds": ", ".join(components),
        "step": f"multiples of {1e3 * loaded.cosim.tick:g} ms",
        "inputs": ", ".join(inputs) or "none",
        "outputs": f"{len(outputs)}: {', '.join(outputs[:4])}{' ..' if len(outputs) > 4 else ''}",
        "open": f"{len(offered)} parameters, as the experiment's file calls them",
        "fixed": ", ".join(closed),
        "written": str(file),
    })  # fmt: skip
    return Answer(text, {
        "file": str(file),
        "part": found.name,
        "components": components,
        "fmi": fmi,
        "platforms": [target.name for target in targets],
        "bytes": len(content),
        "parameters": [parameter.key for parameter in offered],
        "fixed": closed,
        "inputs": inputs,
        "outputs": outputs,
    })  # fmt: skip


def part_description(part: RobotPart) -> str:
    """Return a description of an exported part and of the timing of its steps, in some sentences."""
    experiment = part.experiment
    names = ", ".join(component.name for component in part.components)
    sampled = [component.name for component in part.components if component.sampled]
    sentences = [
        f"{part.name} of {experiment.title}: {names}. Steps are multiples of {1e3 * experiment.cosim.tick:g} ms, "
        "inputs are held over a step."
    ]
    if sampled:
        them = ", ".join(sampled)
        sentences.append(
            f"Sampled at the start of a step and published at its end: {them}. A master that exchanges all values "
            "between steps (Jacobi) thereby adds a delay of one step; a master that steps this part first and passes "
            "its outputs on at once (Gauss-Seidel) adds no delay."
        )
    for number, fault in enumerate(experiment.faults, start=1):
        if part.component(f"fault_{number}"):
            sentences.append(f"fault_{number}: {fault.kind} of {fault.target}.")
    if part.component("controller") and experiment.controller.bus_delay_ticks:
        sentences.append(
            f"The delay of the bus, controller.bus_delay_ticks = {experiment.controller.bus_delay_ticks}, is not "
            "included; a Jacobi master itself adds one of these ticks."
        )
    return " ".join(sentences)


def _names(layout: Layout, kind: str) -> list[str]:
    return [variable.name for variable in layout.variables if variable.kind == kind]


def readme(part: RobotPart, layout: Layout, closed: Sequence[str], platforms: Sequence[linking.Platform]) -> str:
    rows = [
        f"| `{v.name}` | {v.kind} | {v.text} | {', '.join(f'{x:g}' for x in v.start) if v.kind != 'output' else ''} | "
        f"{v.meaning} |"
        for v in layout.variables
    ]
    return "\n".join(
        [
            f"# {part.name}",
            "",
            part_description(part),
            "",
            f"Native code for {linking.names_of(platforms)}; it needs only the C library with its mathematics.",
            "",
            "| variable | | unit | start | |",
            "|---|---|---|---|---|",
            *rows,
            "",
            "Fixed, because values were computed from these at build time: " + ", ".join(closed) + ".",
            "",
        ]
    )
