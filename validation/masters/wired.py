"""A few FMUs and their wires, for `twin cosim` and for OMSimulator: what both make of them, step by step."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from twin.kernel.fmi.description import Kind
from twin.kernel.systems.choice import MasterChoice
from validation.joined import joined

MODEL_EXCHANGE: Mapping[str, Kind] = {"": "model_exchange"}


@dataclass(frozen=True)
class Wired:
    """FMUs and wires.

    Attributes:
        parts: FMU of each component.
        wires: from an output to an input, each as `component.variable`.
        seen: outputs whose values are compared.
        tick: length of a step (s). ticks: how many steps.
        settings: start values.
        units: whether wires are to have the same unit at both ends.
    """

    parts: Mapping[str, Path]
    wires: tuple[tuple[str, str], ...]
    seen: tuple[str, ...]
    tick: float
    ticks: int
    settings: Mapping[str, float] = field(default_factory=dict)
    units: bool = True

    def in_twin(self, choice: MasterChoice, every: int = 1) -> NDArray[np.float64]:
        """The seen outputs every so many ticks, from the start on, in `twin cosim`; (rows, outputs).

        Raises:
            TwinError: it is refused, or fails.
        """
        settings = [f"{name}={value!r}" for name, value in self.settings.items()]
        stop = self.ticks * self.tick
        found = joined(self.parts, choice, stop, self.seen, self.wires, settings, every=every, units=self.units)
        return np.column_stack([found[name] for name in self.seen])
