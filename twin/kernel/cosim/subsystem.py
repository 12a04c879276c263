"""A subsystem as a component: an inner system with finer ticks.

Examples are a drive made of several FMUs, or a drive with a fast control loop. The inner system runs a whole number of
its own ticks per outer step, in the same compiled master.
"""

from collections.abc import Sequence

import numpy as np

from twin.kernel.compiled.function import carray, copy, pointer_to
from twin.kernel.cosim.component import Component, Composite, address_of, doubles_at, integers_at, step_function
from twin.kernel.cosim.interpolation import Scheme
from twin.kernel.cosim.master import LOOP_RECORD, run_ticks
from twin.kernel.cosim.port import Port, record, width
from twin.kernel.cosim.simulation import failure_phrase
from twin.kernel.cosim.system import System
from twin.kernel.errors import InputRefused

INLET_NAME = "inlet"
"""Name of the inner component whose outputs are the subsystem's inputs."""

NO_LAST_TICK = 1 << 62

_INLET_MEMORY = record(u="i8", size="i8")
_SUBSYSTEM_MEMORY = record(loop="i8", y="i8", substeps="i8", next="i8", outlet="i8", outlet_size="i8", inlet="i8")
INNER_FAILED = 2
_loop_at = pointer_to(LOOP_RECORD)


@step_function(_INLET_MEMORY)
def _inlet_step(m, t, h, u, y):
    copy(address_of(y), m.u, 8 * m.size)
    return 0


@step_function(_SUBSYSTEM_MEMORY)
def _step(m, t, h, u, y):
    # the inlet's memory starts with the address it reads from
    carray(integers_at(m.inlet), 1)[0] = address_of(u)
    loop = carray(_loop_at(m.loop), 1)[0]
    done = run_ticks(loop, m.next, m.substeps, 0)
    if loop.culprit >= 0:
        # a continuous component fails in a tick that is already counted
        m.next += done - (1 if loop.culprit >= loop.sampled else 0)
        return INNER_FAILED
    m.next += m.substeps
    inner, outer = carray(doubles_at(m.y), loop.width), carray(y, m.outlet_size)
    outlet = carray(integers_at(m.outlet), m.outlet_size)
    for j in range(m.outlet_size):
        outer[j] = inner[outlet[j]]
    return 0


class Subsystem(Composite):
    """A component whose step is `substeps` ticks (of `tick` s) of an inner system.

    Inner wires refer to the ports `inputs` as "inlet.<port>". `outputs` are (port, "component.port" of the inner
    system), which `outlets` has by name. If sampled, it is evaluated at t_k, and earlier outputs are meaningless.
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
        sampled: bool = False,
    ):
        if substeps < 1:
            raise InputRefused(f"{name}: {substeps} substeps; expected at least 1")
        inlet_memory = np.array([(0, width(inputs))], dtype=_INLET_MEMORY)
        inlet = Component(
            INLET_NAME, (), inputs, True, _inlet_step.address, inlet_memory.ctypes.data, np.zeros(width(inputs)),
            keep=inlet_memory,
        )  # fmt: skip
        self.system = System([inlet, *components], wires, tick, scheme)
        # without the inlet, whose values are set again in every step
        self.members = self.system.components[1:]
        self.wires, self.outlets = tuple(wires), {port.name: source for port, source in outputs}
        self._u = np.zeros(self.system.inputs_width)
        self._y = self.system.outputs()
        self._table = self.system.table(self._u, self._y)
        columns = [self.system.columns(source) for _, source in outputs]
        self._outlet = np.concatenate([np.arange(c.start, c.stop) for c in columns]).astype(np.uint64)
        # a private mark, as a supervisor of the outer system sees the subsystem as one component
        self._mark = np.zeros(2, dtype=np.int64)
        self._loop = self.system.loop(self._table, self._y, self._mark, NO_LAST_TICK)
        self._memory = np.zeros(1, dtype=_SUBSYSTEM_MEMORY)
        m = self._memory[0]
        m["loop"], m["y"], m["substeps"] = self._loop.ctypes.data, self._y.ctypes.data, substeps
        m["outlet"], m["outlet_size"] = self._outlet.ctypes.data, len(self._outlet)
        m["inlet"] = inlet_memory.ctypes.data
        super().__init__(
            name=name,
            inputs=inputs,
            outputs=tuple(port for port, _ in outputs),
            sampled=sampled,
            step_address=_step.address,
            self_address=self._memory.ctypes.data,
            initial_outputs=np.zeros(len(self._outlet)) if sampled else self._y[self._outlet.astype(int)],
            label=label,
            keep=inlet_memory,
        )

    def explain(self, status: int) -> str:
        culprit, status, tick = (int(n) for n in (*self._loop[["culprit", "status"]][0], self._memory["next"][0]))
        inside = failure_phrase(self.system, self._u, self._y, culprit, status, tick)
        return f"failed inside: {inside};"

    def pieces(self) -> dict[str, np.ndarray]:
        return {"inner_outputs": self._y, "next": self._memory["next"]} | self.member_pieces()

    def lacks_state(self, portable: bool = True) -> str:
        reasons = dict.fromkeys((c.label or c.name, why) for c in self.members if (why := c.lacks_state(portable)))
        if [label for label, _ in reasons] == [self.label]:
            return next(why for _, why in reasons)
        return "; ".join(f"has {label}, which {why}" for label, why in reasons)
