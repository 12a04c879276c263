"""The mapping of a third-party drive: which variable plays which role, with units and signs.

What the user maps is taken as said, if it can be right; what is left is proposed from names, units, causality and
descriptions, and only if there is one answer. Otherwise the error is the TOML to paste. Between the parts of a drive
wires are proposed where names or units leave one answer.
"""

import difflib
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal, NamedTuple

from twin.kernel.cosim.port import Port
from twin.kernel.errors import InputRefused
from twin.kernel.fmi.variable import RAD_PER_TURN, Conversion, Variable, si_conversion
from twin.kernel.units import NUMBER, known_unit, weight_hint
from twin.robot.drive.contract import (
    COMMAND_ROLES,
    LOAD_ROLE,
    OPTIONAL_INPUT_ROLES,
    TAU_MOTOR_ROLE,
    THETA_M_ROLE,
    Command,
    Role,
    drive_roles,
)

ANGLE_FACTORS = (1.0, RAD_PER_TURN / 360.0, RAD_PER_TURN)
"""rad, degree, turn: what tells an angle from any other pure number."""
_IN_UNIT = re.compile(r"(?P<name>.*\S)\s*\[(?P<unit>[^\[\]]*[^\[\]\d][^\[\]]*)\]")
FED_INPUT_WORDS = ("load", "ref", "cmd", "command", "target", "setpoint", "demand", "goal")
"""In names of inputs that are the robot's to feed."""
SUPPLY_WORDS = {word for role in OPTIONAL_INPUT_ROLES for word in (role.port.name, *role.synonyms)}
COMMAND_DIMENSIONS = [role.dimension for role in COMMAND_ROLES.values()]


def unit_allows(variable: Variable, role: Role) -> bool:
    """Whether the variable's unit allows the role; no stated unit does."""
    if not variable.unit:
        return True
    if variable.conversion is None or variable.conversion.dimension != role.dimension:
        return False
    return role.port.unit != "rad" or any(
        abs(variable.conversion.factor - factor) < 1e-6 * factor for factor in ANGLE_FACTORS
    )


def can_play(variable: Variable, role: Role) -> bool:
    """Whether causality, type and unit allow the role."""
    return variable.causality == role.causality and _type_allows(variable, role)


def _type_allows(variable: Variable, role: Role) -> bool:
    """Whether type and unit allow the role: texts and clocks play none, switches only what may be left out."""
    counted = variable.kind >= 0 and (variable.type not in ("Boolean", "Enumeration") or not role.required)
    return counted and unit_allows(variable, role)


def candidates(variables: Mapping[str, Variable], role: Role, taken: Collection[str] = ()) -> list[str]:
    """Those not `taken` whose causality, type and unit allow `role`, most similar names first.

    Locals if no output does; those that state a unit if any does.
    """
    causalities = (role.causality, "local") if role.causality == "output" else (role.causality,)
    offered = [
        [n for n, v in variables.items() if n not in taken and v.causality == causality and _type_allows(v, role)]
        for causality in causalities
    ]
    fitting = next((found for found in offered if found), [])
    fitting = [n for n in fitting if variables[n].unit] or fitting
    names = (role.port.name, *role.synonyms)
    return sorted(fitting, key=lambda n: -max(difflib.SequenceMatcher(None, n.lower(), name).ratio() for name in names))


def likely_command(variables: Mapping[str, Variable], taken: Collection[str]) -> Command:
    """What a drive is commanded with by an input that is not `taken`: one that states its unit goes before others, of
    these one that is called like a command."""
    free = {command: candidates(variables, role, taken) for command, role in COMMAND_ROLES.items()}
    stated = [command for command, names in free.items() if any(variables[n].unit for n in names)]
    called = [
        command
        for command in stated
        if any(name_score(n, variables[n], COMMAND_ROLES[command]) > 0 for n in free[command])
    ]
    return next(iter([*called, *stated, *(command for command, names in free.items() if names)]), "velocity")


def best_candidates(variables: Mapping[str, Variable], role: Role, taken: set[str]) -> list[str]:
    """The best candidates for `role`: those of the right causality and unit that its synonyms fit best."""
    # a command in "1" is a share of something, hardly an angle
    unstated = ("", "1") if role.port.unit == "rad" and role.causality == "input" else ("",)
    fitting = [n for n, v in variables.items() if n not in taken and v.unit not in unstated and can_play(v, role)]
    if role.dimension == NUMBER and not role.required:
        fitting = [n for n, v in variables.items() if n not in taken and can_play(v, role)]
    scores = {name: name_score(name, variables[name], role) for name in fitting}
    best = max(scores.values(), default=0)
    return [name for name, score in scores.items() if score == best]


def name_score(name: str, variable: Variable, role: Role) -> int:
    """How well name and description fit: 3 a synonym itself, 2 contains one, 1 described by one."""
    lower = name.lower().rpartition(".")[2]
    words = re.split(r"[^a-z0-9]+", lower)
    if lower in role.synonyms:
        return 3
    if any(synonym in lower if len(synonym) > 2 else synonym in words for synonym in role.synonyms):
        return 2
    described = variable.description.lower()
    return int(any(len(synonym) > 3 and synonym in described for synonym in role.synonyms))


class AmbiguousRoles(InputRefused):
    """A required role has no or several answers; the sentence says which."""


def ambiguity_message(
    file: str,
    variables: Mapping[str, Variable],
    roles: tuple[Role, ...],
    chosen: Mapping[str, str],
    unsure: list[Role],
    rotor: bool,
) -> str:
    """The sentence and the TOML that ends the doubt.

    Args:
        file: what the sentence calls the drive.
        variables: its variables by the name the user knows them by.
        roles: of its contract.
        chosen: variable by role, where that is clear.
        unsure: roles where it is not.
        rotor: whether its shaft is ours.
    """
    lines = [f"{file}: cannot tell which of its variables is {' and which is '.join(r.port.name for r in unsure)}."]
    likely = likely_command(variables, set(chosen.values())) if COMMAND_ROLES["velocity"] in unsure else "velocity"
    other = likely if likely != "velocity" else None
    if other:
        loop = "" if other == "position" else ", which needs a velocity loop of ours in front of it"
        lines.append(f"It seems to be commanded with a {other}{loop}.")
        roles = (COMMAND_ROLES[other], *(role for role in roles if role is not COMMAND_ROLES["velocity"]))
        unsure = [*unsure, COMMAND_ROLES[other]]
    still = not any(
        v.causality in ("output", "local") and unit_allows(v, THETA_M_ROLE) for v in variables.values() if v.unit
    )
    if still and not rotor and best_candidates(variables, TAU_MOTOR_ROLE, set()):
        lines.append("It gives a torque and no angle: to simulate its shaft here, add [drive.rotor] J_kg_m2 = 1e-4.")
    lines.append("Complete this in the experiment, or without 'drive.' in the mapping.toml beside the FMU:")
    if other:
        lines += ["[drive]", f'command = "{other}"']
    if other and other != "position":
        lines.append("[drive.velocity_loop]")
        unit = COMMAND_ROLES[other].port.unit
        lines += [f"kp = 0.1          # {unit} per rad/s", f"ki = 1.0          # {unit} per rad"]
        lines += [f"limit = 1.0       # {unit}", "period_ms = 0.25"]
    for table, causality in (("inputs", "input"), ("outputs", "output")):
        lines.append(f"[drive.{table}]")
        for role in roles:
            if role.causality != causality or not (role.required or role.port.name in chosen):
                continue
            others = {name for port, name in chosen.items() if port != role.port.name}
            offered = candidates(variables, role, others)
            name = chosen.get(role.port.name, offered[0] if offered else "?")
            doubt = f"   # or: {', '.join(offered[1:])}" if role in unsure and len(offered) > 1 else ""
            lines.append(f'{role.port.name} = "{name}"{doubt}')
    return "\n".join(lines)


@dataclass(frozen=True)
class Wiring:
    """What the user says of a drive.

    Attributes:
        command: what it is commanded with.
        sign: -1 if the FMU turns the other way.
        gear_ratio: turns of its shaft per turn of the motor shaft theta_m.
        inputs, outputs: role -> the FMU's variable; "-name" if that one alone counts the other way, "name[rpm]" if its
            FMU states no unit.
        rotor: whether the shaft is ours.
    """

    command: Command = "velocity"
    sign: Literal[1, -1] = 1
    gear_ratio: float = 1.0
    inputs: Mapping[str, str] = field(default_factory=dict)
    outputs: Mapping[str, str] = field(default_factory=dict)
    rotor: bool = False


@dataclass(frozen=True)
class Binding:
    """One role filled: contract value = gain * FMU value + offset.

    Attributes:
        role: of the contract.
        variable: that fills it.
        name: by which the user knows it, with its part if the drive has parts.
        gain: of the contract's value.
        offset: of the contract's value.
        turned: whether this one alone counts the other way.
    """

    role: Role
    variable: Variable
    name: str
    gain: float
    offset: float
    turned: bool = False

    @property
    def port(self) -> Port:
        """The contract's port, as wide as the variable: 3 for a drive with three axes in one FMU."""
        return replace(self.role.port, size=self.variable.size)

    @property
    def mapped_name(self) -> str:
        """The variable as a mapping names it."""
        return f"-{self.name}" if self.turned else self.name

    def __str__(self) -> str:
        arrow = "<-" if self.role.causality == "input" else "->"
        unit = f" [{self.variable.unit}]" if self.variable.unit else " [unit not stated]"
        return f"{self.port.name} {arrow} {self.mapped_name}{unit}"


def split_unit(text: str) -> tuple[str, str]:
    """Split `speed_cmd[rpm]` of a mapping into the variable's name and its unit, "" without one."""
    found = _IN_UNIT.fullmatch(text)
    return (found["name"], found["unit"]) if found else (text, "")


def with_units(
    file: str, variables: Mapping[str, Variable], mappings: Sequence[Mapping[str, Any]]
) -> tuple[dict[str, Variable], list[dict[str, Any]]]:
    """Give variables whose FMU states no unit those of the `mappings`, and return the mappings without them.

    A whole name of a variable, as `x[2]`, is no name with a unit. A mapping has a name, or several, by role.

    Raises:
        InputRefused: a unit is unknown, or the FMU states another one.
    """
    known = dict(variables)

    def bare(text: str) -> str:
        sign = "-" * (text.startswith("-") and text not in known)
        plain = text[len(sign) :].strip()
        name, spelled = split_unit(plain)
        alike = [n for n in known if n == name or n.startswith(f"{name}[")]
        if not spelled or plain in known or not alike:
            return text
        # what the contract has no name for may be a unit of a log
        other = known_unit(spelled)
        read = si_conversion(spelled) or (Conversion(other.dimension._replace(rad=0), other.scale) if other else None)
        if read is None:
            raise InputRefused(
                f"{file}: '{text}': the unit '{spelled}' is unknown; expected one such as rad/s, rpm or N.m"
            )
        for n in alike:
            if known[n].unit and known[n].conversion != read:
                raise InputRefused(f"{file}: '{text}': '{n}' is in '{known[n].unit}' by its FMU; leave the unit out")
            known[n] = replace(known[n], unit=spelled, conversion=read)
        return sign + name

    def entry(of: str | Sequence[str]) -> str | tuple[str, ...]:
        return bare(of) if isinstance(of, str) else tuple(map(bare, of))

    return known, [{role: entry(of) for role, of in one.items()} for one in mappings]


class RoleChoice(NamedTuple):
    """Who plays which role.

    Attributes:
        chosen: role -> variable.
        turned: roles whose variable alone counts the other way.
        unsure: required roles with no or several answers.
    """

    chosen: dict[str, str]
    turned: set[str]
    unsure: list[Role]


def bindings(file: str, variables: Mapping[str, Variable], wiring: Wiring) -> tuple[Binding, ...]:
    """Every role of the contract that the drive fills: inputs first, in the contract's order.

    Args:
        file: what an error calls the drive.
        variables: the FMU's variables by the name the user knows them by.
        wiring: what the user says.

    Raises:
        InputRefused: unknown role or variable, wrong causality or unit, or a required role with no or several answers.
    """
    variables, (inputs, outputs) = with_units(file, variables, (wiring.inputs, wiring.outputs))
    wiring = replace(wiring, inputs=inputs, outputs=outputs)
    roles = drive_roles(wiring.command, wiring.rotor)
    _refuse_unknown_roles(file, wiring, roles, "drive")
    chosen, turned, unsure = choose_variables(file, variables, wiring, roles)
    if unsure:
        raise AmbiguousRoles(ambiguity_message(file, variables, roles, chosen, unsure, wiring.rotor))
    found = _bind_roles(variables, wiring, roles, chosen, turned)
    widths = {b.port.name: b.port.size for b in found if b.role.required}
    if len(set(widths.values())) > 1 or not set(widths.values()) <= {1, 3}:
        listed = ", ".join(f"{name} has {size}" for name, size in widths.items())
        raise InputRefused(f"{file}: {listed} values; expected 1 each for one joint, or 3 each for all three")
    return found


def fill_roles(
    file: str, variables: Mapping[str, Variable], wiring: Wiring, roles: Sequence[Role], table: str
) -> tuple[Binding, ...]:
    """Those of `roles`, none of them required, that variables play, in their order.

    Args:
        file: what an error calls the FMU.
        variables: of the FMU, by the name the user knows them by.
        wiring: what the user says.
        roles: inputs or outputs of a part of the robot.
        table: of the experiment that says it.

    Raises:
        InputRefused: see `bindings`.
    """
    _refuse_unknown_roles(file, wiring, roles, table)
    chosen, turned, _ = choose_variables(file, variables, wiring, roles)
    return _bind_roles(variables, wiring, roles, chosen, turned)


def _bind_roles(
    variables: Mapping[str, Variable],
    wiring: Wiring,
    roles: Sequence[Role],
    chosen: Mapping[str, str],
    turned: Collection[str],
) -> tuple[Binding, ...]:
    found = []
    for role in (role for role in roles if role.port.name in chosen):
        name = chosen[role.port.name]
        _, factor, offset = variables[name].conversion or Conversion(role.dimension)
        ratio = wiring.sign * wiring.gear_ratio
        # no gear changes a voltage or a current, but the shaft turns with its sign
        electrical = float(wiring.sign) if role in COMMAND_ROLES.values() else 1.0
        alone = role.port.name in turned
        mechanical = {1: 1.0 / ratio, -1: ratio, 0: electrical}[role.mechanical] * (-1.0 if alone else 1.0)
        found.append(Binding(role, variables[name], name, factor * mechanical, offset * mechanical, alone))
    return tuple(found)


def choose_variables(file: str, variables: Mapping[str, Variable], wiring: Wiring, roles: Sequence[Role]) -> RoleChoice:
    """What the user says, and of the other `roles` those that have one answer.

    Raises:
        InputRefused: unknown variable, wrong causality or unit, or one for two roles.
    """
    chosen: dict[str, str] = {}
    turned: set[str] = set()
    for role in roles:
        named = (wiring.inputs if role.causality == "input" else wiring.outputs).get(role.port.name)
        if named is not None:
            if named.startswith("-") and named not in variables:
                turned.add(role.port.name)
                named = named.removeprefix("-").strip()
            chosen[role.port.name] = _check_variable(file, variables, role, named)
        elif role.port.name in variables and can_play(variables[role.port.name], role):
            chosen[role.port.name] = role.port.name
    for name in set(chosen.values()):
        played = [role for role, variable in chosen.items() if variable == name]
        if len(played) > 1:
            raise InputRefused(f"{file}: '{name}' is given to {' and '.join(played)}; one variable plays one role")
    unsure: list[Role] = []
    for role in roles:
        if role.port.name not in chosen:
            best = best_candidates(variables, role, set(chosen.values()))
            if len(best) == 1 and (role.required or name_score(best[0], variables[best[0]], role) >= 2):
                chosen[role.port.name] = best[0]
            elif role.required:
                unsure.append(role)
    return RoleChoice(chosen, turned, unsure)


def _refuse_unknown_roles(file: str, wiring: Wiring, roles: Sequence[Role], owner: str) -> None:
    commanded = f' for command = "{wiring.command}"' if owner == "drive" else ""
    for table, given, causality in (("inputs", wiring.inputs, "input"), ("outputs", wiring.outputs, "output")):
        known = [role.port.name for role in roles if role.causality == causality]
        for name in given:
            if name not in known:
                raise InputRefused(
                    f"{file}: [{owner}.{table}] has no role '{name}'{commanded}; the roles are {', '.join(known)}"
                )


def _check_variable(file: str, variables: Mapping[str, Variable], role: Role, name: str) -> str:
    """`name`, if the variable the user gave to `role` can play it."""
    if name not in variables:
        offered = [n for n, v in variables.items() if v.causality == role.causality]
        there = f"its {role.causality}s are {', '.join(offered)}" if offered else f"it has no {role.causality}"
        raise InputRefused(f"{file}: has no variable '{name}' for {role.port.name}; {there}")
    variable = variables[name]
    # some tools leave their outputs marked as local; they cannot be written, but they can be read
    allowed = ("input",) if role.causality == "input" else ("output", "local")
    if variable.causality not in allowed:
        raise InputRefused(
            f"{file}: '{name}' has causality {variable.causality}; {role.port.name} needs {role.causality}"
        )
    if variable.kind < 0:
        raise InputRefused(f"{file}: '{name}' has type {variable.type}; {role.port.name} needs a number")
    if not unit_allows(variable, role):
        raise InputRefused(
            f"{file}: {role.causality} '{name}' has unit '{variable.unit}'; "
            f"{role.port.name} needs one like {role.port.unit}"
            f"{weight_hint(variable.conversion.dimension, role.dimension) if variable.conversion else ''}"
        )
    return name


class WireProposal(NamedTuple):
    """A wire that may be: from output `source` to input `target`, "part.variable" each; `sure`: nothing else may."""

    source: str
    target: str
    sure: bool = True


def part_name(name: str) -> str:
    """The part of a variable that is called "part.variable"."""
    return name.partition(".")[0]


def wire_error(variables: Mapping[str, Variable], source: str, target: str) -> str:
    """Why no wire can lead from `source` to `target`; "" if one can."""
    for end, causalities in ((source, ("output", "local")), (target, ("input",))):
        if end not in variables:
            return f"there is no {end}"
        if variables[end].causality not in causalities or variables[end].kind < 0:
            return f"{end} has causality {variables[end].causality} and type {variables[end].type}"
    a, b = variables[source].conversion, variables[target].conversion
    if a and b and a.dimension != b.dimension:
        return f"units {variables[source].unit} and {variables[target].unit} have different dimensions"
    return ""


def propose_wires(variables: Mapping[str, Variable]) -> list[WireProposal]:
    """A wire for each input that an output of another part is called like, or alone measures what it does.

    What is left to feed has to include a load and a command, so by its unit alone no input is wired that is called like
    one; and if none were left, nothing by unit is sure.

    Args:
        variables: of all parts, as "part.variable".
    """
    inputs = [name for name, v in variables.items() if v.causality == "input" and v.kind >= 0]
    found: list[WireProposal] = []
    for target in inputs:
        alike = [name for name in _sources(variables, target) if _variable_name(name) == _variable_name(target)]
        found += [WireProposal(alike[0], target)] if len(alike) == 1 else []
    rest = [name for name in inputs if name not in {join.target for join in found}]
    measured = {name: [] if _is_robot_input(name) else _sources(variables, name, measured=True) for name in rest}
    free = [_dimension(variables, name) for name, sources in measured.items() if len(sources) != 1]
    loads, commands = free.count(LOAD_ROLE.dimension), len([d for d in free if d in COMMAND_DIMENSIONS])
    left = loads > 0 and commands > (loads == 1)
    for target, sources in measured.items():
        rivals = [other for other, theirs in measured.items() if set(theirs) & set(sources)]
        sure = left and len(sources) == len(rivals) == 1
        found += [WireProposal(source, target, sure) for source in sources]
    return sorted(found, key=lambda join: inputs.index(join.target))


def _is_robot_input(name: str) -> bool:
    """Whether an input has the name of one that the robot feeds, or has no source."""
    return any(word in _variable_name(name) for word in FED_INPUT_WORDS) or _variable_name(name) in SUPPLY_WORDS


def _sources(variables: Mapping[str, Variable], target: str, measured: bool = False) -> Sequence[str]:
    """Outputs of other parts that can feed `target`; `measured`: only if both state a unit."""
    return [
        name
        for name, v in variables.items()
        if v.causality == "output"
        and part_name(name) != part_name(target)
        and not wire_error(variables, name, target)
        and v.size == variables[target].size
        and (not measured or _dimension(variables, name) == _dimension(variables, target) is not None)
    ]


def _dimension(variables: Mapping[str, Variable], name: str) -> object:
    conversion = variables[name].conversion
    return conversion.dimension if conversion else None


def _variable_name(name: str) -> str:
    return name.partition(".")[2].lower()
