"""The reference files of an FMU: manifest (FMI-LS-REF 1.0.0-alpha.1), parameters (SSV 1.0), experiment and results.

The results are FMPy's, with the FMU's binary for this platform: another importer than the one they are used to check.
"""

import tomllib
import xml.etree.ElementTree as ET
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from .archive import write_entries
from .drive import FMUS

HOME = "extra/org.fmi-standard.fmi-ls-ref/"
LS = "{http://fmi-standard.org/fmi-ls-manifest}"
SSV = "{http://ssp-standard.org/SSP1/SystemStructureParameterValues}"
VERSION = "1.0.0-alpha.1"
STOP, STEP, RAMP = 1.0, 0.001, 0.05
KEPT = 10
"""Of so many steps one stands in the results."""
KINDS = {"Float64": "Real", "Float32": "Real", "Int32": "Integer"}
FILES: tuple[tuple[str, ...], ...] = (
    ("parameters.ssv", "parameter", "application/x-ssp-parameter-set", "Every parameter in the reference experiment"),
    (
        "ramps.exp",
        "experiment/smoke-test",
        "application/x-ma-ls-experiments",
        "Ramps of the inputs, one after the other",
    ),
    ("ramps_in.csv", "other", "text/csv", "Inputs of the reference experiment, on lines between the rows"),
    ("ramps_ref.csv", "result", "text/csv", "Results of the reference experiment, by FMPy"),
)
"""Name, role, type and description of what is carried."""


def stated_references() -> dict[str, Any]:
    """What fmus/references.toml tells of each drive; one of which it tells nothing carries no reference files."""
    return tomllib.loads((FMUS / "references.toml").read_text(encoding="utf-8"))


def carry_references(name: str, target: Path) -> None:
    """Write the reference files of drive `name` into its FMU `target`, in place of those that it has.

    Nothing else of the FMU is changed; the same FMU and FMPy give the same bytes.

    Raises:
        KeyError: fmus/references.toml does not tell of this drive.
    """
    # what the drives are built with needs neither
    from fmpy import read_model_description, simulate_fmu

    stated = stated_references()[name]
    description = read_model_description(str(target), validate=False)
    set_ = stated.get("parameters", {})
    parameters = [(v, set_.get(v.name, v.start)) for v in description.modelVariables if v.causality == "parameter"]
    inputs = _ramps(stated["inputs"])
    names = stated.get("results") or [v.name for v in description.modelVariables if v.causality == "output"]
    done = simulate_fmu(
        str(target), stop_time=STOP, output_interval=STEP, step_size=STEP, input=inputs, output=names,
        start_values={v.name: value for v, value in parameters}, fmi_type="CoSimulation", validate=False,
    )  # fmt: skip
    carried = FILES if parameters else FILES[1:]
    files = {
        "fmi-ls-manifest.xml": _manifest(carried),
        **({"parameters.ssv": _parameter_set(parameters)} if parameters else {}),
        "ramps.exp": _experiments(carried),
        "ramps_in.csv": _csv(inputs),
        "ramps_ref.csv": _csv(done[::KEPT]),
    }
    with zipfile.ZipFile(target) as archive:
        rest = {entry: archive.read(entry) for entry in archive.namelist() if not entry.startswith(HOME)}
    write_entries(target, rest | {HOME + file: content for file, content in files.items()})


def _ramps(inputs: dict[str, list[float]]) -> np.ndarray:
    """Inputs over time as FMPy takes them: 0, then a ramp to the value."""
    times = sorted({0.0, STOP, *(t + later for _, t in inputs.values() for later in (0.0, RAMP))})
    table = np.zeros(len(times), dtype=[("time", float), *((name, float) for name in inputs)])
    table["time"] = times
    for name, (value, start) in inputs.items():
        table[name] = np.interp(times, [start, start + RAMP], [0.0, value])
    return table


def _csv(table: np.ndarray) -> bytes:
    rows = [",".join(f"{value:.9g}" for value in row.tolist()) for row in table]
    return ("\n".join([",".join(table.dtype.names or ()), *rows]) + "\n").encode()


def _manifest(carried: tuple[tuple[str, ...], ...]) -> bytes:
    about = "Layered Standard providing information on related files included in an FMU."
    named = {f"{LS}fmi-ls-name": HOME.split("/")[1], f"{LS}fmi-ls-version": VERSION, f"{LS}fmi-ls-description": about}
    root = ET.Element("fmiReferences", named)
    for file, role, type_, description in carried:
        ET.SubElement(root, "Related", type=type_, source=file, role=role, description=description)
    return _xml(root, "fmi-ls", LS)


def _parameter_set(parameters: list[tuple[Any, Any]]) -> bytes:
    root = ET.Element(f"{SSV}ParameterSet", version="1.0", name="reference experiment")
    listed = ET.SubElement(root, f"{SSV}Parameters")
    for variable, value in parameters:
        parameter = ET.SubElement(listed, f"{SSV}Parameter", name=variable.name)
        ET.SubElement(parameter, f"{SSV}{KINDS.get(variable.type, variable.type)}", value=str(value))
    return _xml(root, "ssv", SSV)


def _experiments(carried: tuple[tuple[str, ...], ...]) -> bytes:
    root = ET.Element("Experiments", name="smoke test", description="Whether an importer gets what FMPy got")
    times = {"startTime": "0.0", "stopTime": str(STOP), "stepSize": str(STEP)}
    experiment = ET.SubElement(root, "Experiment", name="ramps", **times)
    for element, file in (("Parameters", FILES[0]), ("Stimuli", FILES[2]), ("References", FILES[3])):
        if file in carried:
            ET.SubElement(experiment, element, source=file[0], type=file[2])
    return _xml(root)


def _xml(root: ET.Element, prefix: str = "", namespace: str = "") -> bytes:
    if prefix:
        ET.register_namespace(prefix, namespace[1:-1])
    ET.indent(root)
    content: bytes = ET.tostring(root, encoding="UTF-8", xml_declaration=True)
    return content + b"\n"
