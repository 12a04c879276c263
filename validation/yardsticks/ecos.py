"""The robot in Ecos."""

from collections.abc import Callable, Mapping
from functools import partial

from validation.masters.bounds import DURATIONS
from validation.masters.robot import Rows, differences, robot
from validation.yardstick import NotHere, Yardstick


def run(experiment: str) -> Mapping[str, float]:
    """Ecos beside the twin's own run.

    Raises:
        NotHere: the library of Ecos does not load.
    """
    try:
        from ecospy import EcosLib, EcosSimulation, EcosSimulationStructure
    except OSError as missing:
        raise NotHere(f"Ecos does not load: {missing}; it needs TBB 12, which Debian has as libtbb12") from None
    EcosLib.set_log_level("warn")
    given = robot(experiment, DURATIONS[experiment])
    structure = EcosSimulationStructure()
    for name, file in given.files.items():
        structure.add_model(name, str(file))
    for wire in given.wires:
        source, target = "::".join(wire.source), "::".join(wire.target)
        structure.make_real_connection(source, target, shifted(wire.offset) if wire.offset else None)
    structure.add_parameter_set(
        "robot", {f"{name}::{key}": value for name, found in given.parameters.items() for key, value in found.items()}
    )
    rows = Rows(given)
    seen = [(rows.values[name], [f"{name}::{output}" for output in given.outputs[name]]) for name in given.files]
    simulation = EcosSimulation(given.own.tick, structure=structure)
    simulation.init(parameter_set="robot")
    for k in range(given.ticks):
        simulation.step()
        for values, names in seen:
            values[k + 1] = [simulation.get_real(name) for name in names]
    simulation.terminate()
    return differences(rows.signals(), given.own)


def shifted(offset: float) -> Callable[[float], float]:
    """What Ecos calls for each value on a wire."""
    return lambda value: value + offset


YARDSTICKS = tuple(
    Yardstick(
        claim=f"{duration:g} s of {experiment}: every output of drives, plant and computer beside the twin's own run",
        source="Ecos (NTNU), in ecospy",
        unit="of the signal's range",
        bound=0.0,
        reason="every step is the same 0.001 s, and values go over the wires as they are: the same bits",
        differences=partial(run, experiment),
        packages=("ecospy",),
    )
    for experiment, duration in DURATIONS.items()
)
