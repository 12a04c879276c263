"""Systems: components joined by wires, checked as a whole before the first step.

Wires can also be handled value by value (`Feeds`), for code that builds a system or inserts components.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from twin.kernel.cosim.component import Component, Rewind
from twin.kernel.cosim.interpolation import VALID_WEIGHTS, Inputs, Scheme, input_weights
from twin.kernel.cosim.master import COMPONENT_RECORD, LOOP_RECORD
from twin.kernel.cosim.port import Port, width
from twin.kernel.errors import InputRefused, nearest

Side = Literal["input", "output"]
_END_PATTERN = re.compile(r"(?P<component>[^.]+)\.(?P<port>[^.\[]+)(\[(?P<index>\d+)\])?")


class End(NamedTuple):
    """An end of a wire: a single value of a component's port."""

    component: str
    port: str
    element: int = 0

    def __str__(self) -> str:
        return f"{self.component}.{self.port}[{self.element}]"


Feeds = dict[End, End]
"""Source of each input value: input value -> output value."""


def ends(components: Iterable[Component], side: Side, port: str) -> list[End]:
    """Return the wire ends of all elements of port `port`, over the components that have it, in component order."""
    return [
        End(component.name, port, index)
        for component in components
        for found in _ports(component, side)
        if found.name == port
        for index in range(found.size)
    ]


def wires(feeds: Mapping[End, End], components: Sequence[Component]) -> list[tuple[str, str]]:
    """Convert value-by-value feeds to wires for `System`; ports that are fed as a whole by one port become one wire."""
    sizes = {
        (component.name, side, port.name): port.size
        for component in components
        for side in ("input", "output")
        for port in _ports(component, side)
    }
    found: list[tuple[str, str]] = []
    for target, source in feeds.items():
        size = sizes.get((target.component, "input", target.port), 0)
        inside = [End(target.component, target.port, index) for index in range(size)]
        whole = size == sizes.get((source.component, "output", source.port)) and all(
            feeds.get(end) == End(source.component, source.port, end.element) for end in inside
        )
        if not whole:
            found.append((str(source), str(target)))
        elif target.element == 0:
            found.append((f"{source.component}.{source.port}", f"{target.component}.{target.port}"))
    return found


def _ports(component: Component, side: str) -> tuple[Port, ...]:
    return component.inputs if side == "input" else component.outputs


@dataclass(frozen=True)
class Slots:
    """Position of a wire's end in the vector of all inputs or all outputs of a system."""

    start: int
    size: int
    component: int


class MemoryChange(NamedTuple):
    """A scheduled change of a value in component memory: `memory[...] = value` at `tick`."""

    tick: int
    memory: np.ndarray
    value: float


class System:
    """A co-simulation ready to run: components, wires, coupling scheme and tick.

    Args:
        components: in any order of kinds; the order within the sampled and within the continuous ones is the order of
            evaluation.
        wires: pairs (output, input) like `"arm.torque[0]", "motor_1.load"`; an index selects one element.
        tick: duration of a tick (s), > 0.
        scheme: "gauss_seidel": a continuous component reads the newest outputs of earlier ones (for a slower component,
            the result of its present step), and the outputs at t_k of later ones. "jacobi": all read outputs at t_k.
        inputs: inputs of continuous components from each other. "hold": the value according to the scheme, constant
            over the step. "linear": the value in the middle of the step, or at the port's `instant`, interpolated
            between both ends as far as the scheme knows them, else extrapolated from the previous step.
        iterations: number of times the continuous components make each step; repetitions use the results of all others.

    Attributes:
        changes: scheduled changes of memory in every simulation of the system, by ascending tick; empty by default.
        first_tick: tick at which its simulations begin.

    Raises:
        InputRefused: an unknown or repeated component or port name, sizes that differ, an input without or with two
            wires; with interpolation or iterations, a continuous component that cannot repeat a step or does not step
            every tick.
    """

    changes: tuple[MemoryChange, ...] = ()
    first_tick: int = 0

    def __init__(
        self,
        components: Sequence[Component],
        wires: Iterable[tuple[str, str]],
        tick: float,
        scheme: Scheme = "gauss_seidel",
        inputs: Inputs = "hold",
        iterations: int = 1,
    ):
        self.components = tuple(sorted(components, key=lambda c: not c.sampled))
        self.tick = tick
        self.scheme = scheme
        self.inputs = inputs
        self.iterations = iterations
        self.sampled = sum(c.sampled for c in self.components)
        names = [c.name for c in self.components]
        for name in names:
            if names.count(name) > 1:
                raise InputRefused(f"two components are called '{name}'; give each a name of its own")
        for component in self.components:
            for ports in (component.inputs, component.outputs):
                called = [port.name for port in ports]
                for name in called:
                    if called.count(name) > 1:
                        raise InputRefused(f"{component.name}: two ports are called '{name}'; give each its own name")
            if component.period < 1:
                raise InputRefused(f"{component.name}: period {component.period}; expected at least 1 tick")
            if len(component.initial_outputs) != width(component.outputs):
                raise InputRefused(
                    f"{component.name}: {len(component.initial_outputs)} initial outputs; "
                    f"its ports need {width(component.outputs)}"
                )
        self.u_start = _starts([width(c.inputs) for c in self.components])
        self.y_start = _starts([width(c.outputs) for c in self.components])
        self.sources = self._connect(list(wires))
        self._weights = self._interpolation_weights() if self.interpolates else []
        self._rewinds = self._step_rewinds() if iterations > 1 else []

    @property
    def interpolates(self) -> bool:
        """Whether inputs of continuous components are weighted sums of outputs at several instants."""
        return self.inputs != "hold" or self.iterations > 1

    @property
    def has_separate_newest(self) -> bool:
        """Whether the newest outputs of components are stored separately from the valid ones.

        Not in Gauss-Seidel order if all step every tick, as every replaced value has been read before.
        """
        every = all(c.period == 1 for c in self.components[self.sampled :])
        return self.interpolates or self.scheme != "gauss_seidel" or not every

    @property
    def inputs_width(self) -> int:
        return int(self.u_start[-1])

    @property
    def outputs_width(self) -> int:
        return int(self.y_start[-1])

    def outputs(self) -> np.ndarray:
        """Allocate the initial outputs: (outputs_width,), times 2 if newest are separate, times 3 if interpolated."""
        valid = np.concatenate([np.zeros(0), *(c.initial_outputs for c in self.components)])
        return np.tile(valid, 3 if self.interpolates else 1 + self.has_separate_newest)

    def table(self, u: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Make the table of components for the compiled loop, `COMPONENT_RECORD` (number of components,).

        `u` is the memory of all inputs, (inputs_width,), `y` the memory of all outputs, from `outputs`. The table
        contains addresses of these and of this system without keeping them alive.
        """
        table = np.zeros(len(self.components), dtype=COMPONENT_RECORD)
        table["step"] = [c.step_address for c in self.components]
        table["self"] = [c.self_address for c in self.components]
        table["period"] = [c.period for c in self.components]
        table["finite"] = [c.finite for c in self.components]
        table["unread"] = [0 if c.unread is None else c.unread.ctypes.data for c in self.components]
        table["sources"] = self.sources.ctypes.data + self.sources.itemsize * self.u_start[:-1]
        table["u"], table["u_size"] = u.ctypes.data + u.itemsize * self.u_start[:-1], np.diff(self.u_start)
        table["valid"], table["y_size"] = y.ctypes.data + y.itemsize * self.y_start[:-1], np.diff(self.y_start)
        table["newest"] = table["valid"]
        table["newest"][self.sampled :] += y.itemsize * self.outputs_width * self.has_separate_newest
        if self.interpolates:
            table["before"][self.sampled :] = table["newest"][self.sampled :] + y.itemsize * self.outputs_width
            table["weights"][self.sampled :] = [weights.ctypes.data for weights in self._weights]
        if self._rewinds:
            table["save"][self.sampled :] = [rewind.save_address for rewind in self._rewinds]
            table["restore"][self.sampled :] = [rewind.restore_address for rewind in self._rewinds]
            table["rewind"][self.sampled :] = [rewind.self_address for rewind in self._rewinds]
        return table

    def loop(self, table: np.ndarray, y: np.ndarray, mark: np.ndarray, last: int) -> np.ndarray:
        """Make the record of the compiled loop, `LOOP_RECORD` (1,), without rows; it keeps no argument alive."""
        loop = np.zeros(1, dtype=LOOP_RECORD)
        m = loop[0]
        m["table"], m["components"], m["sampled"] = table.ctypes.data, len(table), self.sampled
        m["iterations"], m["dt"], m["last"], m["mark"] = self.iterations, self.tick, last, mark.ctypes.data
        m["apart"], m["y"], m["width"] = self.has_separate_newest, y.ctypes.data, self.outputs_width
        return loop

    def columns(self, end: str) -> slice:
        """Return the columns in an output row of the output `"component.port"`."""
        slots = self._slots(end, "output")
        return slice(slots.start, slots.start + slots.size)

    def has_output(self, end: str) -> bool:
        """Whether the system has the output `"component.port"`."""
        name, _, port = end.partition(".")
        return any(c.name == name and any(p.name == port for p in c.outputs) for c in self.components)

    def component(self, name: str) -> Component:
        return self.components[self._position(name, name)]

    def _connect(self, wires: list[tuple[str, str]]) -> np.ndarray:
        sources = np.full(self.inputs_width, -1, dtype=np.int64)
        # interpolated inputs select the copy by weights instead
        apart = self.has_separate_newest and not self.interpolates
        for source, target in wires:
            from_, to = self._slots(source, "output"), self._slots(target, "input")
            if from_.size != to.size:
                raise InputRefused(f"wire {source} -> {target}: {from_.size} values into {to.size}")
            if np.any(sources[to.start : to.start + to.size] >= 0):
                raise InputRefused(f"input {target} is fed by two wires; remove one ({source})")
            newest = self.outputs_width * (apart and self.sees_newest(from_.component, to.component))
            sources[to.start : to.start + to.size] = newest + from_.start + np.arange(from_.size)
        for c, component in enumerate(self.components):
            start = self.u_start[c]
            for port in component.inputs:
                if np.any(sources[start : start + port.size] < 0):
                    raise InputRefused(f"input {component.name}.{port.name} has no wire; connect an output to it")
                start += port.size
        return sources

    def _interpolation_weights(self) -> list[np.ndarray]:
        """Return the interpolation weights (2, inputs, 3) of each continuous component."""
        found = []
        for c in range(self.sampled, len(self.components)):
            component = self.components[c]
            if component.period != 1:
                raise InputRefused(
                    f"{component.name}: steps every {component.period} ticks; interpolated inputs and repeated steps "
                    "need continuous components that step every tick"
                )
            ports = [port for port in component.inputs for _ in range(port.size)]
            sources = self.sources[self.u_start[c] : self.u_start[c + 1]]
            owners = np.searchsorted(self.y_start, sources, side="right") - 1
            weights = [
                np.array([VALID_WEIGHTS, VALID_WEIGHTS])
                if owner < self.sampled
                else input_weights(port, self.sees_newest(int(owner), c), self.inputs)
                for port, owner in zip(ports, owners, strict=True)
            ]
            found.append(np.ascontiguousarray(np.reshape(weights, (-1, 2, 3)).swapaxes(0, 1)))
        return found

    def _step_rewinds(self) -> list[Rewind]:
        rewinds = []
        for component in self.components[self.sampled :]:
            rewind = component.rewind()
            if rewind is None:
                raise InputRefused(
                    f"{component.label or component.name}: cannot go back to the start of a step, which iterations = "
                    f"{self.iterations} needs; use iterations = 1"
                )
            rewinds.append(rewind)
        return rewinds

    def sees_newest(self, source: int, target: int) -> bool:
        """Whether continuous component `target` (number) reads the result of component `source` in the same step."""
        return self.scheme == "gauss_seidel" and self.sampled <= source < target

    def _position(self, name: str, end: str) -> int:
        names = [c.name for c in self.components]
        if name not in names:
            raise InputRefused(f"wire end '{end}': no component '{name}'; {nearest(name, names, 'there are {}')}")
        return names.index(name)

    def _slots(self, end: str, side: Literal["input", "output"]) -> Slots:
        match = _END_PATTERN.fullmatch(end)
        if match is None:
            raise InputRefused(f"wire end '{end}': expected component.port or component.port[index]")
        c = self._position(match["component"], end)
        component = self.components[c]
        ports = _ports(component, side)
        start = int((self.u_start if side == "input" else self.y_start)[c])
        for port in ports:
            if port.name == match["port"]:
                if match["index"] is None:
                    return Slots(start, port.size, c)
                if int(match["index"]) >= port.size:
                    raise InputRefused(f"wire end '{end}': {port.name} has {port.size} values, counted from 0")
                return Slots(start + int(match["index"]), 1, c)
            start += port.size
        hint = nearest(match["port"], [port.name for port in ports], "there are {}")
        raise InputRefused(f"wire end '{end}': {component.name} has no {side} '{match['port']}'; {hint}")


def _starts(sizes: list[int]) -> np.ndarray:
    return np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)
