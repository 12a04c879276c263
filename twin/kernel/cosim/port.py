"""Ports of components, and component memory as records that compiled code and Python access by the same names."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from twin.kernel.settings import Settings, Values, setting_fields

FIELD_FORMS = {float: "f8", tuple[float, float, float]: "3f8"}
STATE_KEY, BELOW_KEY = "state", "below"
"""Keys of the metadata of a field's dtype; metadata does not affect the layout of a record."""


@dataclass(frozen=True)
class Port:
    """A named input or output of a component, with size (doubles), unit and meaning.

    Attributes:
        name: name of the quantity, the same in all components.
        unit: SI unit as text, "1" for pure numbers.
        meaning: one phrase, including frame and sign.
        kind: type in a recording; on a wire every value is a double.
        instant: instant of the step whose value an interpolated input takes: "middle" for an input that is constant
            over the step; see `System`.
    """

    name: str
    size: int = 1
    unit: str = "1"
    meaning: str = ""
    kind: Literal["double", "int", "bool"] = "double"
    instant: Literal["start", "middle", "end"] = "middle"


def width(ports: tuple[Port, ...]) -> int:
    """Total number of values of `ports`."""
    return sum(port.size for port in ports)


def port_record(ports: tuple[Port, ...]) -> np.dtype:
    """Record dtype with a field per port: a double, or an array of the port's size, for compiled steps."""
    return np.dtype([(port.name, "f8") if port.size == 1 else (port.name, "f8", (port.size,)) for port in ports])


def by_port(ports: tuple[Port, ...], values: np.ndarray) -> dict[str, np.ndarray]:
    """Split concatenated port values (..., width of `ports`) into views (..., size) by port name."""
    return {name: values[..., place] for name, place in port_slices(ports).items()}


def port_slices(ports: tuple[Port, ...]) -> dict[str, slice]:
    """Slices of ports in their concatenated values, by port name."""
    ends = np.cumsum([port.size for port in ports]).tolist()
    return {port.name: slice(end - port.size, end) for port, end in zip(ports, ends, strict=True)}


def format_values(ports: tuple[Port, ...], values: np.ndarray) -> str:
    """Format the values of `ports` with names and units for messages: `speed = 0.13 rad/s, torque = 0.061 N m`."""
    texts = []
    for port, part in zip(ports, by_port(ports, values).values(), strict=True):
        shown = f"{part[0]:.6g}" if port.size == 1 else "(" + ", ".join(f"{v:.6g}" for v in part) + ")"
        texts.append(f"{port.name} = {shown}" + ("" if port.unit == "1" else f" {port.unit}"))
    return ", ".join(texts)


def record(**fields: Any) -> np.dtype:
    """Dtype of a record for compiled code, with the given fields, aligned as in C.

    Forms: "i8" for an integer or address, "u8" for an unsigned integer, "f8" for a double, "3f8" for three doubles, a
    record, (record, (n,)) for n records, or `state` of one of these if steps change it.
    """
    return np.dtype(list(fields.items()), align=True)


def state(form: Any, below: str = "") -> np.dtype:
    """Mark a field of a memory record as changed by steps, so that it is saved; for an address, the memory behind it.

    `below` names the field that is the upper bound (exclusive) of an index, in the same record, or prefixed by "/" in
    the outermost one; "" for other fields.
    """
    kind = np.dtype(form)
    base, shape = kind.subdtype or (kind, ())
    marked = np.dtype(base, metadata={STATE_KEY: True, BELOW_KEY: below})
    return np.dtype((marked, shape)) if shape else marked


def states(**fields: Any) -> dict[str, np.dtype]:
    """Mark all `fields` of a memory record as changed by steps, so that they are saved."""
    return {name: state(form) for name, form in fields.items()}


@dataclass(frozen=True)
class StateField:
    """A field, `path` from the outermost record, that steps change, so that it is saved; `below`: see `state`."""

    path: tuple[str, ...]
    below: str

    @property
    def name(self) -> str:
        return ".".join(self.path)

    def view_in(self, memory: np.ndarray) -> np.ndarray:
        """Return a view of the state field's values in the record `memory`."""
        for name in self.path:
            memory = memory[name]
        return memory

    def limit(self, memory: np.ndarray) -> np.ndarray:
        """Return the exclusive upper bound of this index, read from the field of `memory` that `below` names."""
        path = (self.below[1:],) if self.below.startswith("/") else (*self.path[:-1], self.below)
        return StateField(path, "").view_in(memory)


def state_fields(kind: np.dtype, path: tuple[str, ...] = ()) -> Iterator[StateField]:
    """Yield every field of the record `kind` that steps change, in order."""
    for name, (field, *_) in (kind.fields or {}).items():
        base = field.base
        metadata: Mapping[str, Any] = base.metadata or {}
        if metadata.get(STATE_KEY):
            yield StateField((*path, name), metadata[BELOW_KEY])
        else:
            yield from state_fields(base, (*path, name))


def memory_of(kind: np.dtype, **values: Any) -> np.ndarray:
    """Create a record of dtype `kind`, shape (1,), with `values` in its fields and 0 in all others."""
    memory = np.zeros(1, dtype=kind)
    for name, value in values.items():
        memory[name][0] = value
    return memory


def record_of(values: type, **more: Any) -> np.dtype:
    """Record dtype for compiled code, with the fields of a class of numbers, and `more` fields.

    The class is `Values`, a table of settings (its numbers become fields), or a NamedTuple of floats, triples of
    floats, and integers (including Booleans and members of an IntEnum).
    """
    if issubclass(values, Settings):
        forms = {name: source.form for name, source in setting_fields(values).items()}
    elif issubclass(values, Values):
        forms = values.forms
    else:
        forms = {name: FIELD_FORMS.get(form, "i8") for name, form in values.__annotations__.items()}
    return record(**forms, **more)
