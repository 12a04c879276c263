"""Conversion of dataclasses and named tuples to JSON-serialisable values."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from pathlib import PurePath
from typing import Any


def to_dict(value: Any) -> Any:
    """Convert `value` to mappings, lists, texts and numbers; None for a number that is infinite or NaN.

    A record with `JSON_KEYS` is written with these keys, each followed by the path of its value if that has another
    name: `"force=point.force mean_W=mean stable"`. Any other record is written with its fields.
    """
    match value:
        case float():
            return float(value) if math.isfinite(value) else None
        case Enum():
            return value.value
        case None | bool() | int() | str():
            return value
        case PurePath():
            return str(value)
        case Mapping():
            return {key: to_dict(one) for key, one in value.items()}
    # arrays and scalars of NumPy, which takes long to import
    if hasattr(value, "tolist"):
        return to_dict(value.tolist())
    if keys := getattr(value, "JSON_KEYS", ""):
        pairs = (entry.partition("=") for entry in keys.split())
        return {key: to_dict(_value_at(value, path or key)) for key, _, path in pairs}
    if is_dataclass(value):
        return {field.name: to_dict(getattr(value, field.name)) for field in fields(value)}
    if hasattr(value, "_asdict"):
        return to_dict(value._asdict())
    if isinstance(value, Iterable):
        return [to_dict(one) for one in value]
    raise TypeError(f"{type(value).__name__} has no form in JSON")


def _value_at(record: Any, path: str) -> Any:
    """Return the value at `path` in a record: attributes, keys of mappings and indices, separated by dots."""
    for name in path.split("."):
        if isinstance(record, Mapping):
            record = record[name]
        else:
            record = record[int(name)] if name.isdigit() else getattr(record, name)
    return record
