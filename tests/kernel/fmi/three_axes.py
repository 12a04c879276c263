"""A drive with three axes in one FMI 3.0 FMU, compiled from three_axes.c."""

from pathlib import Path

from tests.kernel.fmi.archives import DESCRIPTION, altered
from tests.kernel.fmi.compiled import ACCESS, compiled_library

VARIABLES = """
#define GUID "{three-axes}"
#define N_VARIABLES 12
typedef union {
    struct { double omega_ref[3], tau_load[3], theta_m[3], omega_m[3]; };
    double at[12];
} Variables;
"""


def description(size: int = 3) -> str:
    """modelDescription.xml; the commands are arrays of `size`."""

    def array(name: str, reference: int, causality: str, unit: str, size: int = 3) -> str:
        start = " ".join(["0.0"] * size)
        initial = ' initial="exact"' if causality == "output" else ""
        return (
            f'<Float64 name="{name}" valueReference="{reference}" causality="{causality}" variability="continuous"'
            f'{initial} start="{start}" unit="{unit}"><Dimension start="{size}"/></Float64>'
        )

    return f"""<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="3.0" modelName="three_axes" instantiationToken="{{three-axes}}">
  <CoSimulation modelIdentifier="torque_motor_fmi3"/>
  <UnitDefinitions>
    <Unit name="rad"><BaseUnit rad="1"/></Unit>
    <Unit name="rad/s"><BaseUnit rad="1" s="-1"/></Unit>
    <Unit name="N.m"><BaseUnit kg="1" m="2" s="-2"/></Unit>
  </UnitDefinitions>
  <ModelVariables>
    {array("omega_ref", 0, "input", "rad/s", size)}
    {array("tau_load", 1, "input", "N.m")}
    {array("theta_m", 2, "output", "rad")}
    {array("omega_m", 3, "output", "rad/s")}
  </ModelVariables>
  <ModelStructure><Output valueReference="2"/><Output valueReference="3"/></ModelStructure>
</fmiModelDescription>
"""


def three_axes_drive(root: Path, folder: Path, size: int = 3) -> Path:
    """`folder`/three_axes.fmu."""
    good = root / "fmus" / "torque_motor_fmi3" / "torque_motor_fmi3.fmu"
    replaced = {
        "model.c": Path(__file__).with_name("three_axes.c").read_text(),
        "variables.h": VARIABLES,
        "access.c": ACCESS,
        "variables.c": "",
    }
    library = compiled_library(good, folder / "three_axes.build", replaced)

    def change(name: str, content: bytes) -> tuple[str, bytes] | None:
        if name == DESCRIPTION:
            return name, description(size).encode()
        return (name, library) if name == "binaries/x86_64-linux/torque_motor_fmi3.so" else None

    return altered(good, folder / "three_axes.fmu", change)
