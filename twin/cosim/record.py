"""The memory of a component as a record, which compiled code and Python read and write by the same names."""

from typing import Any

import numpy as np

from twin.settings import Settings, Values, taken

FORMS = {float: "f8", tuple[float, float, float]: "3f8"}


def record(**fields: Any) -> np.dtype:
    """A record, aligned as in C, with a field of each name.

    Args:
        fields: "i8" a whole number or an address, "u8" one without a sign, "f8" a real number, "3f8" three of them;
            or a record, or (a record, (n,)) for n of them.
    """
    return np.dtype(list(fields.items()), align=True)


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
        forms = {name: source.form for name, source in taken(values).items()}
    elif issubclass(values, Values):
        forms = values.forms
    else:
        forms = {name: FORMS.get(form, "i8") for name, form in values.__annotations__.items()}
    return record(**forms, **more)
