"""Wires value by value: which output feeds which input, for whoever builds a system or puts something into it."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Literal, NamedTuple

from twin.cosim.component import Component
from twin.cosim.port import Port

Side = Literal["input", "output"]


class End(NamedTuple):
    """One value of a port: an end of a wire."""

    component: str
    port: str
    element: int = 0


Feeds = dict[End, End]
"""By each value of an input the value of an output that feeds it."""


def ends(components: Iterable[Component], side: Side, port: str) -> list[End]:
    """Every value of the port called `port` of those of `components` that have one, in order."""
    return [
        End(component.name, port, index)
        for component in components
        for found in _ports(component, side)
        if found.name == port
        for index in range(found.size)
    ]


def wires(feeds: Mapping[End, End], components: Sequence[Component]) -> list[tuple[str, str]]:
    """The same as pairs of texts that `System` takes, a wire for each port that is fed as a whole by another one."""
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
            found.append((_text(source), _text(target)))
        elif target.element == 0:
            found.append((f"{source.component}.{source.port}", f"{target.component}.{target.port}"))
    return found


def _ports(component: Component, side: str) -> tuple[Port, ...]:
    return component.inputs if side == "input" else component.outputs


def _text(end: End) -> str:
    return f"{end.component}.{end.port}[{end.element}]"
