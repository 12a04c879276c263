"""Drives with events, clocks and tricks, all with the binary compiled from eventful.c; what they do is said there."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tests.kernel.fmi.archives import DESCRIPTION, altered
from tests.kernel.fmi.compiled import ACCESS, Edit, compiled_library

KINDS = {
    "follows": 0, "flips": 1, "bounces": 2, "samples": 3, "switches": 4, "discards": 5,
    "endless": 10, "stuck": 11, "no_time": 12, "before": 13, "beyond": 14, "past": 15, "no_event_time": 16,
    "crumbles": 17, "refuses": 18, "ends": 19, "endless_later": 20, "locked_out": 21, "locked_in": 22,
}  # fmt: skip

OFFERED = (
    "SetClock", "GetClock", "GetIntervalDecimal", "GetShiftDecimal", "SetIntervalDecimal", "EnterEventMode",
    "EnterStepMode", "UpdateDiscreteStates", "EnterConfigurationMode", "ExitConfigurationMode", "SetBinary",
)  # fmt: skip
TYPES = ("String", "UInt64")

VARIABLES = """
#define GUID "{eventful}"
#define N_VARIABLES 14
typedef union { double at[14]; double theta_m, omega_m; } Variables;
"""

PERIODIC = '<Clock name="beat" valueReference="20" causality="input" {rhythm}/>'


Maker = Callable[..., Path]


def maker(root: Path, folder: Path) -> Maker:
    """Makes drives of one binary, which it compiles first; arguments as of `eventful_drive`."""
    library = eventful_library(root, folder)
    known: dict[Any, Path] = {}

    def make(*said: str, **more: str) -> Path:
        key = (said, *more.items())
        if key not in known:
            known[key] = eventful_drive(root, library, folder / f"shaft_{len(known)}.fmu", *said, **more)
        return known[key]

    return make


def _not_offered(text: str) -> str:
    """not_offered.c without what eventful.c offers."""
    for name in OFFERED:
        text, count = re.subn(rf"REFUSE(_PLAIN)?\(fmi3{name},[^;{{}}]*?\)\n(?=\n|R|#)", "", text, count=1, flags=re.S)
        assert count == 1, name
    for name in TYPES:
        other = "fmi3SetString" if name == "String" else "fmi3SetUInt64"
        verb = f'REFUSE(fmi3Get{name}, "no variable has this type", REFERENCES, fmi3{name} values[], size_t n_values)'
        assert f"REFUSE_TYPE({name})" in text and other
        text = text.replace(f"REFUSE_TYPE({name})", verb)
    return text


def eventful_library(root: Path, folder: Path) -> bytes:
    """The binary."""
    good = root / "fmus" / "torque_motor_fmi3" / "torque_motor_fmi3.fmu"
    replaced: dict[str, str | Edit] = {
        "lifecycle.c": Path(__file__).with_name("eventful.c").read_text(),
        "not_offered.c": _not_offered,
        "variables.h": VARIABLES,
        "access.c": ACCESS,
        **dict.fromkeys(("model.c", "variables.c"), ""),
    }
    return compiled_library(good, folder / "eventful.build", replaced)


def eventful_drive(
    root: Path,
    library: bytes,
    file: Path,
    abilities: str = "",
    clocks: str = "",
    omega_ref: str = "",
    more: str = "",
) -> Path:
    """`file` with the binary `library`.

    Args:
        abilities: attributes of its co-simulation.
        clocks: elements of its clocks.
        omega_ref: attributes of its command.
        more: elements of further variables.
    """
    description = f"""<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="3.0" modelName="eventful" instantiationToken="{{eventful}}">
  <CoSimulation modelIdentifier="torque_motor_fmi3" canGetAndSetFMUState="true" {abilities}/>
  <UnitDefinitions>
    <Unit name="rad"><BaseUnit rad="1"/></Unit>
    <Unit name="rad/s"><BaseUnit rad="1" s="-1"/></Unit>
    <Unit name="N.m"><BaseUnit kg="1" m="2" s="-2"/></Unit>
  </UnitDefinitions>
  <ModelVariables>
    <Float64 name="omega_ref" valueReference="0" causality="input" start="0.0" unit="rad/s" {omega_ref}/>
    <Float64 name="tau_load" valueReference="1" causality="input" start="0.0" unit="N.m"/>
    <Float64 name="theta_m" valueReference="2" causality="output" unit="rad"/>
    <Float64 name="omega_m" valueReference="3" causality="output" unit="rad/s"/>
    <Float64 name="kind" valueReference="4" causality="parameter" variability="fixed" start="0.0"/>
    <Float64 name="period" valueReference="5" causality="parameter" variability="fixed" start="1.0"/>
    <Float64 name="stop" valueReference="6" causality="parameter" variability="fixed" start="1.0"/>
    {clocks}{more}
  </ModelVariables>
  <ModelStructure><Output valueReference="2"/><Output valueReference="3"/></ModelStructure>
</fmiModelDescription>
"""

    def change(name: str, content: bytes) -> tuple[str, bytes] | None:
        if name == DESCRIPTION:
            return name, description.encode()
        return (name, library) if name == "binaries/x86_64-linux/torque_motor_fmi3.so" else None

    return altered(root / "fmus" / "torque_motor_fmi3" / "torque_motor_fmi3.fmu", file, change)
