"""Wires between the parts of a drive: proposed where names or units leave one answer."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from twin.drive.contract import COMMANDS, LOAD, OPTIONAL_INPUTS
from twin.drive.description import Variable

ASKED_FOR = ("load", "ref", "cmd", "command", "target", "setpoint", "demand", "goal")
"""In names of inputs that are the robot's to feed."""
SUPPLIES = {word for role in OPTIONAL_INPUTS for word in (role.port.name, *role.synonyms)}
COMMANDED = [role.dimension for role in COMMANDS.values()]


class Join(NamedTuple):
    """A wire that may be: from output `source` to input `target`, "part.variable" each; `sure`: nothing else may."""

    source: str
    target: str
    sure: bool = True


def part_of(name: str) -> str:
    """The part of a variable that is called "part.variable"."""
    return name.partition(".")[0]


def objection(variables: Mapping[str, Variable], source: str, target: str) -> str:
    """Why no wire can lead from `source` to `target`; "" if one can."""
    for end, causalities in ((source, ("output", "local")), (target, ("input",))):
        if end not in variables:
            return f"there is no {end}"
        if variables[end].causality not in causalities or variables[end].kind < 0:
            return f"{end} has causality {variables[end].causality} and type {variables[end].type}"
    a, b = variables[source].conversion, variables[target].conversion
    if a and b and a.dimension != b.dimension:
        return f"units {variables[source].unit} and {variables[target].unit} do not measure the same"
    return ""


def joins(variables: Mapping[str, Variable]) -> list[Join]:
    """A wire for each input that an output of another part is called like, or alone measures what it does.

    What is left to feed has to include a load and a command, so by its unit alone no input is wired that is called like
    one; and if none were left, nothing by unit is sure.

    Args:
        variables: of all parts, as "part.variable".
    """
    inputs = [name for name, v in variables.items() if v.causality == "input" and v.kind >= 0]
    found: list[Join] = []
    for target in inputs:
        alike = [name for name in _sources(variables, target) if _last(name) == _last(target)]
        found += [Join(alike[0], target)] if len(alike) == 1 else []
    rest = [name for name in inputs if name not in {join.target for join in found}]
    measured = {name: [] if _is_asked_for(name) else _sources(variables, name, measured=True) for name in rest}
    free = [_dimension(variables, name) for name, sources in measured.items() if len(sources) != 1]
    loads, commands = free.count(LOAD.dimension), len([d for d in free if d in COMMANDED])
    left = loads > 0 and commands > (loads == 1)
    for target, sources in measured.items():
        rivals = [other for other, theirs in measured.items() if set(theirs) & set(sources)]
        sure = left and len(sources) == len(rivals) == 1
        found += [Join(source, target, sure) for source in sources]
    return sorted(found, key=lambda join: inputs.index(join.target))


def _is_asked_for(name: str) -> bool:
    """Whether an input is called like what the robot feeds, or nobody does."""
    return any(word in _last(name) for word in ASKED_FOR) or _last(name) in SUPPLIES


def _sources(variables: Mapping[str, Variable], target: str, measured: bool = False) -> Sequence[str]:
    """Outputs of other parts that can feed `target`; `measured`: only if both state a unit."""
    return [
        name
        for name, v in variables.items()
        if v.causality == "output"
        and part_of(name) != part_of(target)
        and not objection(variables, name, target)
        and v.size == variables[target].size
        and (not measured or _dimension(variables, name) == _dimension(variables, target) is not None)
    ]


def _dimension(variables: Mapping[str, Variable], name: str) -> object:
    conversion = variables[name].conversion
    return conversion.dimension if conversion else None


def _last(name: str) -> str:
    return name.partition(".")[2].lower()
