"""Validation of a page's requests: the fields of each operation, checked before use.

Independent of the server library. Whether a value names an existing object is checked by the operation.
"""

import math
from collections.abc import Callable, Mapping
from typing import Any

from twin.kernel.errors import InputRefused

Check = Callable[[Any], bool]
MAX_TEXT_LENGTH, MAX_ITEMS = 2**17, 1000
MAX_INTEGER = 2**53
"""Largest integer that a page's numbers represent exactly."""
REQUIRED_FIELDS = ("state", "run", "log", "settings", "name", "accepted")
"""Fields that an operation which has them requires; others may be missing or null."""
FIELD_TEXTS = {
    "state": "set, drive, body and faults",
    "panels": "a list of titles",
    "span": "two times in s",
    "width": "a number of pixels",
    "run": "a run of results/",
    "log": "the path of a log",
    "point": "a whole number",
    "shift_s": "a time in s",
}
"""Descriptions of fields in error messages, where the name is not enough."""


def _is_text(value: Any) -> bool:
    return isinstance(value, str) and len(value) <= MAX_TEXT_LENGTH


def _is_flag(value: Any) -> bool:
    return isinstance(value, bool)


def _is_number(value: Any) -> bool:
    if isinstance(value, int) and not isinstance(value, bool):
        return abs(value) <= MAX_INTEGER
    return isinstance(value, float) and math.isfinite(value)


def _is_index(value: Any) -> bool:
    return isinstance(value, int) and _is_number(value) and value >= 0


def _is_scalar(value: Any) -> bool:
    return _is_text(value) or _is_flag(value) or _is_number(value)


def _list_of(check: Check) -> Check:
    return lambda value: isinstance(value, list) and len(value) <= MAX_ITEMS and all(map(check, value))


def _table_of(check: Check) -> Check:
    return lambda value: isinstance(value, dict) and len(value) <= MAX_ITEMS and all(map(check, value.values()))


def _record_of(fields: Mapping[str, Check]) -> Check:
    """Return a check for a table with these fields, which may be missing or null."""
    return lambda value: (
        isinstance(value, dict)
        and all(key in fields and (one is None or fields[key](one)) for key, one in value.items())
    )


STATE_CHECK = _record_of(
    {"set": _table_of(_is_scalar), "drive": _is_text, "body": _is_text, "faults": _list_of(_table_of(_is_scalar))}
)
ACCEPTED_CHECK = _list_of(_table_of(_is_scalar))
VIEW_FIELDS: Mapping[str, Check] = {
    "panels": _list_of(_is_text),
    "span": _list_of(_is_number),
    "width": _is_index,
    "robot": _is_flag,
    "list": _is_flag,
    "layout": _is_text,
}
STATE_FIELDS: Mapping[str, Check] = {"state": STATE_CHECK}
OPERATION_FIELDS: Mapping[str, Mapping[str, Check]] = {
    "begin": {"settings": _list_of(_is_text)},
    "describe": STATE_FIELDS,
    "show": {**STATE_FIELDS, **VIEW_FIELDS},
    "recorded": {"run": _is_text, **VIEW_FIELDS},
    "runs": {},
    "save": {**STATE_FIELDS, "name": _is_text},
    "command": STATE_FIELDS,
    "onset": STATE_FIELDS,
    "adopt": {**STATE_FIELDS, "accepted": ACCEPTED_CHECK},
    "log": {"log": _is_text, "shift_s": _is_number, **VIEW_FIELDS},
    "loops": {**STATE_FIELDS, "point": _is_index},
    "score": STATE_FIELDS,
}


def check_request(ask: Mapping[str, Any]) -> dict[str, Any]:
    """Check a request of an explorer page; return its operation and known fields, and drop other fields."""
    op = ask.get("op")
    if not isinstance(op, str) or op not in OPERATION_FIELDS:
        raise InputRefused(f"op {str(op)[:80]!r}: no such operation")
    found = {"op": op}
    for name, check in OPERATION_FIELDS[op].items():
        value = ask.get(name)
        if value is None and name not in REQUIRED_FIELDS:
            continue
        if value is None or not check(value):
            raise InputRefused(f"{name}: expected {FIELD_TEXTS.get(name, 'another value')}, got {repr(value)[:80]}")
        found[name] = value
    return found
