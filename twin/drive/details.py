"""What FMPy leaves out of a model description.

Capabilities of FMI 1.0; clocks, intermediate inputs and the range of unsigned numbers of FMI 3.0.
"""

import zipfile
from pathlib import Path
from typing import Any

from twin.files import xml_of

DESCRIPTION = "modelDescription.xml"
NUMBERS = ("intervalDecimal", "shiftDecimal", "intervalCounter", "shiftCounter", "resolution")
"""Of a Clock (FMI 3.0.2, 2.2.9)."""


def complete(model: Any, file: Path) -> None:
    """Fill in what FMPy has fields for and does not read of the `file` that it made `model` of."""
    if model.fmiVersion != "1.0" and not model.fmiVersion.startswith("3."):
        return
    with zipfile.ZipFile(file) as archive:
        root = xml_of(archive.read(DESCRIPTION), f"{file}: {DESCRIPTION}")
    if model.fmiVersion == "1.0":
        _capabilities(model, root)
    else:
        by_name = {element.get("name"): element for element in root.iterfind("ModelVariables/*")}
        for variable in model.modelVariables:
            # FMPy makes a variable of each alias
            element = by_name[variable.alias.name if variable.alias else variable.name]
            variable.intermediateUpdate = _true(element.get("intermediateUpdate"))
            variable.min, variable.max = variable.min or element.get("min"), variable.max or element.get("max")
            for name in NUMBERS if variable.type == "Clock" else ():
                setattr(variable, name, element.get(name))


def _capabilities(model: Any, root: Any) -> None:
    """FMI 1.0 for Co-Simulation, 4.3.1."""
    if model.coSimulation is None:
        return
    model.coSimulation.needsExecutionTool = root.find("Implementation/CoSimulation_Tool") is not None
    for stated in root.iterfind("Implementation/*/Capabilities"):
        for name in (
            "canHandleVariableCommunicationStepSize", "canInterpolateInputs", "canBeInstantiatedOnlyOncePerProcess",
        ):  # fmt: skip
            setattr(model.coSimulation, name, _true(stated.get(name)))


def _true(text: str | None) -> bool:
    return text in ("true", "1")
