"""Random co-simulations: components with random linear maps and states, wired at random."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from hypothesis import strategies as st

from tests.kernel.cosim.interpreted import Node
from twin.kernel.cosim.port import Port
from twin.kernel.cosim.python_class import PythonComponent


@dataclass(frozen=True)
class Shape:
    """A component without its weights; `sources` as in `Node`."""

    sampled: bool
    period: int
    outputs: int
    sources: tuple[tuple[int, int], ...]


class Linear:
    """x <- A x + B u + a t + b h, y = x, with weights drawn from `seed`."""

    def __init__(self, shape: Shape, seed: int):
        random = np.random.default_rng(seed)
        inputs, outputs = len(shape.sources), shape.outputs
        # contracting, so that no graph overflows
        self._A = random.uniform(-0.5, 0.5, (outputs, outputs)) / max(1, outputs)
        self._B = random.uniform(-0.5, 0.5, (outputs, inputs)) / max(1, inputs)
        self._a, self._b = random.uniform(-1.0, 1.0, (2, outputs))
        self.x = random.uniform(-1.0, 1.0, outputs)
        self.inputs: Sequence[Port] = (Port("u", inputs),)
        self.outputs: Sequence[Port] = (Port("y", outputs),)
        self.sampled = shape.sampled

    def step(self, t: float, h: float, u: np.ndarray, y: np.ndarray) -> None:
        self.x = self._A @ self.x + self._B @ u + self._a * t + self._b * h
        y[:] = self.x


@st.composite
def shapes(draw: st.DrawFn) -> list[Shape]:
    """One to six components of up to three rates, each input fed by any output of any component."""
    sizes = draw(st.lists(st.integers(1, 3), min_size=1, max_size=6))
    rates = draw(st.sampled_from([(1,), (1, 2), (1, 3), (2, 3), (1, 2, 5), (2, 3, 4)]))
    ends = [(node, element) for node, size in enumerate(sizes) for element in range(size)]
    return [
        Shape(
            sampled=draw(st.booleans()),
            period=draw(st.sampled_from(rates)),
            outputs=size,
            sources=tuple(draw(st.lists(st.sampled_from(ends), max_size=3))),
        )
        for size in sizes
    ]


def nodes(graph: list[Shape]) -> list[Node]:
    """`graph` for the interpreted master, with fresh states."""
    models = [Linear(shape, seed) for seed, shape in enumerate(graph)]
    return [
        Node(shape.sampled, shape.period, shape.sources, tuple(model.x), model.step)
        for shape, model in zip(graph, models, strict=True)
    ]


def components(graph: list[Shape]) -> list[PythonComponent]:
    """`graph` for the compiled master, with fresh states; named c0, c1, ..."""
    models = [Linear(shape, seed) for seed, shape in enumerate(graph)]
    return [
        PythonComponent(f"c{i}", model, shape.period, model.x.tolist())
        for i, (shape, model) in enumerate(zip(graph, models, strict=True))
    ]


def wires(graph: list[Shape]) -> list[tuple[str, str]]:
    return [
        (f"c{node}.y[{element}]", f"c{i}.u[{j}]")
        for i, shape in enumerate(graph)
        for j, (node, element) in enumerate(shape.sources)
    ]
