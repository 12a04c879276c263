"""Elements that all files of the standard share (SSC), read; by their names alone, as each name means one thing."""

import math
import time
import xml.etree.ElementTree as ET
from collections.abc import Iterable

from twin.cosim.ssp.metadata import Annotation, Metadata
from twin.cosim.ssp.unit import NONE, Transformation, UnitDefinition
from twin.errors import InputRefused
from twin.units import Dimension

TRUTH = {"true": True, "1": True, "false": False, "0": False}
MOST_POWER = 100
"""Of a base unit; an honest one has 4."""

MOST_TIME = 30.0
"""s on a processor, for a structure and once more for what is made of it; the largest that is allowed takes a tenth."""


class Patience:
    """What lasts too long is refused: no file that an honest tool writes needs that.

    Args:
        where: for the sentence.
    """

    def __init__(self, where: str):
        self._where = where
        # not the clock's: a busy machine accuses no file
        self._end = time.process_time() + MOST_TIME

    def spend(self) -> None:
        """To be called for each of what there may be many of.

        Raises:
            InputRefused: it has lasted too long.
        """
        if time.process_time() > self._end:
            raise InputRefused(
                f"{self._where}: takes more than {MOST_TIME:g} s to read; expected fewer connectors, connections and "
                "values. Do not trust this file"
            )


def local(element: ET.Element) -> str:
    """The name of an element without its namespace."""
    return element.tag.rpartition("}")[2]


def inside(element: ET.Element | None, name: str) -> list[ET.Element]:
    """The children called `name`; none of no element."""
    return [] if element is None else [child for child in element if local(child) == name]


def listed(element: ET.Element, group: str, name: str) -> list[ET.Element]:
    """The children called `name` of the child called `group`."""
    return [child for part in inside(element, group) for child in inside(part, name)]


def named(element: ET.Element, attribute: str, where: str) -> str:
    """An attribute that has to be there.

    Raises:
        InputRefused: it is not.
    """
    found = element.get(attribute, "")
    if not found:
        raise InputRefused(f"{where}: a <{local(element)}> without {attribute}")
    return found


def unique(names: Iterable[str], what: str, where: str) -> None:
    """See that no name comes twice.

    Raises:
        InputRefused: one does.
    """
    seen: set[str] = set()
    for name in names:
        if name in seen:
            raise InputRefused(f"{where}: two {what} are called '{name}'; expected different names")
        seen.add(name)


def number(element: ET.Element, attribute: str, where: str, default: float) -> float:
    """The finite number of an attribute, `default` without it.

    Raises:
        InputRefused: it is none.
    """
    text = element.get(attribute)
    return default if text is None else finite(text, f"{where}: <{local(element)}> {attribute}")


def finite(text: str, where: str) -> float:
    """The finite number that `text` says.

    Raises:
        InputRefused: it says none.
    """
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputRefused(f"{where} = '{text[:40]}'; expected a finite number")
    return value


def truth(element: ET.Element, attribute: str, where: str) -> bool:
    """Whether it says so; no if it says nothing.

    Raises:
        InputRefused: neither true nor false.
    """
    text = element.get(attribute, "false").strip()
    if text not in TRUTH:
        raise InputRefused(f"{where}: <{local(element)}> {attribute} = '{text[:40]}'; expected true or false")
    return TRUTH[text]


def metadata_of(root: ET.Element) -> Metadata:
    """Of a file."""
    names = ("description", "author", "fileversion", "copyright", "license", "generationTool", "generationDateAndTime")
    return Metadata(*(root.get(name, "") for name in names))


def annotations_of(element: ET.Element) -> tuple[Annotation, ...]:
    """Of an element; of each only the first element that is in it."""
    return tuple(
        Annotation(one.get("type", ""), ET.tostring(one[0], encoding="unicode").strip() if len(one) else "")
        for one in listed(element, "Annotations", "Annotation")
    )


def units_of(root: ET.Element, where: str) -> tuple[UnitDefinition, ...]:
    """That a file defines.

    Raises:
        InputRefused: a unit without a name, one defined twice, or powers that are no small whole numbers.
    """
    found = []
    for unit in listed(root, "Units", "Unit"):
        name = named(unit, "name", where)
        base = next(iter(inside(unit, "BaseUnit")), None)
        if base is None:
            raise InputRefused(f"{where}: unit '{name}' without a BaseUnit")
        powers = [number(base, power, where, 0.0) for power in Dimension._fields]
        if not all(power.is_integer() and abs(power) <= MOST_POWER for power in powers):
            raise InputRefused(f"{where}: unit '{name}': expected small whole powers of its base units")
        factor = number(base, "factor", where, 1.0)
        if factor == 0.0:
            raise InputRefused(f"{where}: unit '{name}' has the factor 0; expected another number")
        found.append(UnitDefinition(name, Dimension(*map(int, powers)), factor, number(base, "offset", where, 0.0)))
    unique((unit.name for unit in found), "units", where)
    return tuple(found)


def transformation_of(element: ET.Element, where: str) -> Transformation:
    """That of a connection or of an entry of a mapping.

    Raises:
        InputRefused: a factor or an offset is no finite number.
    """
    for child in element:
        if local(child) == "LinearTransformation":
            return Transformation(number(child, "factor", where, 1.0), number(child, "offset", where, 0.0))
        if local(child).endswith("Transformation"):
            return Transformation(table=local(child))
    return NONE
