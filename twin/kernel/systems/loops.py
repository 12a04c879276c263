"""Algebraic loops of a system, found from the direct feedthrough that its FMUs declare."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from twin.kernel.fmi.description import feedthrough
from twin.kernel.systems.plan import SystemPart, SystemPlan

Graph = Mapping[str, Sequence[str]]


@dataclass(frozen=True)
class AlgebraicLoop:
    """A cycle of outputs and inputs that depend on each other at one instant.

    `path` is one cycle, "a.y -> b.u -> b.y -> a.u". `parts` are names in the master, in step order; `silent` the
    components that do not declare the dependencies of their outputs.
    """

    path: str
    parts: tuple[str, ...]
    silent: tuple[str, ...]


def find_loops(plan: SystemPlan) -> tuple[AlgebraicLoop, ...]:
    """Find the algebraic loops of a system; loops that share a component are merged."""
    graph: dict[str, list[str]] = {}
    shown: dict[str, str] = {}
    silent: dict[str, str] = {}
    for part in plan.parts:
        depends, unsaid = feedthrough(part.description)
        for port in (*part.inputs, *part.outputs):
            shown[f"{part.name}.{port.port.name}"] = f"{part.path}.{port.variable.name}"
        for output in part.outputs:
            name = f"{part.name}.{output.port.name}"
            for entry in part.inputs:
                if entry.variable.name in depends.get(output.variable.name, ()):
                    graph.setdefault(f"{part.name}.{entry.port.name}>", []).append(f"{name}<")
            if output.variable.name in unsaid:
                silent[name] = part.path
    # the suffixes < and > distinguish an output from an input of the same name
    for source, target in plan.wires:
        graph.setdefault(f"{source}<", []).append(f"{target}>")
    found = [group for group in _cyclic_groups(graph) if len(group) > 1]
    return tuple(
        AlgebraicLoop(
            " -> ".join(shown[node[:-1]] for node in _shortest_cycle(graph, groups[0])),
            tuple(part.name for part in plan.parts if part.name in owners),
            tuple(dict.fromkeys(silent[n[:-1]] for group in groups for n in group if n[:-1] in silent)),
        )
        for owners, groups in _join_groups(found, plan.parts)
    )


def _join_groups(
    groups: Sequence[Sequence[str]], parts: Sequence[SystemPart]
) -> list[tuple[set[str], list[Sequence[str]]]]:
    """Merge groups of dependent ports that share a component; return (components, groups) each, in step order."""
    joined: list[tuple[set[str], list[Sequence[str]]]] = []
    for group in groups:
        owners, together = {node.partition(".")[0] for node in group}, [group]
        for other in [one for one in joined if one[0] & owners]:
            joined.remove(other)
            owners, together = owners | other[0], [*other[1], *together]
        joined.append((owners, together))
    order = {part.name: number for number, part in enumerate(parts)}
    return sorted(joined, key=lambda one: min(order[name] for name in one[0]))


def _cyclic_groups(graph: Graph) -> list[list[str]]:
    """Return the strongly connected components of a graph (Tarjan 1972), without recursion."""
    number: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    on_stack: set[str] = set()
    found = []
    for root in graph:
        if root in number:
            continue
        number[root] = low[root] = len(number)
        stack.append(root)
        on_stack.add(root)
        ahead = [(root, iter(graph.get(root, ())))]
        while ahead:
            node, after = ahead[-1]
            following = next(after, None)
            if following is None:
                ahead.pop()
                if ahead:
                    low[ahead[-1][0]] = min(low[ahead[-1][0]], low[node])
                if low[node] == number[node]:
                    group = stack[stack.index(node) :]
                    del stack[stack.index(node) :]
                    on_stack.difference_update(group)
                    found.append(group)
            elif following not in number:
                number[following] = low[following] = len(number)
                stack.append(following)
                on_stack.add(following)
                ahead.append((following, iter(graph.get(following, ()))))
            elif following in on_stack:
                low[node] = min(low[node], number[following])
    return found


def _shortest_cycle(graph: Graph, group: Sequence[str]) -> list[str]:
    """Return a shortest cycle from an output in `group` back to the input that feeds it."""
    inside = set(group)
    start = min(node for node in group if node.endswith("<"))
    came: dict[str, str] = {}
    ahead = [start]
    while ahead:
        node = ahead.pop(0)
        for following in graph.get(node, ()):
            if following == start:
                way = [node]
                while way[-1] != start:
                    way.append(came[way[-1]])
                return way[::-1]
            if following in inside and following not in came:
                came[following] = node
                ahead.append(following)
    raise AssertionError("a group of nodes that reach each other has a way around")
