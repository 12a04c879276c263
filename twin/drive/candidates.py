"""Which variables of a foreign drive may play a role, and which of them its names and descriptions point to."""

import difflib
import re
from collections.abc import Collection, Mapping

from twin.drive.contract import COMMANDS, Command, Role
from twin.drive.units import TURN
from twin.drive.variable import Variable
from twin.units import NUMBER

ANGLE_FACTORS = (1.0, TURN / 360.0, TURN)
"""rad, degree, turn: what tells an angle from any other pure number."""


def measures(variable: Variable, role: Role) -> bool:
    """Whether the variable's unit allows the role; no stated unit does."""
    if not variable.unit:
        return True
    if variable.conversion is None or variable.conversion.dimension != role.dimension:
        return False
    return role.port.unit != "rad" or any(
        abs(variable.conversion.factor - factor) < 1e-6 * factor for factor in ANGLE_FACTORS
    )


def plays(variable: Variable, role: Role) -> bool:
    """Whether causality, type and unit allow the role."""
    return variable.causality == role.causality and _can_be(variable, role)


def _can_be(variable: Variable, role: Role) -> bool:
    """Whether type and unit allow the role: texts and clocks play none, switches only what may be left out."""
    counted = variable.kind >= 0 and (variable.type not in ("Boolean", "Enumeration") or not role.required)
    return counted and measures(variable, role)


def candidates(variables: Mapping[str, Variable], role: Role, taken: Collection[str] = ()) -> list[str]:
    """Those not `taken` whose causality, type and unit allow `role`, most similar names first.

    Locals if no output does; those that state a unit if any does.
    """
    causalities = (role.causality, "local") if role.causality == "output" else (role.causality,)
    offered = [
        [n for n, v in variables.items() if n not in taken and v.causality == causality and _can_be(v, role)]
        for causality in causalities
    ]
    fitting = next((found for found in offered if found), [])
    fitting = [n for n in fitting if variables[n].unit] or fitting
    names = (role.port.name, *role.synonyms)
    return sorted(fitting, key=lambda n: -max(difflib.SequenceMatcher(None, n.lower(), name).ratio() for name in names))


def likely_command(variables: Mapping[str, Variable], taken: Collection[str]) -> Command:
    """What a drive is commanded with by an input that is not `taken`: one that states its unit goes before others, of
    these one that is called like a command."""
    free = {command: candidates(variables, role, taken) for command, role in COMMANDS.items()}
    stated = [command for command, names in free.items() if any(variables[n].unit for n in names)]
    called = [
        command for command in stated if any(score(n, variables[n], COMMANDS[command]) > 0 for n in free[command])
    ]
    return next(iter([*called, *stated, *(command for command, names in free.items() if names)]), "velocity")


def proposals(variables: Mapping[str, Variable], role: Role, taken: set[str]) -> list[str]:
    """The best candidates for `role`: those of the right causality and unit that its synonyms fit best."""
    # a command in "1" is a share of something, hardly an angle
    unstated = ("", "1") if role.port.unit == "rad" and role.causality == "input" else ("",)
    fitting = [n for n, v in variables.items() if n not in taken and v.unit not in unstated and plays(v, role)]
    if role.dimension == NUMBER and not role.required:
        fitting = [n for n, v in variables.items() if n not in taken and plays(v, role)]
    scores = {name: score(name, variables[name], role) for name in fitting}
    best = max(scores.values(), default=0)
    return [name for name, score in scores.items() if score == best]


def score(name: str, variable: Variable, role: Role) -> int:
    """How well name and description fit: 3 a synonym itself, 2 contains one, 1 described by one."""
    lower = name.lower().rpartition(".")[2]
    words = re.split(r"[^a-z0-9]+", lower)
    if lower in role.synonyms:
        return 3
    if any(synonym in lower if len(synonym) > 2 else synonym in words for synonym in role.synonyms):
        return 2
    described = variable.description.lower()
    return int(any(len(synonym) > 3 and synonym in described for synonym in role.synonyms))
