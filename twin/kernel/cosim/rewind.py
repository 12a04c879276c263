"""Going back to the start of a step, so that it can be repeated with better inputs."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from twin.kernel.compiled.memory import copy
from twin.kernel.cosim.native import step_function


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
    copy(m.copy, m.record, m.size)
    return 0


@step_function(_MEMORY)
def _restore(m, t, h, u, y):
    copy(m.record, m.copy, m.size)
    return 0


def record_rewind(record: np.ndarray) -> Rewind:
    """Of a component whose whole state is `record`, (1,)."""
    saved = record.copy()
    memory = np.array([(record.ctypes.data, saved.ctypes.data, record.nbytes)], dtype=_MEMORY)
    return Rewind(_save.address, _restore.address, memory.ctypes.data, (memory, saved))
