"""An FMI 1.0 drive, compiled from first.c."""

import zipfile
from pathlib import Path

from tests.kernel.fmi.compiled import compiled_library


def first_description(abilities: str = "", kind: str = "CoSimulation_StandAlone", guid: str = "{first}") -> str:
    """modelDescription.xml with these attributes of its capabilities."""

    def variable(name: str, reference: int, causality: str, said: str, variability: str = "continuous") -> str:
        return (
            f'<ScalarVariable name="{name}" valueReference="{reference}" variability="{variability}" '
            f'causality="{causality}">{said}</ScalarVariable>'
        )

    return f"""<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="1.0" modelName="first" modelIdentifier="first" guid="{guid}"
  numberOfContinuousStates="0" numberOfEventIndicators="0">
  <UnitDefinitions><BaseUnit unit="rad/s"/></UnitDefinitions>
  <ModelVariables>
    {variable("omega_ref", 0, "input", '<Real unit="rad/s" start="0.0"/>')}
    {variable("tau_load", 1, "input", '<Real unit="N.m" start="0.0"/>')}
    {variable("theta_m", 2, "output", '<Real unit="rad"/>')}
    {variable("omega_m", 3, "output", '<Real unit="rad/s"/>')}
    {variable("longest", 4, "internal", '<Real start="1.0"/>', "parameter")}
    {variable("enable", 0, "input", '<Boolean start="true"/>', "discrete")}
  </ModelVariables>
  <Implementation><{kind}><Capabilities {abilities}/></{kind}></Implementation>
</fmiModelDescription>
"""


def first_library(root: Path, folder: Path) -> bytes:
    """The binary."""
    good = root / "fmus" / "velocity_servo" / "velocity_servo.fmu"
    sources = ("access", "fmu_state", "lifecycle", "not_offered", "model", "variables")
    replaced = dict.fromkeys((f"{name}.c" for name in sources), "")
    code = Path(__file__).with_name("first.c").read_text()
    return compiled_library(good, folder / "first.build", replaced | {"first.c": code})


def first_drive(library: bytes, file: Path, description: str) -> Path:
    """`file` with the binary `library`."""
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("modelDescription.xml", description)
        archive.writestr("binaries/linux64/first.so", library)
    return file
