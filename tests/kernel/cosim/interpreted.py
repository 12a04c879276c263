"""The master as its description reads, in plain Python: what the compiled one has to equal bit for bit."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Node:
    """A component: its law, and for each input the (position in the graph, output) that feeds it."""

    sampled: bool
    period: int
    sources: tuple[tuple[int, int], ...]
    initial: tuple[float, ...]
    step: Callable[[float, float, np.ndarray, np.ndarray], None]


def interpreted(nodes: Sequence[Node], tick: float, scheme: str, last_tick: int) -> list[list[np.ndarray]]:
    """Rows of the outputs valid at each tick, one array per node, in the order of `nodes`."""
    valid = [np.array(node.initial) for node in nodes]
    newest = [np.array(node.initial) for node in nodes]

    def result(position: int, k: int) -> np.ndarray:
        node = nodes[position]
        u = []
        for source, element in node.sources:
            before = not node.sampled and not nodes[source].sampled and source < position
            seen = newest if before and scheme == "gauss_seidel" else valid
            u.append(seen[source][element])
        y = np.zeros(len(node.initial))
        node.step(k * tick, node.period * tick, np.array(u), y)
        return y

    rows = []
    for k in range(last_tick + 1):
        for position, node in enumerate(nodes):
            if node.sampled and k % node.period == 0:
                valid[position] = result(position, k)
        rows.append(list(valid))
        if k == last_tick:
            break
        for position, node in enumerate(nodes):
            if not node.sampled and k % node.period == 0:
                newest[position] = result(position, k)
        for position, node in enumerate(nodes):
            if not node.sampled and (k + 1) % node.period == 0:
                valid[position] = newest[position]
    return rows
