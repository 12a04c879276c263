"""One run in memory: the signals that an experiment's measures ask for, at every tick."""

import difflib
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin.assembly.assemble import Assembly, assemble
from twin.assembly.beliefs import geometry_of
from twin.cosim.simulation import Simulation
from twin.cosim.system import System
from twin.errors import InputRefused, SafetyTrip
from twin.experiment.experiment import Experiment
from twin.experiment.measure import Led, Measure, Watched
from twin.monitor.component import Monitor
from twin.monitor.reasons import trip_sentence
from twin.robot.inverse_kinematics import joint_angles

SLICE_TICKS = 1000
REFERENCE_THETA_L = "reference.theta_l"
"""Load angles (rad) at which the platform, as the controller believes it to be made, is at controller.p_ref_B."""


@dataclass(frozen=True)
class Trace:
    """A run that went to its end.

    Attributes:
        t: times of the ticks (s), (n,).
        units: SI unit of every vector, by its recorded name without an index.
        fmus: SHA-256 of every FMU that took part, by file name.
    """

    t: NDArray[np.float64]
    units: dict[str, str]
    fmus: dict[str, str]
    vectors: dict[str, NDArray[np.float64]]

    def __getitem__(self, signal: str) -> NDArray[np.float64]:
        """Values (n,) of a signal as [[measure]] writes it, (n, k) without an index where it has k components."""
        vector, index = split(signal.removeprefix("-"))
        values = self.vectors[vector]
        values = values[:, index or 0] if index is not None or values.shape[1] == 1 else values
        return -values if signal.startswith("-") else values

    def unit(self, signal: str) -> str:
        """SI unit of a signal."""
        return self.units[split(signal.removeprefix("-"))[0]]


def split(signal: str) -> tuple[str, int | None]:
    """`plant.p_B[2]` as vector and index; None where it has none."""
    vector, bracket, index = signal.partition("[")
    return vector, int(index.removesuffix("]")) if bracket else None


def traced(experiment: Experiment) -> Trace:
    """Run `experiment` and keep every output.

    Raises:
        InputRefused: a drive FMU does not fit, or a measure names signals that there are not; all of those at once.
        ComponentFailed: a component failed.
        SafetyTrip: the safety monitor tripped.
    """
    with assemble(experiment) as assembly:
        system = assembly.system
        refuse_unknown(experiment, system)
        values = Simulation(system, experiment.duration_ticks, SLICE_TICKS).run()
        for component in system.components:
            if isinstance(component, Monitor) and component.trip is not None:
                raise SafetyTrip(f"{experiment.name}: {trip_sentence(component.trip)}")
        return trace_of(experiment, assembly, values)


def trace_of(experiment: Experiment, assembly: Assembly, values: NDArray[np.float64]) -> Trace:
    """A run of `experiment` that has been made already.

    Args:
        assembly: of it. values: every row of the run, (n, width of the system's outputs).
    """
    system = assembly.system
    names = _recorded_names(system)
    vectors = {name: values[:, system.columns(end)] for name, (end, _, _) in names.items() if end}
    p_ref_B = vectors["controller.p_ref_B"]
    vectors[REFERENCE_THETA_L] = joint_angles(geometry_of(experiment.controller.model), p_ref_B)
    return Trace(
        t=np.arange(len(values), dtype=float) * system.tick,
        units={name: unit for name, (_, _, unit) in names.items()},
        fmus=_fmus(assembly),
        vectors=vectors,
    )


def _recorded_names(system: System) -> dict[str, tuple[str, int, str]]:
    """Name as recorded -> (end in the system, components, SI unit)."""
    names = {
        f"{component.name.replace('drive_', 'drive/')}.{port.name}": (
            f"{component.name}.{port.name}",
            port.size,
            port.unit,
        )
        for component in system.components
        for port in component.outputs
    }
    return names | {REFERENCE_THETA_L: ("", 3, "rad")}


def refuse_unknown(experiment: Experiment, system: System) -> None:
    """Check that `system` has every signal which a measure of `experiment` looks at.

    Raises:
        InputRefused: it has not; all of those at once.
    """
    sizes = {name: size for name, (_, size, _) in _recorded_names(system).items()}
    mistakes = []
    for number, measure in enumerate(experiment.measures, start=1):
        for key, signal in _signals(measure):
            vector, index = split(signal.removeprefix("-"))
            said = f'[measure {number}] {key} = "{signal}"'
            if vector not in sizes:
                close = difflib.get_close_matches(vector, sizes, 1)
                hint = f"did you mean {close[0]}?" if close else f"there are {', '.join(sizes)}"
                mistakes.append(f"{said}: no such signal; {hint}")
            elif (index is None) != (sizes[vector] == 1) or (index or 0) >= sizes[vector]:
                wanted = f"[0] to [{sizes[vector] - 1}]" if sizes[vector] > 1 else "no index"
                mistakes.append(f"{said}: it has {sizes[vector]} components; expected {wanted}")
    if mistakes:
        raise InputRefused("\n".join(f"{experiment.name}: {mistake}" for mistake in mistakes))


def _signals(measure: Measure) -> list[tuple[str, str]]:
    """(key, signal) of everything that `measure` looks at by name."""
    named = [("signal", measure.signal)] if isinstance(measure, Watched) else []
    return [*named, ("reference", measure.reference)] if isinstance(measure, Led) else named


def _fmus(assembly: Assembly) -> dict[str, str]:
    return {fmu.path.name: fmu.sha256 for plan in assembly.drives for fmu in plan.parts.values()}
