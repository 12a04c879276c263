"""The XML side of drive.toml: modelDescription.xml of FMI 3.0 (sections 2.4 and 4.4)."""

import tomllib
import xml.etree.ElementTree as ET

from .drive import FMI2, Drive, Variable
from .model_description import STEP_SIZE


def model_description_fmi3(drive: Drive) -> bytes:
    """modelDescription.xml, UTF-8, the same bytes for the same drive.

    Raises:
        KeyError: a variable has a unit that fmi2/units.toml does not define.
    """
    root = ET.Element(
        "fmiModelDescription",
        fmiVersion="3.0",
        modelName=drive.name,
        instantiationToken=drive.guid,
        description=drive.description,
        variableNamingConvention="flat",
    )
    ET.SubElement(
        root,
        "CoSimulation",
        modelIdentifier=drive.name,
        canHandleVariableCommunicationStepSize="true",
        canGetAndSetFMUState="true",
        canSerializeFMUState="true",
        hasEventMode="false",
    )
    _append_units(root, drive)
    categories = ET.SubElement(root, "LogCategories")
    ET.SubElement(categories, "Category", name="logStatusError", description="Why a call was refused")
    ET.SubElement(root, "DefaultExperiment", startTime="0.0", stopTime="1.0", stepSize=repr(STEP_SIZE))
    variables = ET.SubElement(root, "ModelVariables")
    for reference, variable in enumerate(drive.variables):
        _append_variable(variables, variable, reference)
    ET.SubElement(
        variables,
        "Float64",
        name="time",
        valueReference=str(len(drive.variables)),
        causality="independent",
        variability="continuous",
        description="Communication point reached",
        unit="s",
    )
    # An output moves only with a step, never with an input at the same instant: no dependencies at all.
    # Every output starts from an exact value, so there are no initial unknowns to list.
    structure = ET.SubElement(root, "ModelStructure")
    for reference, variable in enumerate(drive.variables):
        if variable.causality == "output":
            ET.SubElement(structure, "Output", valueReference=str(reference), dependencies="")
    ET.indent(root)
    return ET.tostring(root, encoding="UTF-8", xml_declaration=True) + b"\n"


def _append_units(root: ET.Element, drive: Drive) -> None:
    # units are defined by the same powers of the same base units in both versions
    exponents = tomllib.loads((FMI2 / "units.toml").read_text(encoding="utf-8"))
    definitions = ET.SubElement(root, "UnitDefinitions")
    for name in sorted({variable.unit for variable in drive.variables if variable.unit} | {"s"}):
        unit = ET.SubElement(definitions, "Unit", name=name)
        ET.SubElement(unit, "BaseUnit", {base: str(power) for base, power in exponents[name].items()})


def _append_variable(variables: ET.Element, variable: Variable, reference: int) -> None:
    element = ET.SubElement(
        variables,
        variable.type,
        name=variable.name,
        valueReference=str(reference),
        causality=variable.causality,
        variability=variable.variability,
        description=variable.description,
        start=_text(variable.start, variable.type),
    )
    for attribute in ("initial", "unit"):
        value = getattr(variable, attribute)
        if value is not None:
            element.set(attribute, value)
    for attribute, bound in variable.stated_bounds.items():
        element.set(attribute, _text(bound, variable.type))


def _text(value: float, kind: str) -> str:
    """`value` as XML Schema writes the type."""
    if kind == "Boolean":
        return "true" if value else "false"
    return str(int(value)) if kind == "Int32" else repr(float(value))
