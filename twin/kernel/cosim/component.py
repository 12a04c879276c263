"""What the master needs to know of a component."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from twin.kernel.cosim.port import Port, by_port, width
from twin.kernel.cosim.rewind import Rewind, record_rewind

NOT_FINITE = 1 << 32
"""Status the master gives a component whose step returned NaN or infinity; beyond int32, so no step can return it."""


@dataclass
class Component:
    """One participant of a co-simulation, stepped by address.

    `int32 step(void *self, double t, double h, const double *u, double *y)` reads the inputs `u`, writes the outputs
    `y` and returns 0 (or 1, a warning); anything else stops the run.

    Attributes:
        name: unique in the system.
        inputs, outputs: ports, in the order in which `u` and `y` hold them.
        sampled: True: evaluated AT t_k, no time passes in it. False: goes from t_k to t_k + h.
        step_address, self_address: the step function and its memory.
        initial_outputs: outputs that are valid before tick 0.
        period: in ticks.
        label: what an error sentence calls it (an FMU's file name, say).
        finite: whether NaN or infinity in an output is a failure that ends the run. False for what plays a broken
            sensor, and for what must live on behind one.
        keep: whatever owns the memory behind the addresses.
    """

    name: str
    inputs: tuple[Port, ...]
    outputs: tuple[Port, ...]
    sampled: bool
    step_address: int
    self_address: int
    initial_outputs: np.ndarray
    period: int = 1
    label: str = ""
    finite: bool = True
    keep: Any = field(default=None, repr=False)

    def initial(self, name: str) -> np.ndarray:
        """Initial values of the output port `name`."""
        return by_port(self.outputs, self.initial_outputs)[name]

    def explain(self, status: int) -> str:
        """What a bad `status` of this component's step means, as the verb phrase of a sentence."""
        return f"returned status {status}"

    def rewind(self) -> Rewind | None:
        """How to repeat its steps, from now on possible; None: it cannot."""
        return None

    def keep_time(self, clock: np.ndarray) -> None:
        """Take note of the clock of the simulation it is part of: `clock[0]` is the tick being stepped."""

    def said(self) -> list[tuple[int, str]]:
        """(tick, text): what it had to say since it was last asked, for people."""
        return []

    def close(self) -> None:
        """Release what the component holds outside Python's memory."""


class NativeComponent(Component):
    """A component with a compiled step over a record, as most are.

    Args:
        name, inputs, outputs, sampled, period: see `Component`.
        step: made by `native.step_function`.
        memory: (1,) record that the step works on.
        initial_outputs: zeros if not given; a sampled component overwrites them at tick 0.
        keep: what `memory` points to, unless `pointers` says it.
        rewindable: whether all that its steps change lies in `memory` itself.
        pointers: by field of `memory` the array whose address is put there; then all that the step works on is known,
            and can be taken elsewhere.

    Attributes:
        step, memory, pointers: see there.
        portable: whether `memory` and `pointers` are all that the step works on.
    """

    def __init__(
        self,
        name: str,
        inputs: tuple[Port, ...],
        outputs: tuple[Port, ...],
        sampled: bool,
        step: Any,
        memory: np.ndarray,
        initial_outputs: np.ndarray | None = None,
        period: int = 1,
        keep: Any = None,
        rewindable: bool = False,
        pointers: Mapping[str, np.ndarray] | None = None,
    ):
        self.step, self.memory, self.pointers, self.portable = step, memory, dict(pointers or {}), keep is None
        for field_name, array in self.pointers.items():
            memory[field_name] = array.ctypes.data
        super().__init__(
            name=name,
            inputs=inputs,
            outputs=outputs,
            sampled=sampled,
            step_address=step.address,
            self_address=memory.ctypes.data,
            initial_outputs=np.zeros(width(outputs)) if initial_outputs is None else initial_outputs,
            period=period,
            keep=(memory, keep),
        )
        self._rewindable = rewindable

    def rewind(self) -> Rewind | None:
        return record_rewind(self.memory) if self._rewindable else None
