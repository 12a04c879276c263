"""Conversion of values between variables: units and linear transformations."""

import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

from twin.kernel.errors import InputRefused
from twin.kernel.fmi.description import FmuDescription
from twin.kernel.fmi.variable import Conversion, conversion, defined_conversion, si_conversion
from twin.kernel.ssp.flat import UnitStep
from twin.kernel.ssp.structure import Connector, UnitDefinition


class ParsedUnit(NamedTuple):
    """A unit as written in a file, and its conversion to SI; None if unknown. The text "" means no unit."""

    text: str
    conversion: Conversion | None


class AffineMap(NamedTuple):
    """An affine map between units in inverse form: start value = gain * end value + shift.

    FMU ports are scaled in this form, so that a unit conversion is one division, and equal units change no bit.
    """

    gain: float = 1.0
    shift: float = 0.0

    def apply(self, value: float) -> float:
        """Map a value at the start of a connection to the value at its end."""
        return (value - self.shift) / self.gain

    def chain(self, way: "AffineMap") -> "AffineMap":
        """Return the composition of this affine map with `way`, which is applied after it."""
        return AffineMap(self.gain * way.gain, self.gain * way.shift + self.shift)


def unit_of_variable(
    variable_unit: str,
    connector: Connector | None,
    units: Sequence[UnitDefinition],
    description: FmuDescription,
    where: str,
) -> ParsedUnit:
    """Return the unit of an FMU variable from the FMU and from the connector that represents it."""
    own = ParsedUnit(
        variable_unit, conversion(variable_unit, description.model.unitDefinitions) if variable_unit else None
    )
    if connector is None or not connector.unit or connector.unit == variable_unit:
        return own
    read = parse_unit(connector.unit, units)
    if own.text and read.conversion != own.conversion:
        raise InputRefused(
            f"{where}: {connector.name} is in '{connector.unit}' by its connector, and in '{own.text}' by the FMU; "
            "correct the connector"
        )
    return read


def parse_unit(text: str, units: Sequence[UnitDefinition], fmu: FmuDescription | None = None) -> ParsedUnit:
    """Look up a unit by its text in the definitions of an SSP file, the built-in units, and the units of `fmu`."""
    found = (defined_conversion(text, units) or si_conversion(text)) if text else None
    if text and found is None and fmu is not None:
        found = conversion(text, fmu.model.unitDefinitions)
    return ParsedUnit(text, found)


def connection_map(
    start: ParsedUnit, hops: Iterable[UnitStep], end: ParsedUnit, units: Sequence[UnitDefinition], where: str
) -> AffineMap:
    """Compose the conversions and transformations between two variables into one affine map.

    `units` are the structure's definitions, for connectors of systems on the way.
    """
    found, here, hops = AffineMap(), start, list(hops)
    for count, (transformation, suppressed, unit) in enumerate(hops, start=1):
        last = count == len(hops)
        there = end if last else parse_unit(unit, units) if unit else here
        if not suppressed:
            found = found.chain(_unit_map(here, there, where))
        if transformation.table:
            raise InputRefused(f"{where}: {transformation.table} is not supported; a LinearTransformation is")
        if transformation.factor == 0.0:
            raise InputRefused(f"{where}: the factor 0; leave the connection out, and give the input a start value")
        factor, offset = transformation.factor, transformation.offset
        if (factor, offset) != (1.0, 0.0):
            found = found.chain(AffineMap(1.0 / factor, -offset / factor))
        here = there if there.text else here
    if not (0.0 < abs(found.gain) < math.inf and math.isfinite(found.shift)):
        raise InputRefused(f"{where}: the conversion factor exceeds the range of a number")
    return found


def _unit_map(here: ParsedUnit, there: ParsedUnit, where: str) -> AffineMap:
    if not here.text or not there.text or here.text == there.text:
        return AffineMap()
    for one in (here, there):
        if one.conversion is None:
            raise InputRefused(f"{where}: the unit '{one.text}' is not defined; define it, with its BaseUnit")
    source, target = here.conversion, there.conversion
    assert source is not None and target is not None
    if source.dimension != target.dimension:
        raise InputRefused(f"{where}: from '{here.text}' to '{there.text}', which have different dimensions")
    return AffineMap(target.factor / source.factor, (target.offset - source.offset) / source.factor)
