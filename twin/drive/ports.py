"""Ports of a component and the FMU's variables behind them, in groups that one call of the FMU sets or gets."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from twin.cosim.port import Port
from twin.drive.adapter import GROUP
from twin.drive.instance import Instance
from twin.drive.kinds import ITEM_SIZES
from twin.drive.ramp import AT_END
from twin.drive.variable import Variable


@dataclass(frozen=True)
class FmuPort:
    """A port and the FMU variable behind it: port value (SI) = gain * FMU value + offset."""

    port: Port
    variable: Variable
    gain: float = 1.0
    offset: float = 0.0

    def in_fmu(self, value: float | np.ndarray) -> float | np.ndarray:
        """`value` of the port as the FMU wants it."""
        return (value - self.offset) / self.gain

    def both_ends(self) -> tuple["FmuPort", "FmuPort"]:
        """The port for its value at the start of a step, and the one for that at its end."""
        end = replace(self.port, name=self.port.name + AT_END, instant="end")
        return replace(self, port=replace(self.port, instant="start")), replace(self, port=end)


@dataclass(frozen=True)
class Placed:
    """A port and where its values stand among those of its component.

    Attributes:
        port: and its variable.
        slots: of its values.
        shift: added to its values, (number of values,).
    """

    port: FmuPort
    slots: np.ndarray
    shift: np.ndarray


def placed(ports: Sequence[FmuPort], shift: np.ndarray | None = None) -> list[Placed]:
    """`ports` one after the other; `shift` by value, nothing if it is not given."""
    ends = np.cumsum([0, *(p.port.size for p in ports)])
    shifts = np.zeros(ends[-1]) if shift is None else shift
    return [Placed(p, np.arange(a, b), shifts[a:b]) for p, a, b in zip(ports, ends, ends[1:], strict=False)]


@dataclass(frozen=True)
class Groups:
    """A table of `adapter.GROUP` and the arrays it points to.

    Attributes:
        table: a row for each FMI type and set of clocks.
        moving: what changes with every step.
        keep: the other arrays.
    """

    table: np.ndarray
    moving: list[np.ndarray]
    keep: list[np.ndarray]


def grouped(instance: Instance, ports: Iterable[Placed], access: str) -> Groups:
    """`ports` in groups that are set or got by one call.

    Args:
        instance: whose variables they are.
        access: "Set" or "Get".
    """
    members: dict[tuple[str, int], list[Placed]] = {}
    for p in ports:
        key = instance.standard.type_name(p.port.variable), instance.clock_bits(p.port.variable)
        members.setdefault(key, []).append(p)
    table = np.zeros(len(members), dtype=GROUP)
    moving: list[np.ndarray] = []
    kept: list[np.ndarray] = []
    for row, (type_name, clocks), group in zip(table, members, members.values(), strict=True):
        kind = group[0].port.variable.kind
        slots = np.concatenate([p.slots for p in group])
        arrays: dict[str, np.ndarray] = {
            "references": np.array([p.port.variable.reference for p in group], dtype=np.uint32),
            "slots": slots.astype(np.uint64),
            "gain": np.concatenate([np.full(len(p.slots), p.port.gain) for p in group]),
            "offset": np.concatenate([p.port.offset + p.shift for p in group]),
            "buffer": np.zeros(len(slots) * ITEM_SIZES[kind], dtype=np.uint8),
            # no value that an input has: the first one counts as new
            "last": np.full(len(slots) * ITEM_SIZES[kind], 0xFF, dtype=np.uint8),
        }
        row["kind"], row["clocks"], row["bytes"] = kind, clocks, len(arrays["buffer"])
        row["access"] = instance.address(access + type_name)
        row["variables"], row["values"] = len(group), len(slots)
        for field, array in arrays.items():
            row[field] = array.ctypes.data
            (moving if field in ("buffer", "last") else kept).append(array)
    return Groups(table, moving, kept)
