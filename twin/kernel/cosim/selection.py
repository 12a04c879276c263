"""Adapter that exposes a component through wider ports; the additional output values are 0."""

from collections.abc import Sequence

import numpy as np

from twin.kernel.compiled.function import carray
from twin.kernel.cosim.component import (
    Component,
    Composite,
    Holder,
    Rewind,
    call_step,
    doubles_at,
    integers_at,
    step_function,
)
from twin.kernel.cosim.port import Port, record, width

_SELECTION_MEMORY = record(
    step="i8", self="i8", taken="i8", u="i8", inputs="i8", given="i8", y="i8", outputs="i8", width="i8"
)


@step_function(_SELECTION_MEMORY)
def _step(m, t, h, u, y):
    outer, taken, inner = carray(u, 1), carray(integers_at(m.taken), m.inputs), carray(doubles_at(m.u), m.inputs)
    for i in range(m.inputs):
        inner[i] = outer[taken[i]]
    status = call_step(m.step, (m.self, t, h, m.u, m.y))
    out, given, values = carray(y, m.width), carray(integers_at(m.given), m.outputs), carray(doubles_at(m.y), m.outputs)
    for i in range(m.width):
        out[i] = 0.0
    for i in range(m.outputs):
        out[given[i]] = values[i]
    return status


class Selection(Composite):
    """A component that exposes an inner component through wider ports; outer outputs that are not `given` are 0.

    For each inner input value, `taken` has the index of the outer one; `given` likewise for outputs.
    """

    def __init__(
        self,
        inner: Component,
        inputs: tuple[Port, ...],
        outputs: tuple[Port, ...],
        taken: Sequence[int],
        given: Sequence[int],
    ):
        self.inner, self.members = inner, (inner,)
        arrays = (
            np.array(taken, dtype=np.uint64), np.zeros(max(1, len(taken))),
            np.array(given, dtype=np.uint64), inner.initial_outputs.copy(),
        )  # fmt: skip
        self._values = arrays[3]
        addresses = [one.ctypes.data for one in arrays]
        memory = np.array(
            [(inner.step_address, inner.self_address, *addresses[:2], len(taken), *addresses[2:], len(given),
              width(outputs))],
            dtype=_SELECTION_MEMORY,
        )  # fmt: skip
        initial = np.zeros(width(outputs))
        initial[list(given)] = inner.initial_outputs
        super().__init__(
            name=inner.name,
            inputs=inputs,
            outputs=outputs,
            sampled=inner.sampled,
            step_address=_step.address,
            self_address=memory.ctypes.data,
            initial_outputs=initial,
            period=inner.period,
            label=inner.label,
            finite=inner.finite,
            keep=(memory, arrays),
        )

    def explain(self, status: int) -> str:
        return self.inner.explain(status)

    def pieces(self) -> dict[str, np.ndarray]:
        return self.inner.pieces() | {"given": self._values}

    def holders(self) -> dict[str, Holder]:
        return self.inner.holders()

    def lacks_state(self, portable: bool = True) -> str:
        return self.inner.lacks_state(portable)

    def rewind(self) -> Rewind | None:
        return self.inner.rewind()
