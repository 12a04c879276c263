"""Values with units: the TOML key carries the unit, the Python attribute is SI."""

import math
from functools import cache
from typing import Any

from pydantic import BaseModel, ConfigDict, Field, ValidationInfo, field_validator

from twin.units import Unit, known_unit


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
        is_quantity, unit = _unit_of(cls, info.field_name or "")
        if not is_quantity or value is None:
            return value
        # a `share` and a `factor` have none
        si = value if unit is None else unit.in_si(value)
        if not _finite(si):
            raise ValueError("expected a number that is finite in SI units, too")
        return si


@cache
def _unit_of(table: type[Section], name: str) -> tuple[bool, Unit | None]:
    """Whether the field `name` is a `quantity`, and the unit in its key."""
    key = table.model_fields[name].alias
    return key is not None, None if key is None else known_unit(key.removeprefix(f"{name}_"))


def _finite(value: Any) -> bool:
    return all(map(_finite, value)) if isinstance(value, tuple) else math.isfinite(value)
