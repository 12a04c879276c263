"""Ports of components, and records of their values in memory.

The memory of a component as a record, which compiled code and Python read and write by the same names.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from twin.kernel.settings import Settings, Values, setting_fields

FIELD_FORMS = {float: "f8", tuple[float, float, float]: "3f8"}
STATE_KEY, BELOW_KEY = "state", "below"
"""Keys of a dtype's metadata; they change nothing of a record's layout."""


@dataclass(frozen=True)
class Port:
    """A named input or output.

    Attributes:
        name: the quantity's name, the same everywhere.
        size: number of doubles.
        unit: SI unit as text, "1" for pure numbers.
        meaning: one phrase, frames and sign included.
        kind: "double", "int" or "bool": how a recording keeps it; on a wire every value is a double.
        instant: which instant of a step an input stands for, where the system interpolates inputs: one that is held
            over the step for its middle; see `System`.
    """

    name: str
    size: int = 1
    unit: str = "1"
    meaning: str = ""
    kind: Literal["double", "int", "bool"] = "double"
    instant: Literal["start", "middle", "end"] = "middle"


def width(ports: tuple[Port, ...]) -> int:
    """Number of doubles that `ports` take together."""
    return sum(port.size for port in ports)


def port_record(ports: tuple[Port, ...]) -> np.dtype:
    """The values of `ports` as a record: under the name of each a double, or an array of as many as its size."""
    return np.dtype([(port.name, "f8") if port.size == 1 else (port.name, "f8", (port.size,)) for port in ports])


def by_port(ports: tuple[Port, ...], values: np.ndarray) -> dict[str, np.ndarray]:
    """`values` (..., width of `ports`) by the name of the port, (..., size) each, views."""
    return {name: values[..., place] for name, place in port_slices(ports).items()}


def port_slices(ports: tuple[Port, ...]) -> dict[str, slice]:
    """Which of the values of `ports` are those of each, by its name."""
    ends = np.cumsum([port.size for port in ports]).tolist()
    return {port.name: slice(end - port.size, end) for port, end in zip(ports, ends, strict=True)}


def format_values(ports: tuple[Port, ...], values: np.ndarray) -> str:
    """`speed = 0.13 rad/s, torque = 0.061 N m`: the values of `ports`, for people."""
    texts = []
    for port, part in zip(ports, by_port(ports, values).values(), strict=True):
        shown = f"{part[0]:.6g}" if port.size == 1 else "(" + ", ".join(f"{v:.6g}" for v in part) + ")"
        texts.append(f"{port.name} = {shown}" + ("" if port.unit == "1" else f" {port.unit}"))
    return ", ".join(texts)


def record(**fields: Any) -> np.dtype:
    """A record, aligned as in C, with a field of each name.

    Args:
        fields: "i8" a whole number or an address, "u8" one without a sign, "f8" a real number, "3f8" three of them;
            or a record, or (a record, (n,)) for n of them; what steps change as `state` of one of these.
    """
    return np.dtype(list(fields.items()), align=True)


def state(form: Any, below: str = "") -> np.dtype:
    """`form` of a field that steps change, as `record` takes it; of an address: what lies there is changed.

    Args:
        form: see `record`.
        below: field that a whole number here stays below, an index; of the same record, or with "/" before it of the
            outermost one.
    """
    kind = np.dtype(form)
    base, shape = kind.subdtype or (kind, ())
    marked = np.dtype(base, metadata={STATE_KEY: True, BELOW_KEY: below})
    return np.dtype((marked, shape)) if shape else marked


def states(**fields: Any) -> dict[str, np.dtype]:
    """`fields` as `record` takes them, each as `state`."""
    return {name: state(form) for name, form in fields.items()}


@dataclass(frozen=True)
class StateField:
    """A field of a record, or of a record in it, that steps change.

    Attributes:
        path: names of the fields that lead there.
        below: see `state`.
    """

    path: tuple[str, ...]
    below: str

    @property
    def name(self) -> str:
        return ".".join(self.path)

    def view_in(self, memory: np.ndarray) -> np.ndarray:
        """The values in `memory`, a view."""
        for name in self.path:
            memory = memory[name]
        return memory

    def limit(self, memory: np.ndarray) -> np.ndarray:
        """What each of the values stays below, shaped as these."""
        path = (self.below[1:],) if self.below.startswith("/") else (*self.path[:-1], self.below)
        return StateField(path, "").view_in(memory)


def state_fields(kind: np.dtype, path: tuple[str, ...] = ()) -> Iterator[StateField]:
    """Every field of the record `kind` that is declared as `state`, in their order."""
    for name, (field, *_) in (kind.fields or {}).items():
        base = field.base
        metadata: Mapping[str, Any] = base.metadata or {}
        if metadata.get(STATE_KEY):
            yield StateField((*path, name), metadata[BELOW_KEY])
        else:
            yield from state_fields(base, (*path, name))


def memory_of(kind: np.dtype, **values: Any) -> np.ndarray:
    """A record of that kind in an array of its own, (1,), with `values` in its fields and 0 in all others."""
    memory = np.zeros(1, dtype=kind)
    for name, value in values.items():
        memory[name][0] = value
    return memory


def record_of(values: type, **more: Any) -> np.dtype:
    """A record of the fields of `values`, and `more`.

    Args:
        values: `Values`; or a table of settings, whose numbers these are; or a NamedTuple of real numbers, triples of
            them, and whole numbers, as truth values and the members of an IntEnum are.
    """
    if issubclass(values, Settings):
        forms = {name: source.form for name, source in setting_fields(values).items()}
    elif issubclass(values, Values):
        forms = values.forms
    else:
        forms = {name: FIELD_FORMS.get(form, "i8") for name, form in values.__annotations__.items()}
    return record(**forms, **more)
