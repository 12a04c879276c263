"""What parts of ours and FMUs of others have in common in an SSP: units by their names, and where values come from."""

from collections.abc import Iterable

from twin.cosim.ssp.structure import Connector
from twin.cosim.ssp.unit import UnitDefinition
from twin.experiment.experiment import Experiment

Told = tuple[Connector, UnitDefinition | None]
"""A connector, and the unit that it names."""
FROM_ROBOT = ("plant", "controller.model")
"""Tables that the robot's own fills where they say nothing."""


def defined(units: Iterable[UnitDefinition | None]) -> dict[str, UnitDefinition]:
    """Units of one file by their names; where two mean different things by one name, it is nobody's."""
    found: dict[str, UnitDefinition] = {}
    disputed: set[str] = set()
    for unit in units:
        if unit is not None and found.setdefault(unit.name, unit) != unit:
            disputed.add(unit.name)
    return {name: unit for name, unit in sorted(found.items()) if name not in disputed}


def origin(experiment: Experiment, key: str) -> str:
    """Where the value of a key of the experiment's file comes from; "" if nobody says."""
    for table in FROM_ROBOT:
        if key.startswith(f"{table}.") and key not in experiment.origins:
            key = f"robot{key.removeprefix(table)}"
    return experiment.origins.get(key, "")
