"""Where a number lies in a component's memory: all that whoever changes it on the way has to know."""

from dataclasses import dataclass

import numpy as np

from twin.cosim.component import Component


@dataclass(frozen=True)
class Place:
    """The `field` of the part `record` of the memory of the component with the name `component`."""

    component: str
    record: str
    field: str

    def memory_of(self, owner: Component) -> np.ndarray | None:
        """The numbers there, a view (1,) or (1, size); None if `owner` has no such memory."""
        try:
            return owner.memory[self.record][self.field]  # type: ignore[attr-defined]
        except (AttributeError, TypeError, ValueError, IndexError):
            return None
