"""The robot in Ecos."""

from collections.abc import Callable

from validation.masters.master import BIT_FOR_BIT, FIG4, MASSAGE, SAME_BITS, Master, beside_the_twin
from validation.masters.robot import Robot, Rows, Signals
from validation.yardstick import NotHere


def run(given: Robot) -> Signals:
    """What Ecos gives.

    Raises:
        NotHere: the library of Ecos does not load.
    """
    try:
        from ecospy import EcosLib, EcosSimulation, EcosSimulationStructure
    except OSError as missing:
        raise NotHere(f"Ecos does not load: {missing}; it needs TBB 12, which Debian has as libtbb12") from None
    EcosLib.set_log_level("warn")
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
    return rows.signals()


def shifted(offset: float) -> Callable[[float], float]:
    """What Ecos calls for each value on a wire."""
    return lambda value: value + offset


ECOS = Master(run, "Ecos, NTNU", ("ecospy",))
YARDSTICKS = tuple(
    beside_the_twin(
        ECOS, case, BIT_FOR_BIT, f"Ecos hands on the same 0.001 s with every step, and values as they are; {SAME_BITS}"
    )
    for case in (FIG4, MASSAGE)
)
