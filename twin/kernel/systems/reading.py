"""Reading of systems from any supported file; the format is recognised by the file name."""

import os
from pathlib import Path

from twin.kernel.errors import InputRefused
from twin.kernel.fmi.description import described
from twin.kernel.ssp.package import Package, loose_package, read_package
from twin.kernel.ssp.structure import SspComponent, SspSystem, Structure
from twin.kernel.systems.multi_model import multi_model
from twin.kernel.systems.naming import SINGLE_FORM, identifier
from twin.kernel.systems.osp import OSP_FILE, osp_system

EXPECTED_FILES = "an SSP archive, an FMU, an OspSystemStructure.xml or a multi-model (JSON)"


def read_system(file: Path) -> Package:
    """Read a system from an SSP archive, an FMU, an OspSystemStructure.xml (or its folder) or a Maestro multi-model."""
    if os.path.isdir(file) and os.path.isfile(file / OSP_FILE):
        file = file / OSP_FILE
    # unlike Path.is_file, os.path.isfile does not raise for a name that is too long
    if not os.path.isfile(file):
        raise InputRefused(f"{file}: no such file; expected {EXPECTED_FILES}")
    kind = file.suffix.lower()
    if kind == ".fmu":
        return single_fmu(file)
    if kind == ".xml":
        return osp_system(file)
    return multi_model(file) if kind == ".json" else read_package(file)


def single_fmu(file: Path) -> Package:
    """Make a package of a system with one FMU, named after its file."""
    name = identifier(file.stem)
    structure = Structure(
        name,
        SspSystem(name, (SspComponent(name, file.name),)),
        version=described(file, lenient=True).model.fmiVersion,
    )
    return loose_package(file, structure, {file.name: file}, SINGLE_FORM)
