"""Units, and lines from one value to another (SSP 1.0, 4.5.3 and 4.5.4)."""

from dataclasses import dataclass

from twin.units import Dimension


@dataclass(frozen=True)
class UnitDefinition:
    """A unit as a file defines it: SI value = factor * value + offset, of a quantity of `dimension`."""

    name: str
    dimension: Dimension
    factor: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True)
class Transformation:
    """What is done to a value on its way, after its unit is converted: factor * value + offset.

    Attributes:
        factor, offset: of a LinearTransformation.
        table: the standard's name of one that is no line, "BooleanMappingTransformation"; "" if it is one.
    """

    factor: float = 1.0
    offset: float = 0.0
    table: str = ""


NONE = Transformation()
"""The value as it is."""
