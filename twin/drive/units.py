"""Units of an FMU's variables: what they measure, and how their values become SI."""

import math
from typing import Any, NamedTuple


class Dimension(NamedTuple):
    """Exponents of the SI base units. The radian is left out: tools disagree whether rad/s is 1/s (FMI 2.0, 2.2.2)."""

    kg: int = 0
    m: int = 0
    s: int = 0
    A: int = 0
    K: int = 0
    mol: int = 0
    cd: int = 0


class Conversion(NamedTuple):
    """SI value = factor * value + offset, of a quantity of `dimension`."""

    dimension: Dimension
    factor: float = 1.0
    offset: float = 0.0


NUMBER = Dimension()
SPEED = Dimension(s=-1)
TORQUE = Dimension(kg=1, m=2, s=-2)
CURRENT = Dimension(A=1)
VOLTAGE = Dimension(kg=1, m=2, s=-3, A=-1)
POWER = Dimension(kg=1, m=2, s=-3)
TEMPERATURE = Dimension(K=1)

TURN = 2.0 * math.pi

KNOWN = {
    **dict.fromkeys(("1", ""), Conversion(NUMBER)),
    "rad": Conversion(NUMBER),
    **dict.fromkeys(("deg", "degree", "\N{DEGREE SIGN}"), Conversion(NUMBER, TURN / 360.0)),
    **dict.fromkeys(("rev", "r", "turn"), Conversion(NUMBER, TURN)),
    "rad/s": Conversion(SPEED),
    "deg/s": Conversion(SPEED, TURN / 360.0),
    **dict.fromkeys(("rpm", "1/min", "rev/min", "r/min", "U/min"), Conversion(SPEED, TURN / 60.0)),
    # SI Brochure, 2.3.4: hertz is for frequencies, what turns has rad/s; in hertz it counts turns
    **dict.fromkeys(("rev/s", "r/s", "Hz"), Conversion(SPEED, TURN)),
    **dict.fromkeys(("N.m", "N m", "Nm", "N*m"), Conversion(TORQUE)),
    **dict.fromkeys(("mN.m", "mN m", "mNm", "mN*m"), Conversion(TORQUE, 1e-3)),
    **dict.fromkeys(("N.cm", "Ncm"), Conversion(TORQUE, 1e-2)),
    "A": Conversion(CURRENT),
    "mA": Conversion(CURRENT, 1e-3),
    "V": Conversion(VOLTAGE),
    "mV": Conversion(VOLTAGE, 1e-3),
    "W": Conversion(POWER),
    "K": Conversion(TEMPERATURE),
    **dict.fromkeys(("degC", "\N{DEGREE SIGN}C"), Conversion(TEMPERATURE, 1.0, 273.15)),
}
"""What a unit's name means where the FMU does not define it, or defines it in turns instead of radians. Factors: SI
Brochure, 9th edition, tables 4, 7 and 8."""


def conversion(unit: str, definitions: list[Any]) -> Conversion | None:
    """How values in `unit` become SI; None if neither the FMU's `definitions` (FMPy's) nor custom knows the unit.

    A definition as 1/s with the factor 1/60 (rpm as a frequency) or 1 (Hz) counts turns; the well-known name decides.
    """
    known = KNOWN.get(unit.strip())
    for definition in definitions:
        if definition.name == unit and definition.baseUnit is not None:
            base = definition.baseUnit
            dimension = Dimension(*(int(getattr(base, name) or 0) for name in Dimension._fields))
            stated = Conversion(dimension, float(base.factor), float(base.offset))
            if known and known.dimension == dimension and math.isclose(known.factor, TURN * stated.factor):
                return known
            return stated
    return known
