"""Going back to the start of a step, so that it can be repeated with better inputs."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numba import carray

from twin.cosim.native import bytes_at, call_step, step_function


@dataclass(frozen=True)
class Rewind:
    """How a component goes back: two functions of a step's signature, which read neither time nor inputs.

    Attributes:
        save_address, restore_address: `restore` brings back what `save` last kept, as often as it is called.
        self_address: memory that both are called with.
        keep: whatever owns the memory behind the addresses.
    """

    save_address: int
    restore_address: int
    self_address: int
    keep: Any = field(default=None, repr=False)


_MEMORY = np.dtype([("record", "i8"), ("copy", "i8"), ("size", "i8")], align=True)


@step_function(_MEMORY)
def _save(m, t, h, u, y):
    record, copy = carray(bytes_at(m.record), m.size), carray(bytes_at(m.copy), m.size)
    for i in range(m.size):
        copy[i] = record[i]
    return 0


@step_function(_MEMORY)
def _restore(m, t, h, u, y):
    record, copy = carray(bytes_at(m.record), m.size), carray(bytes_at(m.copy), m.size)
    for i in range(m.size):
        record[i] = copy[i]
    return 0


def record_rewind(record: np.ndarray) -> Rewind:
    """Of a component whose whole state is `record`, (1,)."""
    copy = record.copy()
    memory = np.array([(record.ctypes.data, copy.ctypes.data, record.nbytes)], dtype=_MEMORY)
    return Rewind(_save.address, _restore.address, memory.ctypes.data, (memory, copy))


_TWO = np.dtype([(f"{verb}_{n}", "i8") for n in (1, 2) for verb in ("save", "restore", "self")], align=True)


@step_function(_TWO)
def _save_both(m, t, h, u, y):
    status = call_step(m.save_1, m.self_1, t, h, 0, 0)
    return status if status != 0 else call_step(m.save_2, m.self_2, t, h, 0, 0)


@step_function(_TWO)
def _restore_both(m, t, h, u, y):
    status = call_step(m.restore_1, m.self_1, t, h, 0, 0)
    return status if status != 0 else call_step(m.restore_2, m.self_2, t, h, 0, 0)


def joined_rewind(one: Rewind, other: Rewind) -> Rewind:
    """Of a component whose state is in two places."""
    addresses = [(r.save_address, r.restore_address, r.self_address) for r in (one, other)]
    memory = np.array([(*addresses[0], *addresses[1])], dtype=_TWO)
    return Rewind(_save_both.address, _restore_both.address, memory.ctypes.data, (memory, one, other))
