"""Three copies of an FMU with one input and one output, wired as a controller: each holds the torque of its joint.

python examples/three_copies.py pi.fmu u y three.ssp 0.046 0.081 0.081
twin component check controller three.ssp --set 'controller.inputs.tau_l=["tau_1", "tau_2", "tau_3"]' \
    --set 'controller.outputs.omega_ref=["omega_1", "omega_2", "omega_3"]'

The FMU gets target (N m) less torque, and gives the motor's speed (rad/s). The names u and y are its own.
"""

import sys
import zipfile
from collections.abc import Sequence
from pathlib import Path

HEAD = """<?xml version="1.0" encoding="UTF-8"?>
<ssd:SystemStructureDescription xmlns:ssd="http://ssp-standard.org/SSP1/SystemStructureDescription"
    xmlns:ssc="http://ssp-standard.org/SSP1/SystemStructureCommon" name="three_copies" version="1.0">
"""


def structure(fmu: str, u: str, y: str, targets: Sequence[float]) -> str:
    """SystemStructure.ssd: torques tau_1 .. in, speeds omega_1 .. out, a copy of `fmu` between."""
    ends, copies, wires = "", "", ""
    for n, target in enumerate(targets, start=1):
        for kind, name, unit in (("input", "tau", "N.m"), ("output", "omega", "rad/s")):
            ends += f'<ssd:Connector name="{name}_{n}" kind="{kind}"><ssc:Real unit="{unit}"/></ssd:Connector>\n'
        copies += f'<ssd:Component name="pi_{n}" source="resources/{fmu}"/>\n'
        wires += (
            f'<ssd:Connection startConnector="tau_{n}" endElement="pi_{n}" endConnector="{u}">'
            f'<ssc:LinearTransformation factor="-1" offset="{target!r}"/></ssd:Connection>\n'
            f'<ssd:Connection startElement="pi_{n}" startConnector="{y}" endConnector="omega_{n}"/>\n'
        )
    return (
        f'{HEAD}<ssd:System name="three_copies">\n<ssd:Connectors>\n{ends}</ssd:Connectors>\n<ssd:Elements>\n{copies}'
        f"</ssd:Elements>\n<ssd:Connections>\n{wires}</ssd:Connections>\n</ssd:System>\n"
        "</ssd:SystemStructureDescription>\n"
    )


def write_archive(fmu: Path, u: str, y: str, file: Path, targets: Sequence[float]) -> None:
    """The SSP `file`."""
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("SystemStructure.ssd", structure(fmu.name, u, y, targets))
        archive.write(fmu, f"resources/{fmu.name}")


if __name__ == "__main__":
    fmu, u, y, file, *targets = sys.argv[1:]
    write_archive(Path(fmu), u, y, Path(file), [float(text) for text in targets])
