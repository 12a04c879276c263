"""What the master needs to know of a component."""

from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from twin.cosim.rewind import Rewind, record_rewind

NOT_FINITE = 1 << 32
"""Status the master gives a component whose step returned NaN or infinity; beyond int32, so no step can return it."""


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
        before = [port.name for port in self.outputs].index(name)
        start = width(self.outputs[:before])
        return self.initial_outputs[start : start + self.outputs[before].size]

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
        keep: what `memory` points to.
        rewindable: whether all that its steps change lies in `memory` itself.
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
    ):
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
        self.memory = memory
        self._rewindable = rewindable

    def rewind(self) -> Rewind | None:
        return record_rewind(self.memory) if self._rewindable else None


def width(ports: tuple[Port, ...]) -> int:
    """Number of doubles that `ports` take together."""
    return sum(port.size for port in ports)


def named_values(ports: tuple[Port, ...], values: np.ndarray) -> str:
    """`omega_ref = 0.13 rad/s, tau_load = 0.061 N m`: the values of `ports`, for people."""
    texts, start = [], 0
    for port in ports:
        part = values[start : start + port.size]
        start += port.size
        shown = f"{part[0]:.6g}" if port.size == 1 else "(" + ", ".join(f"{v:.6g}" for v in part) + ")"
        texts.append(f"{port.name} = {shown}" + ("" if port.unit == "1" else f" {port.unit}"))
    return ", ".join(texts)
