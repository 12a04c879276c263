"""SSP archives written by hand, as another tool would."""

import zipfile
from collections.abc import Iterable, Mapping
from pathlib import Path

SSP = "http://ssp-standard.org/SSP1"
NAMESPACES = (
    f'xmlns:ssd="{SSP}/SystemStructureDescription" xmlns:ssc="{SSP}/SystemStructureCommon" '
    f'xmlns:ssv="{SSP}/SystemStructureParameterValues" xmlns:ssm="{SSP}/SystemStructureParameterMapping"'
)


def connector(name: str, kind: str, unit: str = "", type_: str = "Real") -> str:
    stated = f' unit="{unit}"' if unit else ""
    return f'<ssd:Connector name="{name}" kind="{kind}"><ssc:{type_}{stated}/></ssd:Connector>'


def component(name: str, source: str, connectors: Iterable[str] = (), bindings: str = "", more: str = "") -> str:
    listed = "".join(connectors)
    return (
        f'<ssd:Component name="{name}" source="{source}" {more}>'
        f"{f'<ssd:Connectors>{listed}</ssd:Connectors>' if listed else ''}{bindings}</ssd:Component>"
    )


def connection(start: str, end: str, inside: str = "", more: str = "") -> str:
    """From "element.connector", or "connector" of the system, to another one; an element ends at the first dot."""
    said = ""
    for side, text in (("start", start), ("end", end)):
        element, dot, name = text.partition(".")
        said += f'{side}Element="{element}" {side}Connector="{name}" ' if dot else f'{side}Connector="{text}" '
    return f"<ssd:Connection {said}{more}>{inside}</ssd:Connection>"


def line(factor: float | str = 1.0, offset: float | str = 0.0) -> str:
    return f'<ssc:LinearTransformation factor="{factor!s}" offset="{offset!s}"/>'


def system(
    elements: Iterable[str], connections: Iterable[str] = (), connectors: Iterable[str] = (), bindings: str = "",
    name: str = "system",
) -> str:  # fmt: skip
    own, parts, wires = "".join(connectors), "".join(elements), "".join(connections)
    return (
        f'<ssd:System name="{name}">{f"<ssd:Connectors>{own}</ssd:Connectors>" if own else ""}{bindings}'
        f"<ssd:Elements>{parts}</ssd:Elements>"
        f"{f'<ssd:Connections>{wires}</ssd:Connections>' if wires else ''}</ssd:System>"
    )


def values(*parameters: str, prefix: str = "", mapping: str = "") -> str:
    """A binding with values inside: "name=value" or "name=value unit" each; a `mapping` has entries."""
    listed = ""
    for parameter in parameters:
        name, _, value = parameter.partition("=")
        number, _, unit = value.partition(" ")
        listed += f'<ssv:Parameter name="{name}"><ssv:Real value="{number}" unit="{unit}"/></ssv:Parameter>'
    entries = f'<ssm:ParameterMapping version="1.0">{mapping}</ssm:ParameterMapping>'
    return bindings(
        f'<ssd:ParameterBinding prefix="{prefix}"><ssd:ParameterValues><ssv:ParameterSet version="1.0" name="v">'
        f"<ssv:Parameters>{listed}</ssv:Parameters></ssv:ParameterSet></ssd:ParameterValues>"
        f"{f'<ssd:ParameterMapping>{entries}</ssd:ParameterMapping>' if mapping else ''}</ssd:ParameterBinding>"
    )


def bindings(*each: str) -> str:
    return f"<ssd:ParameterBindings>{''.join(each)}</ssd:ParameterBindings>"


def structure(
    whole: str, stop: float | None = None, units: str = "", head: str = "", version: str = "1.0", notes: str = ""
) -> str:
    end = f'<ssd:DefaultExperiment startTime="0.0" stopTime="{stop!r}"/>' if stop is not None else ""
    return (
        f'<?xml version="1.0" encoding="UTF-8"?>{head}<ssd:SystemStructureDescription {NAMESPACES} name="x" '
        f'version="{version}">{whole}{f"<ssd:Units>{units}</ssd:Units>" if units else ""}{end}{notes}'
        "</ssd:SystemStructureDescription>"
    )


def archive(file: Path, ssd: str | bytes, resources: Mapping[str, Path | str]) -> Path:
    """`file` with a structure, and resources by their entries: files, or texts."""
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as target:
        target.writestr("SystemStructure.ssd", ssd)
        for entry, content in resources.items():
            if isinstance(content, Path):
                target.write(content, entry)
            else:
                target.writestr(entry, content)
    return file
