"""Values with units: the TOML key carries the unit, the Python attribute is SI."""

import math
from fractions import Fraction
from typing import Any

from pydantic import BaseModel, ConfigDict, Field, ValidationInfo, field_validator

_SCALES = {
    "mm": Fraction(1, 1000),
    "ms": Fraction(1, 1000),
    "g": Fraction(1, 1000),
    "min": Fraction(60),
    "deg": Fraction(1),
}


def quantity(key: str, meaning: str, default: Any = ..., **constraints: Any) -> Any:
    """A field whose TOML key is `key` = attribute name + "_" + unit; `default` and `constraints` are in that unit.

    The unit is written as in `kp_mm_per_N`, `b_j_Nm_s_per_rad`: words joined by "_", those after "per" divide.
    """
    return Field(default, alias=key, description=meaning, **constraints)


def in_si(value: Any, unit: str) -> Any:
    """`value` (a number or nested tuples of numbers) given in `unit`, in SI.

    Powers of ten are applied as one correctly rounded division, so that -101 mm is exactly the float -0.101.

    Raises:
        ValueError: it is too large for that.
    """
    if isinstance(value, tuple):
        return tuple(in_si(item, unit) for item in value)
    words = unit.split("_")
    divide = words.index("per") if "per" in words else len(words)
    scale = Fraction(1)
    for position, word in enumerate(words):
        factor = _SCALES.get(word, Fraction(1))
        scale = scale * factor if position < divide else scale / factor
    scaled = value * scale.numerator / scale.denominator
    if "deg" in words:
        scaled = math.radians(scaled) if words.index("deg") < divide else math.degrees(scaled)
    if not math.isfinite(scaled):
        raise ValueError("expected a number that is finite in SI units, too")
    return scaled


class Section(BaseModel):
    """A table of the TOML file: unknown keys are mistakes, numbers are finite, types are not guessed."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False, validate_default=True)

    @field_validator("*", mode="after")
    @classmethod
    def _to_si(cls, value: Any, info: ValidationInfo) -> Any:
        key = cls.model_fields[info.field_name or ""].alias
        if key is None or value is None:
            return value
        return in_si(value, key.removeprefix(f"{info.field_name}_"))
