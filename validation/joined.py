"""FMUs of others joined as `twin cosim` joins those of an SSP, and what comes out."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from twin.kernel.systems.choice import MasterChoice

Curves = dict[str, np.ndarray]


def joined(
    fmus: Mapping[str, Path],
    choice: "MasterChoice",
    stop: float,
    seen: Sequence[str],
    wires: Sequence[tuple[str, str]] = (),
    settings: Sequence[str] = (),
    inputs: Sequence[str] = (),
    every: int = 1,
    units: bool = True,
) -> Curves:
    """Signals of a system; they end where an FMU asks for the end.

    Args:
        fmus: files by the names of components.
        choice: what is asked of the master.
        stop: end of the run (s).
        seen: names of the signals, "component.variable".
        wires: (output, input) likewise.
        settings, inputs: as of `Additions`.
        every: ticks from one row to the next.
        units: whether wires are to have the same unit at both ends.

    Raises:
        TwinError: the system cannot be run, or failed.
    """
    from twin.kernel.cosim.simulation import Simulation
    from twin.kernel.errors import EndRequest
    from twin.kernel.ssp.package import loose_package
    from twin.kernel.ssp.structure import Connection, DefaultExperiment, Endpoint, SspComponent, SspSystem, Structure
    from twin.kernel.systems.additions import Additions
    from twin.kernel.systems.opening import open_system

    ends = [
        Connection(Endpoint(*start.split(".", 1)), Endpoint(*end.split(".", 1)), suppress_unit_conversion=not units)
        for start, end in wires
    ]
    parts = tuple(SspComponent(name, f"{name}.fmu") for name in fmus)
    system = SspSystem("joined", parts, tuple(ends))
    structure = Structure("joined", system, experiment=DefaultExperiment(stop=stop))
    package = loose_package(Path("joined"), structure, {f"{name}.fmu": file for name, file in fmus.items()}, "SSP")
    with open_system(package, choice, additions=Additions(settings, (), inputs, seen)) as (plan, made):
        places = {
            f"{part.path}.{port.variable.name}": made.columns[part.name].start + i
            for part in plan.parts
            for i, port in enumerate(part.outputs)
        }
        columns = [places[name] for name in seen]
        simulation, found = Simulation(made.system, plan.timing.ticks, slice_ticks=every), []
        while not simulation.is_over:
            found.append(simulation.advance()[:1, columns])
        if simulation.failure and not isinstance(simulation.failure, EndRequest):
            raise simulation.failure
    return dict(zip(seen, np.concatenate(found).T, strict=True))
