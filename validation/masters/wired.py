"""A few FMUs and their wires, for `twin cosim` and for OMSimulator: what both make of them, step by step."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from twin.kernel.cosim.simulation import Simulation
from twin.kernel.fmi.description import Kind
from twin.kernel.ssp.package import loose_package
from twin.kernel.ssp.structure import Connection, DefaultExperiment, Endpoint, SspComponent, SspSystem, Structure
from twin.kernel.systems.additions import Additions
from twin.kernel.systems.choice import MasterChoice
from twin.kernel.systems.opening import opened

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
        fmus = {f"{name}.fmu": file for name, file in self.parts.items()}
        wires = [
            Connection(
                Endpoint(*start.split(".", 1)), Endpoint(*end.split(".", 1)), suppress_unit_conversion=not self.units
            )
            for start, end in self.wires
        ]
        system = SspSystem("wired", tuple(SspComponent(name, f"{name}.fmu") for name in self.parts), tuple(wires))
        structure = Structure("wired", system, experiment=DefaultExperiment(stop=self.ticks * self.tick))
        package = loose_package(Path("wired"), structure, fmus, "SSP")
        more = Additions([f"{name}={value!r}" for name, value in self.settings.items()], recorded=self.seen)
        with opened(package, choice, additions=more) as (plan, made):
            names = {part.name: [port.variable.name for port in part.outputs] for part in plan.parts}
            columns = []
            for name in self.seen:
                part, variable = name.split(".", 1)
                columns.append(made.columns[part].start + names[part].index(variable))
            simulation, found = Simulation(made.system, plan.timing.ticks, slice_ticks=every), []
            while not simulation.finished:
                found.append(simulation.advance()[:1, columns])
            if simulation.failure:
                raise simulation.failure
        return np.concatenate(found)
