"""Components and what feeds them while faults are being put between them."""

from collections.abc import Iterable, Mapping, Sequence

from twin.cosim.component import Component
from twin.cosim.system import End
from twin.errors import InputRefused


class Circuit:
    """A copy of a system's components and feeds; the components themselves are shared.

    Attributes:
        components: in the order in which a tick evaluates them.
        feeds: see `twin.cosim.system`.
    """

    def __init__(self, components: Iterable[Component], feeds: Mapping[End, End]):
        self.components = list(components)
        self.feeds = dict(feeds)
        self._stand_ins: dict[End, End] = {}

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

    def has(self, name: str) -> bool:
        """Whether there is a component `name`."""
        return any(component.name == name for component in self.components)

    def put_behind(self, fault: Component, outputs: Sequence[End], inputs: Sequence[End]) -> None:
        """Feed `inputs` of `fault` from `outputs` (or the faults behind them); who read these reads it instead.

        Args:
            inputs: of the fault, which has outputs of the same names.
        """
        sources = [self._stand_ins.get(output, output) for output in outputs]
        instead = dict(zip(sources, inputs, strict=True))
        self.feeds = {target: instead.get(source, source) for target, source in self.feeds.items()}
        self.feeds.update(zip(inputs, sources, strict=True))
        self._stand_ins.update(zip(outputs, inputs, strict=True))
        self.place(fault, sources)

    def put_before(self, fault: Component, targets: Sequence[End], inputs: Sequence[End]) -> None:
        """Let `fault` feed `targets` from what has fed them; `inputs`: its own, and its outputs of the same names."""
        sources = [self.feeds[target] for target in targets]
        self.feeds.update(zip(targets, inputs, strict=True))
        self.feeds.update(zip(inputs, sources, strict=True))
        self.place(fault, sources)

    def place(self, fault: Component, sources: Iterable[End]) -> None:
        """Right behind the last component that feeds it; behind one that may return NaN, it may too."""
        feeding = {source.component for source in sources}
        fault.finite = fault.finite and all(c.finite for c in self.components if c.name in feeding)
        self.components.insert(1 + max(i for i, c in enumerate(self.components) if c.name in feeding), fault)
