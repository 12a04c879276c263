"""FMUs of odd.c: variables of every kind, functions that return any integer, outputs that are NaN."""

import os
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from tempfile import mkdtemp

import pytest

SOURCE = Path(__file__).with_name("odd.c")
FMI2 = ("Real", "Integer", "Boolean", "Enumeration")
FMI3 = (
    "Float64", "Float32", "Int8", "UInt8", "Int16", "UInt16", "Int32", "UInt32", "Int64", "UInt64", "Boolean",
)  # fmt: skip
RANGES = {
    "Integer": (-(2**31), 2**31 - 1),
    "Enumeration": (1, 3),
    **{f"Int{n}": (-(2 ** (n - 1)), 2 ** (n - 1) - 1) for n in (8, 16, 32)},
    **{f"UInt{n}": (0, 2**n - 1) for n in (8, 16, 32)},
    "Int64": (-(2**53), 2**53),
    "UInt64": (0, 2**53),
}
"""Smallest and largest whole number that a signal of the type can have."""


@cache
def odd_library() -> bytes:
    """The binary; skips without a compiler, but not on CI, which has one."""
    compiler = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    if compiler is None or not sys.platform.startswith("linux"):
        assert "CI" not in os.environ, "this test compiles an FMU and CI has to have a C compiler"
        pytest.skip("compiles an FMU: needs Linux and a C compiler")
    library = Path(mkdtemp()) / "odd.so"
    subprocess.run([compiler, "-shared", "-fPIC", "-O1", "-w", str(SOURCE), "-o", str(library), "-lm"], check=True)
    content = library.read_bytes()
    shutil.rmtree(library.parent)
    return content


def odd_fmu(
    file: Path,
    odd: str = "",
    types: Iterable[str] = ("Real",),
    kind: str = "CoSimulation",
    more: str = "",
    abilities: str = "",
    root: str = "",
) -> Path:
    """`file` with an input `in_TYPE`, and an output `out_TYPE` that is the same, of each type.

    Args:
        odd: its GUID, see odd.c.
        types: of FMI 2.0 or of FMI 3.0.
        kind: element of what it is used as.
        more: elements of further variables.
        abilities: more attributes of that element.
        root: more attributes of the whole.
    """
    types = list(types)
    is_2 = all(one in FMI2 for one in types)
    variables, outputs = [], []
    for k, one in enumerate(types):
        for side, causality, reference in (("in", "input", k), ("out", "output", 32 + k)):
            real = one in ("Real", "Float64", "Float32")
            varies = "continuous" if real else "discrete"
            start = "" if side == "out" else ' start="true"' if one == "Boolean" else ' start="1"'
            common = f'name="{side}_{one}" valueReference="{reference}" causality="{causality}" variability="{varies}"'
            declared = ' declaredType="M"' if one == "Enumeration" else ""
            if is_2:
                variables.append(f"<ScalarVariable {common}><{one}{declared}{start}/></ScalarVariable>")
            else:
                variables.append(f"<{one} {common}{start}/>")
        outputs.append(f'<Unknown index="{2 * k + 2}"/>' if is_2 else f'<Output valueReference="{32 + k}"/>')
    variables.append(more)
    can = "FMUstate" if is_2 else "FMUState"
    element = (
        f'<{kind} modelIdentifier="odd" canGetAndSet{can}="true" canSerialize{can}="true" {abilities} '
        f"{'canHandleVariableCommunicationStepSize=' + chr(34) + 'true' + chr(34) if kind == 'CoSimulation' else ''}/>"
    )
    guid = f'guid="{odd}"' if is_2 else f'instantiationToken="{odd}"'
    items = "".join(f'<Item name="{name}" value="{n}"/>' for n, name in enumerate(("one", "two", "three"), start=1))
    listed = f"<Outputs>{''.join(outputs)}</Outputs>" if is_2 else "".join(outputs)
    states = kind == "ModelExchange"
    if states:
        variables += [
            '<ScalarVariable name="x" valueReference="30" causality="local"><Real/></ScalarVariable>',
            f'<ScalarVariable name="dx" valueReference="31" causality="local"><Real derivative="{len(types) * 2 + 1}"/>'
            "</ScalarVariable>",
        ]
        listed += f'<Derivatives><Unknown index="{len(types) * 2 + 2}"/></Derivatives>'
    indicators = f'numberOfEventIndicators="{int(states)}"' if is_2 else ""
    types_text = (
        f'<TypeDefinitions><SimpleType name="M"><Enumeration>{items}</Enumeration></SimpleType></TypeDefinitions>'
    )
    description = (
        f'<?xml version="1.0" encoding="UTF-8"?><fmiModelDescription fmiVersion="{"2.0" if is_2 else "3.0"}" '
        f'modelName="odd" {guid} {indicators} {root}>{element}{types_text if is_2 else ""}'
        f'<DefaultExperiment startTime="0" stopTime="0.5" stepSize="0.1"/>'
        f"<ModelVariables>{''.join(variables)}</ModelVariables><ModelStructure>{listed}</ModelStructure>"
        "</fmiModelDescription>"
    )
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("modelDescription.xml", description)
        archive.writestr(f"binaries/{'linux64' if is_2 else 'x86_64-linux'}/odd.so", odd_library())
    return file
