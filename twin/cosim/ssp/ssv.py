"""Parameter files, read: values (SSV), and where they go (SSM), of SSP 1.0 and 2.0.

https://ssp-standard.org/docs/2.0
"""

import math
import re
import xml.etree.ElementTree as ET

from twin.cosim.ssp.elements import (
    TRUTH,
    annotations_of,
    inside,
    listed,
    local,
    metadata_of,
    named,
    transformation_of,
    truth,
    units_of,
)
from twin.cosim.ssp.parameters import REALS, WHOLES, MappingEntry, ParameterMapping, ParameterSet, ParameterValue
from twin.errors import InputRefused
from twin.files import xml_of

MOST_PARAMETERS = 100_000
"""Of one set, and entries of one mapping."""
TEXTS = ("String", "Enumeration", "Binary")


def parameter_set(content: bytes, where: str, source: str = "") -> ParameterSet:
    """The set in an SSV file.

    Args:
        content: of the file.
        where: for sentences.
        source: of the set.

    Raises:
        InputRefused: no SSV, or as `parameter_set_of`.
    """
    return parameter_set_of(xml_of(content, where), where, source)


def parameter_set_of(root: ET.Element, where: str, source: str = "") -> ParameterSet:
    """The set that an element is.

    Raises:
        InputRefused: it is none, a parameter has no name or another one's, or what it has is no finite number, truth
            value or text.
    """
    if local(root) != "ParameterSet":
        raise InputRefused(f"{where}: <{local(root)}>; expected <ParameterSet>, an SSV file")
    found = listed(root, "Parameters", "Parameter")
    if len(found) > MOST_PARAMETERS:
        raise InputRefused(f"{where}: {len(found)} parameters; expected at most {MOST_PARAMETERS}")
    values: dict[str, ParameterValue] = {}
    for element in found:
        name = element.get("name", "")
        kinds = [
            child for child in element if local(child) not in ("Annotations", "Dimension", "MetaData", "Signature")
        ]
        if not name or name in values or len(kinds) != 1:
            wrong = "without a name" if not name else "given twice" if name in values else "without one value"
            raise InputRefused(f"{where}: a parameter {wrong}{f', {name}' if name else ''}")
        type_ = local(kinds[0])
        taken = _values(kinds[0], type_, f"{where}: {name}")
        values[name] = ParameterValue(name, type_, taken, kinds[0].get("unit", ""), element.get("description", ""))
    units = units_of(root, where)
    return ParameterSet(
        root.get("name", ""), tuple(values.values()), units, source, metadata_of(root), annotations_of(root)
    )


def mapping(content: bytes, where: str, source: str = "") -> ParameterMapping:
    """The mapping in an SSM file; arguments as of `parameter_set`.

    Raises:
        InputRefused: no SSM, or as `mapping_of`.
    """
    return mapping_of(xml_of(content, where), where, source)


def mapping_of(root: ET.Element, where: str, source: str = "") -> ParameterMapping:
    """The mapping that an element is.

    Raises:
        InputRefused: it is none, or an entry has no source or target.
    """
    if local(root) != "ParameterMapping":
        raise InputRefused(f"{where}: <{local(root)}>; expected <ParameterMapping>, an SSM file")
    found = inside(root, "MappingEntry")
    if len(found) > MOST_PARAMETERS:
        raise InputRefused(f"{where}: {len(found)} entries; expected at most {MOST_PARAMETERS}")
    entries = [
        MappingEntry(
            named(entry, "source", where),
            named(entry, "target", where),
            transformation_of(entry, where),
            truth(entry, "suppressUnitConversion", where),
        )
        for entry in found
        # tools write entries that lead from nothing, for people to fill in
        if entry.get("source") != ""
    ]
    return ParameterMapping(tuple(entries), source, metadata_of(root))


def _values(element: ET.Element, type_: str, where: str) -> tuple[float, ...] | tuple[str, ...]:
    text = element.get("value")
    if type_ in TEXTS:
        # an array of texts has an element for each
        return tuple(one.get("value", "") for one in inside(element, "Value")) if text is None else (text,)
    words = re.split(r"\s+", (text or "").strip())
    return tuple(_number(word, type_, where) for word in words)


def _number(text: str, type_: str, where: str) -> float:
    try:
        if type_ == "Boolean":
            return float(TRUTH[text])
        value = float(int(text)) if type_ in WHOLES else float(text) if type_ in REALS else math.nan
    except (KeyError, ValueError, OverflowError):
        value = math.nan
    if not math.isfinite(value):
        raise InputRefused(f"{where}: {type_} '{text[:40]}'; expected finite numbers, truth values or text")
    return value
