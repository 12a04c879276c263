"""Error messages for invalid tables: place, value, expectation; with hints at probably wrong units.

Functions with an argument `mistakes` append a message for each error to it; items of arrays are numbered from 1.
"""

from collections.abc import Iterable, Iterator, Mapping
from functools import lru_cache
from typing import Any, TypeGuard, TypeVar, get_args

from pydantic import BaseModel, ValidationError

from twin.kernel.errors import nearest

LENGTH_KEYS = ("a_mm", "b_mm", "l_a_mm", "l_b_mm")
ROBOT_TABLES = ("robot", "plant", "controller.model")
MIN_LENGTH, MAX_LENGTH = 1.0, 5000.0
"""Plausible range (mm) of the lengths of a robot for a person's back, and of the height of its waypoints."""
_EXPECTED_TYPES = {
    "float_type": "a number",
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "string_type": "text in quotes",
    "bool_type": "true or false",
    "tuple_type": "an array",
    "dict_type": "a table",
    "model_type": "a table",
    "finite_number": "a finite number",
    "parameter_type": "a number, text in quotes, or an array of either",
}
_BOUND_SIGNS = {
    "greater_than": ("gt", ">"),
    "greater_than_equal": ("ge", ">="),
    "less_than": ("lt", "<"),
    "less_than_equal": ("le", "<="),
}
Model = TypeVar("Model", bound=BaseModel)


def unit_hints(values: Mapping[str, Any]) -> list[str]:
    """Return a message for each length in mm among an experiment's `values` that is plausible in m or um."""
    sentences_by_key: dict[str, str] = {}
    for key, length in _lengths(values):
        factor = 1e3 if abs(length) < MIN_LENGTH else 1e-3
        plausible = MIN_LENGTH <= abs(length) * factor <= MAX_LENGTH
        if length and not MIN_LENGTH <= abs(length) <= MAX_LENGTH and plausible:
            # [plant] and [controller.model] inherit it from [robot]: reported once
            sentences_by_key.setdefault(
                key.rpartition(" ")[2] + f"{length:g}",
                f"{key} = {length:g}: {length:g} mm; did you mean {length * factor:g} (mm)?",
            )
    return list(sentences_by_key.values())


def _lengths(values: Mapping[str, Any]) -> Iterator[tuple[str, float]]:
    for name in ROBOT_TABLES:
        table = _table(values, name)
        yield from ((f"[{name}] {key}", table[key]) for key in LENGTH_KEYS if _is_number(table.get(key)))
    points = _table(values, "reference").get("p_mm")
    if isinstance(points, tuple) and all(isinstance(p, tuple) and len(p) == 3 for p in points):
        # only heights are indicative: x and y may well be zero
        heights = [p[2] for p in points if _is_number(p[2])]
        if heights:
            yield "[reference] p_mm, z of the lowest", min(heights)
    for name, key in (("contact", "height_mm"), ("approach", "height_mm")):
        height = _table(values, name).get(key)
        if _is_number(height):
            yield f"[{name}] {key}", height


def _table(values: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    found: Any = values
    for part in name.split("."):
        found = found.get(part) if isinstance(found, Mapping) else None
    return found if isinstance(found, Mapping) else {}


def _is_number(value: Any) -> TypeGuard[float]:
    return isinstance(value, int | float) and not isinstance(value, bool)


class _LiteralTable:
    """Hashable copy of a table that compares by its text: 1 differs from 1.0, and -0.0 from 0.0."""

    def __init__(self, table: Any):
        self.table, self._text = table, repr(table)

    def __hash__(self) -> int:
        return hash(self._text)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _LiteralTable) and self._text == other._text


# cached, because the runs of a sweep differ in one of ten tables
@lru_cache(256)
def _validate(model: type[Model], literal: _LiteralTable) -> Model:
    return model.model_validate(literal.table)


def check_table(model: type[Model], table: Any, name: str, mistakes: list[str]) -> Model | None:
    """Validate a table of the experiment by its pydantic model; None after appending error messages to `mistakes`."""
    try:
        return _validate(model, _LiteralTable(table))
    except ValidationError as error:
        mistakes += error_messages(error, model, name)
        return None


def check_kind(kinds: Mapping[str, type[Model]], table: Any, name: str, mistakes: list[str]) -> Model | None:
    """Validate a table by the model that its key `kind` selects; None after appending error messages to `mistakes`."""
    kind = table.get("kind") if isinstance(table, Mapping) else None
    if not isinstance(kind, str) or kind not in kinds:
        mistakes.append(f"[{name}] kind = {kind!r}: expected {', '.join(map(repr, kinds))}")
        return None
    return check_table(kinds[kind], table, name, mistakes)


def numbered_tables(tables: Any, name: str, mistakes: list[str]) -> Iterable[tuple[int, Any]]:
    """Return the tables of an array of tables with their numbers from 1.

    A single table in place of an array gives an error message, and no tables.
    """
    if isinstance(tables, tuple):
        return enumerate(tables, start=1)
    mistakes.append(f"[{name}]: a single table; {name}s are an array of tables, write [[{name}]]")
    return ()


def error_messages(error: ValidationError, model: type[BaseModel], table: str) -> list[str]:
    """Convert pydantic's validation errors of a table to messages, one per error."""
    return [_error_message(detail, model, table) for detail in error.errors()]


def type_error_messages(error: ValidationError, model: type[BaseModel], table: str) -> list[str]:
    """Convert validation errors about wrong types to messages; ignore missing, unknown, out-of-range keys."""
    wrong = (*_EXPECTED_TYPES, "literal_error")
    return [_error_message(detail, model, table) for detail in error.errors() if detail["type"] in wrong]


def unknown_key(key: str, known: list[str]) -> str:
    """Return the error message for an unknown key: `unknown key 'kp'; did you mean 'kp_per_s'?`"""
    return f"unknown key '{key}'; {nearest(key, known)}"


def toml_keys(model: type[BaseModel]) -> list[str]:
    """Return the TOML keys of a table's pydantic model."""
    return [info.alias or name for name, info in model.model_fields.items()]


def _error_message(detail: Any, model: type[BaseModel], table: str) -> str:
    path = [part for part in detail["loc"] if isinstance(part, str)]
    place = [str(part) for part in detail["loc"] if isinstance(part, int)]
    owner, tables = model, [table]
    while len(path) > 1:
        step = path.pop(0)
        tables.append(step)
        fields = {info.alias or name: info.annotation for name, info in owner.model_fields.items()}
        owner = nested_model(fields.get(step)) or owner
    where, key = f"[{'.'.join(tables)}]", path[0] if path else ""
    kind, got = detail["type"], detail["input"]
    if kind == "extra_forbidden":
        inside = _nested_keys(key, owner)
        found = f"unknown key '{key}'; did you mean {inside}?" if inside else unknown_key(key, toml_keys(owner))
        return f"{where} {found}"
    if kind == "missing":
        if place and isinstance(got, Mapping):
            # an array of tables within a table
            return f"[{'.'.join(tables)} {' '.join(str(int(p) + 1) for p in place)}] missing key '{key}'"
        if place:
            return f"{where} {key}: {_value_text(detail['input'])} has too few values"
        return f"{where} missing key '{key}'"
    index = f" (entry {' '.join(str(int(p) + 1) for p in place)})" if place else ""
    shown = f"{where} {key} = {_value_text(got)}{index}"
    if kind in _BOUND_SIGNS:
        name, sign = _BOUND_SIGNS[kind]
        return f"{shown}: expected a number {sign} {detail['ctx'][name]:g}"
    if kind == "literal_error":
        return f"{shown}: expected {detail['ctx']['expected']}"
    if kind == "value_error" and key and isinstance(got, Mapping):
        return f"[{'.'.join([*tables, key])}] {detail['ctx']['error']}"
    if kind == "value_error":
        # an error between keys has no key of its own
        return f"{shown}: {detail['ctx']['error']}" if key else f"{where} {detail['ctx']['error']}"
    return f"{shown}: expected {_EXPECTED_TYPES.get(kind) or detail['msg'][0].lower() + detail['msg'][1:]}"


def _nested_keys(key: str, owner: type[BaseModel]) -> str:
    """Suggest the keys of subtables that an unknown key may mean: `'force.reference_N'` for force_N; "" without one."""
    table, _, unit = key.rpartition("_")
    model = next(
        (nested_model(f.annotation) for name, f in owner.model_fields.items() if table == (f.alias or name)), None
    )
    # kp_mm_per_N is not a force
    known = (
        [] if model is None else [one for one in toml_keys(model) if one.endswith(f"_{unit}") and "_per_" not in one]
    )
    return " or ".join(f"'{table}.{one}'" for one in known)


def nested_model(annotation: Any) -> type[BaseModel] | None:
    """Return the pydantic model of a field that is a table; None for any other field."""
    kinds = (annotation, *get_args(annotation))
    return next((kind for kind in kinds if isinstance(kind, type) and issubclass(kind, BaseModel)), None)


def _value_text(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, tuple):
        return "[" + ", ".join(_value_text(item) for item in value) + "]"
    return f'"{value}"' if isinstance(value, str) else str(value)
