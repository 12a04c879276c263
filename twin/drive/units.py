"""Units of an FMU's variables: what they measure, the radian left out, and how their values become SI."""

import math
from typing import Any, NamedTuple

from twin.units import TEMPERATURE, Dimension, Unit, known_unit


class Conversion(NamedTuple):
    """SI value = factor * value + offset, of a quantity of `dimension`."""

    dimension: Dimension
    factor: float = 1.0
    offset: float = 0.0


SPEED = Dimension(s=-1)
TURN = 2.0 * math.pi

SPELLED = (
    "1", "rad", "deg", "\N{DEGREE SIGN}", "rev", "rad/s", "deg/s", "rev/s", "rpm", "rev/min", "N.m", "N m", "Nm", "N*m",
    "mN.m", "mN m", "mNm", "mN*m", "N.cm", "A", "mA", "V", "mV", "W", "K",
)  # fmt: skip
"""As `twin.units` does."""
OTHERWISE = {"": "1", "degree": "deg", "r": "rev", "turn": "rev", "r/s": "rev/s", "Ncm": "N.cm"}
# SI Brochure, 2.3.4: hertz is for frequencies, what turns has rad/s; in hertz it counts turns, as per minute
OTHERWISE |= {"Hz": "rev/s", "kHz": "rev/ms", "rps": "rev/s", "1/min": "rpm", "r/min": "rpm", "U/min": "rpm"}
ENERGY = ("J", "kJ", "mJ", "Wh", "kWh")
"""In kg m2/s2 as torques are, and no torque."""


def _without_radian(unit: Unit | None) -> Conversion:
    assert unit is not None
    return Conversion(unit.dimension._replace(rad=0), unit.scale)


KNOWN = {name: _without_radian(known_unit(OTHERWISE.get(name, name))) for name in (*SPELLED, *OTHERWISE)}
KNOWN |= dict.fromkeys(("degC", "\N{DEGREE SIGN}C"), Conversion(TEMPERATURE, 1.0, 273.15))
"""What a unit's name means where the FMU does not define it, or defines it in turns instead of radians."""


def conversion(unit: str, definitions: list[Any]) -> Conversion | None:
    """How values in `unit` become SI; None if neither the FMU's `definitions` (FMPy's) nor custom knows the unit."""
    for definition in definitions:
        if definition.name == unit and definition.baseUnit is not None:
            base = definition.baseUnit
            dimension = Dimension(*(int(getattr(base, name) or 0) for name in Dimension._fields))
            return meant(unit, Conversion(dimension, float(base.factor), float(base.offset)))
    return meant(unit)


def meant(unit: str, stated: Conversion | None = None) -> Conversion | None:
    """How values in `unit` become SI, of which a file has `stated` so much; None if nobody knows.

    A definition as 1/s with the factor 1/60 (rpm as a frequency) or 1 (Hz) counts turns; the well-known name decides.
    """
    if unit.strip() in ENERGY:
        return None
    known = KNOWN.get(unit.strip())
    if stated is None:
        return known
    stated = stated._replace(dimension=stated.dimension._replace(rad=0))
    if known and known.dimension == stated.dimension and math.isclose(known.factor, TURN * stated.factor):
        return known
    return stated
