"""Components and wires while faults are being put between them."""

import re
from collections.abc import Iterable, Sequence

from twin.cosim.component import Component
from twin.cosim.port import Port
from twin.errors import InputRefused

Wire = tuple[str, str]
_INDEX = re.compile(r"\[\d+\]$")


class Circuit:
    """A copy of a system's lists; the components themselves are shared.

    Attributes:
        components, wires: as `twin.cosim.system.System` takes them.
    """

    def __init__(self, components: Iterable[Component], wires: Iterable[Wire]):
        self.components = list(components)
        self.wires = list(wires)
        self._ends: dict[str, str] = {}

    def component(self, name: str, number: int, target: str) -> Component:
        """The component `name`, which fault `number` on `target` needs.

        Raises:
            InputRefused: there is none.
        """
        for component in self.components:
            if component.name == name:
                return component
        names = ", ".join(c.name for c in self.components) or "none"
        raise InputRefused(
            f"[[fault]] {number} target = \"{target}\": expected a system with a component '{name}'; "
            f"there are {names}. Change the target or add what it names"
        )

    def has(self, end: str) -> bool:
        """Whether the output `end`, "component.port", exists."""
        name, _, port = end.partition(".")
        return any(c.name == name and port in [p.name for p in c.outputs] for c in self.components)

    def source(self, target: str) -> str:
        """The output that feeds the input `target`."""
        return next(output for output, fed in self.wires if fed == target)

    def shaft(self, end: str) -> str:
        """The output that stands for `end` now: its own, or the one of the last fault behind it."""
        return self._ends.get(end, end)

    def split(self, name: str, port: Port) -> None:
        """Turn each wire of all of `port` of component `name` into one wire per element."""
        whole, wires = f"{name}.{port.name}", self.wires
        self.wires = []
        for wire in wires:
            apart = whole in wire
            self.wires += [(f"{wire[0]}[{i}]", f"{wire[1]}[{i}]") for i in range(port.size)] if apart else [wire]

    def put_behind(self, fault: Component, outputs: Sequence[str], inputs: Sequence[str]) -> None:
        """Feed `fault.<inputs>` from `outputs` (or the faults behind them); their readers read its outputs instead."""
        sources = [self.shaft(output) for output in outputs]
        taken = {source: f"{fault.name}.{port}" for source, port in zip(sources, inputs, strict=True)}
        self.wires = [(_moved(output, taken), target) for output, target in self.wires]
        self.wires += taken.items()
        self._ends.update({output: taken[source] for output, source in zip(outputs, sources, strict=True)})
        self.place(fault, sources)

    def put_before(self, fault: Component, targets: Sequence[str], ports: Sequence[str]) -> None:
        """Let `fault` feed the inputs `targets`, from what has fed them; `ports`: its own name of each, in and out."""
        sources = [self.source(target) for target in targets]
        replaced = [f"{fault.name}.{port}" for port in ports]
        self.wires = [wire for wire in self.wires if wire[1] not in targets]
        self.wires += [*zip(sources, replaced, strict=True), *zip(replaced, targets, strict=True)]
        self.place(fault, sources)

    def place(self, fault: Component, sources: Iterable[str]) -> None:
        """Right behind the last component that feeds it; behind one that may return NaN, it may too."""
        feeding = {source.partition(".")[0] for source in sources}
        fault.finite = fault.finite and all(c.finite for c in self.components if c.name in feeding)
        self.components.insert(1 + max(i for i, c in enumerate(self.components) if c.name in feeding), fault)


def _moved(output: str, taken: dict[str, str]) -> str:
    """`output`, or what now stands in its place, with the index it may carry."""
    if output in taken:
        return taken[output]
    port = _INDEX.sub("", output)
    return taken[port] + output[len(port) :] if port in taken else output
