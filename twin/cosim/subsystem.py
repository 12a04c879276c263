"""A system inside a component: finer steps, components of its own, one place in the outer system.

A drive made of several FMUs, or one with a fast loop in front of it, is a system with its own tick that runs a whole
number of times per outer step. The inner loop is the same compiled master.
"""

from collections.abc import Sequence

import numpy as np
from numba import carray, from_dtype, types

from twin.cosim.component import Component
from twin.cosim.failure import failed_phrase
from twin.cosim.interpolation import Scheme
from twin.cosim.master import TABLE, advance
from twin.cosim.native import address_of, doubles_at, integers_at, pointer_to, step_function
from twin.cosim.port import Port, width
from twin.cosim.system import System
from twin.errors import InputRefused

INLET = "inlet"
"""The inner component whose outputs are the subsystem's inputs."""

NEVER = 1 << 62

_INLET_MEMORY = np.dtype([("u", "i8"), ("size", "i8")], align=True)
_MEMORY = np.dtype(
    [
        ("table", "i8"),
        ("components", "i8"),
        ("sampled", "i8"),
        ("y", "i8"),
        ("y_size", "i8"),
        ("tick", "f8"),
        ("substeps", "i8"),
        ("next", "i8"),
        ("outlet", "i8"),
        ("outlet_size", "i8"),
        ("inlet", "i8"),
        ("culprit", "i8"),
        ("status", "i8"),
        ("mark", "i8"),
    ],
    align=True,
)
INNER_FAILED = 2
_table_at, _marks_at = pointer_to(from_dtype(TABLE)), pointer_to(types.int64)


@step_function(_INLET_MEMORY)
def _inlet_step(m, t, h, u, y):
    outer, inner = carray(doubles_at(m.u), m.size), carray(y, m.size)
    for j in range(m.size):
        inner[j] = outer[j]
    return 0


@step_function(_MEMORY)
def _step(m, t, h, u, y):
    # the inlet's memory starts with the address it reads from
    carray(integers_at(m.inlet), 1)[0] = address_of(u)
    inner = carray(doubles_at(m.y), m.y_size)
    no_rows = carray(doubles_at(m.y), (m.substeps, 0))
    table = carray(_table_at(m.table), m.components)
    mark = carray(_marks_at(m.mark), 2)
    done, culprit, status = advance(
        table, m.sampled, False, m.tick, inner, m.y_size // 2, 1, no_rows, m.next, m.substeps, NEVER, mark
    )
    if culprit >= 0:
        # a continuous component fails in the tick whose row was already done
        m.culprit, m.status, m.next = culprit, status, m.next + done - (1 if culprit >= m.sampled else 0)
        return INNER_FAILED
    m.next += m.substeps
    outlet, outer = carray(integers_at(m.outlet), m.outlet_size), carray(y, m.outlet_size)
    for j in range(m.outlet_size):
        outer[j] = inner[outlet[j]]
    return 0


class Subsystem(Component):
    """A continuous component whose step is `substeps` ticks of an inner system.

    Args:
        name: of the component.
        inputs: its ports; inner wires take them from the component "inlet".
        outputs: (port, "component.port" of the inner system) pairs.
        components, wires, scheme: the inner system; `wires` name inlets as "inlet.<port>".
        tick: of the inner system (s).
        substeps: inner ticks per outer step.
        label: what an error sentence calls it.

    Attributes:
        system, wires: the inner system.
        outlets: by the name of an output, "component.port" of the inner system.

    Raises:
        InputRefused: as `System`.
    """

    def __init__(
        self,
        name: str,
        inputs: tuple[Port, ...],
        outputs: Sequence[tuple[Port, str]],
        components: Sequence[Component],
        wires: Sequence[tuple[str, str]],
        tick: float,
        substeps: int,
        scheme: Scheme = "gauss_seidel",
        label: str = "",
    ):
        if substeps < 1:
            raise InputRefused(f"{name}: {substeps} substeps; expected at least 1")
        inlet_memory = np.array([(0, width(inputs))], dtype=_INLET_MEMORY)
        inlet = Component(
            INLET, (), inputs, True, _inlet_step.address, inlet_memory.ctypes.data, np.zeros(width(inputs)),
            keep=inlet_memory,
        )  # fmt: skip
        self.system = System([inlet, *components], wires, tick, scheme)
        self.wires, self.outlets = tuple(wires), {port.name: source for port, source in outputs}
        self._u = np.zeros(self.system.inputs_width)
        self._y = self.system.outputs()
        self._table = self.system.table(self._u, self._y)
        columns = [self.system.columns(source) for _, source in outputs]
        self._outlet = np.concatenate([np.arange(c.start, c.stop) for c in columns]).astype(np.uint64)
        # nobody watches inside: whoever watches the outer system is told of this component
        self._mark = np.zeros(2, dtype=np.int64)
        self._memory = np.zeros(1, dtype=_MEMORY)
        m = self._memory[0]
        m["table"], m["components"] = self._table.ctypes.data, len(self._table)
        m["sampled"], m["tick"], m["substeps"] = self.system.sampled, tick, substeps
        m["y"], m["y_size"] = self._y.ctypes.data, len(self._y)
        m["outlet"], m["outlet_size"] = self._outlet.ctypes.data, len(self._outlet)
        m["inlet"], m["mark"] = inlet_memory.ctypes.data, self._mark.ctypes.data
        super().__init__(
            name=name,
            inputs=inputs,
            outputs=tuple(port for port, _ in outputs),
            sampled=False,
            step_address=_step.address,
            self_address=self._memory.ctypes.data,
            initial_outputs=self._y[self._outlet.astype(int)],
            label=label,
            keep=inlet_memory,
        )

    def explain(self, status: int) -> str:
        m = self._memory[0]
        culprit, tick = int(m["culprit"]), int(m["next"])
        inside = failed_phrase(self.system, self._u, self._y, culprit, int(m["status"]), tick)
        return f"failed inside: {inside};"

    def keep_time(self, clock: np.ndarray) -> None:
        for component in self.system.components:
            component.keep_time(clock)

    def said(self) -> list[tuple[int, str]]:
        return [told for component in self.system.components for told in component.said()]

    def close(self) -> None:
        for component in self.system.components:
            component.close()
