"""Reader of OspSystemStructure.xml (Open Simulation Platform, schema 0.1), the format of libcosim.

libcosim steps all simulators at once and exchanges values between steps, without unit conversion: Jacobi.
"""

import os
import xml.etree.ElementTree as ET
from pathlib import Path
from urllib.parse import unquote, urlparse

from twin.kernel.errors import InputRefused
from twin.kernel.files import parse_xml, read_bytes
from twin.kernel.fmi.description import described
from twin.kernel.ssp import structure as ssp
from twin.kernel.ssp.package import MAX_STRUCTURE_SIZE, Package
from twin.kernel.ssp.ssd import values_of
from twin.kernel.systems.foreign import foreign_package
from twin.kernel.systems.timing import step_notes

FORM_NAME = "OSP system structure"
OSP_FILE = "OspSystemStructure.xml"
STEP_ANNOTATION = "com.opensimulationplatform"
UNSUPPORTED_ELEMENTS = {
    "Sum": "a sum of signals",
    "VectorSum": "a sum of signals",
    "VariableGroupConnection": "a connection of groups, which other files define",
    "SignalGroupConnection": "a connection of groups, which other files define",
}


def osp_system(file: Path) -> Package:
    """Read the system of an OSP file, OspSystemStructure.xml; FMU sources are relative to the file."""
    where = f"{file}"
    root = parse_xml(read_bytes(file, MAX_STRUCTURE_SIZE), where)
    if ssp.local_name(root) != "OspSystemStructure":
        raise InputRefused(f"{where}: <{ssp.local_name(root)}>; expected <OspSystemStructure>")
    simulators = ssp.grouped_children(root, "Simulators", "Simulator")
    ssp.require_unique((ssp.required_attribute(one, "name", where) for one in simulators), "simulators", where)
    files = {one.get("name", ""): _source(file, ssp.required_attribute(one, "source", where)) for one in simulators}
    parts = tuple(
        ssp.SspComponent(
            name, "", annotations=step_notes(STEP_ANNOTATION, ssp.number_attribute(one, "stepSize", where, 0.0))
        )
        for name, one in zip(files, simulators, strict=True)
    )
    system = ssp.SspSystem(file.parent.name or "system", parts, tuple(_Wiring(root, files, where).connections()))
    start, stop, step = (_number(root, name, where) for name in ("StartTime", "EndTime", "BaseStepSize"))
    structure = ssp.Structure(
        system.name, system, "0.1", experiment=ssp.DefaultExperiment(start, stop, step_notes(STEP_ANNOTATION, step))
    )
    algorithm = next((one.text or "" for one in ssp.child_elements(root, "Algorithm")), "fixedStep").strip()
    unsaid = [f"algorithm {algorithm}; steps of one length instead"] if algorithm != "fixedStep" else []
    bonds = [one for one in ssp.grouped_children(root, "Connections", "VariableConnection") if one.get("powerBond")]
    unsaid += ["power bonds, whose connections are taken one by one"] if bonds else []
    values = {name: _values(name, one, where) for name, one in zip(files, simulators, strict=True)}
    return foreign_package(file, FORM_NAME, structure, files, values, unsaid)


def _source(file: Path, source: str) -> Path:
    try:
        url = urlparse(source)
    except ValueError as problem:
        raise InputRefused(
            f"{file}: source '{source}' is not a URI: {problem}; expected an FMU on this machine"
        ) from None
    # the drive letter of a Windows path is parsed as a scheme
    if url.scheme not in ("", "file") and len(url.scheme) > 1:
        raise InputRefused(f"{file}: source '{source}' is not a file; expected an FMU on this machine")
    path = (file.parent / unquote(url.path)) if url.scheme in ("", "file") else Path(source)
    # unlike Path.is_file, os.path.isfile does not raise for a name that is too long
    if not os.path.isfile(path):
        raise InputRefused(f"{file}: source '{source}': no such FMU at {path}")
    return path


def _values(name: str, element: ET.Element, where: str) -> list[ssp.ParameterValue]:
    values = []
    for one in ssp.grouped_children(element, "InitialValues", "InitialValue"):
        variable = ssp.required_attribute(one, "variable", f"{where}: {name}")
        if len(one) != 1:
            raise InputRefused(f"{where}: {name}.{variable}: expected one value")
        kind, place = ssp.local_name(one[0]), f"{where}: {name}.{variable}"
        if kind not in ("Real", "Integer", "Boolean", "String"):
            raise InputRefused(f"{place}: a value of type {kind}; expected Real, Integer, Boolean or String")
        values.append(ssp.ParameterValue(variable, kind, values_of(one[0], kind, place)))
    ssp.require_unique((value.name for value in values), f"values of '{name}'", where)
    return values


def _number(root: ET.Element, name: str, where: str) -> float | None:
    found = ssp.child_elements(root, name)
    return ssp.parse_finite((found[0].text or "").strip(), f"{where}: <{name}>") if found else None


class _Wiring:
    """Collector of the connections in an OSP system; two through a linear transformation become one."""

    def __init__(self, root: ET.Element, files: dict[str, Path], where: str):
        self._files, self._where = files, where
        self._elements = [one for group in ssp.child_elements(root, "Connections") for one in group]
        functions = [one for group in ssp.child_elements(root, "Functions") for one in group]
        for one in (*functions, *self._elements):
            if ssp.local_name(one) in UNSUPPORTED_ELEMENTS:
                raise InputRefused(
                    f"{where}: <{ssp.local_name(one)}>{' ' + one.get('name', '') if one.get('name') else ''}: "
                    f"{UNSUPPORTED_ELEMENTS[ssp.local_name(one)]}, which is not supported; connect variables one by one"
                )
        self._lines = {
            ssp.required_attribute(one, "name", where): ssp.Transformation(
                ssp.number_attribute(one, "factor", where, 1.0), ssp.number_attribute(one, "offset", where, 0.0)
            )
            for one in functions
        }

    def connections(self) -> list[ssp.Connection]:
        found, into, out = [], dict[str, ssp.Endpoint](), list[tuple[str, ssp.Endpoint]]()
        for one in self._elements:
            if ssp.local_name(one) == "SignalConnection":
                signal, variable = ssp.child_elements(one, "Signal"), ssp.child_elements(one, "Variable")
                if len(signal) != 1 or len(variable) != 1:
                    raise InputRefused(f"{self._where}: a signal connection without one signal and one variable")
                function, end = ssp.required_attribute(signal[0], "function", self._where), self._end(variable[0])
                if function not in self._lines:
                    raise InputRefused(f"{self._where}: no function '{function}'")
                if signal[0].get("name") == "in":
                    into[function] = end
                else:
                    out.append((function, end))
            else:
                ends = [self._end(each) for each in ssp.child_elements(one, "Variable")]
                if len(ends) != 2:
                    raise InputRefused(f"{self._where}: a connection with {len(ends)} variables; expected 2")
                found.append(self._orient(ends[0], ends[1]))
        for function, end in out:
            if function not in into:
                raise InputRefused(f"{self._where}: nothing gets into the function '{function}'")
            found.append(ssp.Connection(into[function], end, self._lines[function]))
        return found

    def _end(self, element: ET.Element) -> ssp.Endpoint:
        return ssp.Endpoint(
            ssp.required_attribute(element, "simulator", self._where),
            ssp.required_attribute(element, "name", self._where),
        )

    def _orient(self, first: ssp.Endpoint, second: ssp.Endpoint) -> ssp.Connection:
        """Orient an OSP connection so that it ends at the variable that is an input."""
        if self._is_input(first) and not self._is_input(second):
            first, second = second, first
        return ssp.Connection(first, second)

    def _is_input(self, end: ssp.Endpoint) -> bool:
        if end.element not in self._files:
            raise InputRefused(f"{self._where}: no simulator '{end.element}'; it has {', '.join(self._files)}")
        variable = described(self._files[end.element], lenient=True).variables.get(end.connector)
        return variable is not None and variable.causality == "input"
