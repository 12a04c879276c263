"""Values with units: the TOML key carries the unit, the Python attribute is SI."""

import math
from functools import cache
from typing import Any

from pydantic import BaseModel, ConfigDict, Field, ValidationInfo, field_validator

from twin.units import known_unit

_unit = cache(known_unit)


def quantity(key: str, meaning: str, default: Any = ..., **constraints: Any) -> Any:
    """A field whose TOML key is `key` = attribute name + "_" + unit; `default` and `constraints` are in that unit.

    The unit is written as in `kp_mm_per_N`, `b_j_Nm_s_per_rad`: words joined by "_", those after "per" divide.
    """
    return Field(default, alias=key, description=meaning, **constraints)


class Section(BaseModel):
    """A table of the TOML file: unknown keys are mistakes, numbers are finite, types are not guessed."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False, validate_default=True)

    @field_validator("*", mode="after")
    @classmethod
    def _to_si(cls, value: Any, info: ValidationInfo) -> Any:
        key = cls.model_fields[info.field_name or ""].alias
        if key is None or value is None:
            return value
        unit = _unit(key.removeprefix(f"{info.field_name}_"))
        # a `share` and a `factor` have none
        si = value if unit is None else unit.in_si(value)
        if not _finite(si):
            raise ValueError("expected a number that is finite in SI units, too")
        return si


def _finite(value: Any) -> bool:
    return all(map(_finite, value)) if isinstance(value, tuple) else math.isfinite(value)
