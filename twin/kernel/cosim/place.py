"""Where a number lies in a component's memory: all that whoever changes it on the way has to know."""

from dataclasses import dataclass

import numpy as np

from twin.kernel.cosim.component import Component


@dataclass(frozen=True)
class Place:
    """The `field` of a record in the memory of the component with the name `component`.

    `record`: names of records in records, joined by "."; "" the memory itself.
    """

    component: str
    record: str
    field: str

    def memory_of(self, owner: Component) -> np.ndarray | None:
        """The numbers there, a view (1,) or (1, size); None if `owner` has no such memory."""
        try:
            memory = owner.memory[0:1]  # type: ignore[attr-defined]
            for name in filter(None, (*self.record.split("."), self.field)):
                memory = memory[name]
            return memory
        except (AttributeError, TypeError, ValueError, IndexError):
            return None
