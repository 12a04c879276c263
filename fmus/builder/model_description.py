"""The XML side of drive.toml: modelDescription.xml of FMI 2.0 (sections 2.2 and 4.3)."""

import tomllib
import xml.etree.ElementTree as ET

from .drive import FMI2, Drive, Variable

# the co-simulation tick of the robot; any other step is as good (canHandleVariableCommunicationStepSize)
STEP_SIZE = 0.001


def model_description(drive: Drive) -> bytes:
    """modelDescription.xml, UTF-8, the same bytes for the same drive.

    Raises:
        KeyError: a variable has a unit that fmi2/units.toml does not define.
    """
    root = ET.Element(
        "fmiModelDescription",
        fmiVersion="2.0",
        modelName=drive.name,
        guid=drive.guid,
        description=drive.description,
        variableNamingConvention="flat",
    )
    ET.SubElement(
        root,
        "CoSimulation",
        modelIdentifier=drive.name,
        canHandleVariableCommunicationStepSize="true",
        canNotUseMemoryManagementFunctions="true",
        canGetAndSetFMUstate="true",
        canSerializeFMUstate="true",
    )
    _append_units(root, drive)
    categories = ET.SubElement(root, "LogCategories")
    ET.SubElement(categories, "Category", name="logStatusError", description="Why a call was refused")
    ET.SubElement(root, "DefaultExperiment", startTime="0.0", stopTime="1.0", stepSize=repr(STEP_SIZE))
    variables = ET.SubElement(root, "ModelVariables")
    for reference, variable in enumerate(drive.variables):
        _append_variable(variables, variable, reference)
    _append_structure(root, drive)
    ET.indent(root)
    return ET.tostring(root, encoding="UTF-8", xml_declaration=True) + b"\n"


def _append_units(root: ET.Element, drive: Drive) -> None:
    exponents = tomllib.loads((FMI2 / "units.toml").read_text(encoding="utf-8")) | drive.units
    definitions = ET.SubElement(root, "UnitDefinitions")
    for name in sorted({variable.unit for variable in drive.variables if variable.unit}):
        unit = ET.SubElement(definitions, "Unit", name=name)
        ET.SubElement(unit, "BaseUnit", {base: str(power) for base, power in exponents[name].items()})


def _append_variable(variables: ET.Element, variable: Variable, reference: int) -> None:
    scalar = ET.SubElement(
        variables,
        "ScalarVariable",
        name=variable.name,
        valueReference=str(reference),
        causality=variable.causality,
        variability=variable.variability,
        description=variable.description,
    )
    if variable.initial is not None:
        scalar.set("initial", variable.initial)
    real = ET.SubElement(scalar, "Real", start=repr(float(variable.start)), unit=variable.unit)
    for attribute, bound in variable.stated_bounds.items():
        real.set(attribute, repr(bound))


def _append_structure(root: ET.Element, drive: Drive) -> None:
    # An output moves only with a step, never with an input at the same instant: no dependencies at all.
    # Every output starts from an exact value, so there are no initial unknowns to list.
    outputs = ET.SubElement(ET.SubElement(root, "ModelStructure"), "Outputs")
    for index, variable in enumerate(drive.variables, start=1):
        if variable.causality == "output":
            ET.SubElement(outputs, "Unknown", index=str(index), dependencies="")
