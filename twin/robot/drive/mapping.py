"""Mapping of a third-party drive: the variable for each role, with units and signs.

The user's mapping is used if it is valid. Missing roles are proposed from names, units, causality and descriptions if
there is a single answer; otherwise the error message contains the TOML to paste. Wires between the parts of a drive are
proposed where names or units leave one answer.
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
"""rad, degree, turn: the factors that distinguish an angle from any other pure number."""
_IN_UNIT = re.compile(r"(?P<name>.*\S)\s*\[(?P<unit>[^\[\]]*[^\[\]\d][^\[\]]*)\]")
FED_INPUT_WORDS = ("load", "ref", "cmd", "command", "target", "setpoint", "demand", "goal")
"""Words in the names of inputs that the robot feeds."""
SUPPLY_WORDS = {word for role in OPTIONAL_INPUT_ROLES for word in (role.port.name, *role.synonyms)}
COMMAND_DIMENSIONS = [role.dimension for role in COMMAND_ROLES.values()]


def unit_allows(variable: Variable, role: Role) -> bool:
    """Whether an FMU variable's unit fits a role of the drive contract; a missing unit fits every role."""
    if not variable.unit:
        return True
    if variable.conversion is None or variable.conversion.dimension != role.dimension:
        return False
    return role.port.unit != "rad" or any(
        abs(variable.conversion.factor - factor) < 1e-6 * factor for factor in ANGLE_FACTORS
    )


def can_play(variable: Variable, role: Role) -> bool:
    """Whether an FMU variable can fill a role of the drive contract, by causality, type and unit."""
    return variable.causality == role.causality and _type_allows(variable, role)


def _type_allows(variable: Variable, role: Role) -> bool:
    """Whether an FMU variable can fill a role by type and unit.

    Strings and clocks never can; booleans and enumerations only if the role is optional.
    """
    counted = variable.kind >= 0 and (variable.type not in ("Boolean", "Enumeration") or not role.required)
    return counted and unit_allows(variable, role)


def candidates(variables: Mapping[str, Variable], role: Role, taken: Collection[str] = ()) -> list[str]:
    """Return the FMU variables that can fill a role by causality, type and unit, most similar names first.

    Already taken variables are skipped. Local variables are used if no output fits; variables with a unit are
    preferred.
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
    """Return the probable kind of a drive's command from its free inputs, by units first, then by names."""
    free = {command: candidates(variables, role, taken) for command, role in COMMAND_ROLES.items()}
    stated = [command for command, names in free.items() if any(variables[n].unit for n in names)]
    called = [
        command
        for command in stated
        if any(name_score(n, variables[n], COMMAND_ROLES[command]) > 0 for n in free[command])
    ]
    return next(iter([*called, *stated, *(command for command, names in free.items() if names)]), "velocity")


def best_candidates(variables: Mapping[str, Variable], role: Role, taken: set[str]) -> list[str]:
    """Return the FMU variables of the right causality and unit whose names match a role best."""
    # a command in "1" is a ratio, hardly an angle
    unstated = ("", "1") if role.port.unit == "rad" and role.causality == "input" else ("",)
    fitting = [n for n, v in variables.items() if n not in taken and v.unit not in unstated and can_play(v, role)]
    if role.dimension == NUMBER and not role.required:
        fitting = [n for n, v in variables.items() if n not in taken and can_play(v, role)]
    scores = {name: name_score(name, variables[name], role) for name in fitting}
    best = max(scores.values(), default=0)
    return [name for name, score in scores.items() if score == best]


def name_score(name: str, variable: Variable, role: Role) -> int:
    """Return how well an FMU variable's name and description match a role, 0 .. 3.

    3 for a synonym, 2 if the name contains one, 1 if the description does, else 0.
    """
    lower = name.lower().rpartition(".")[2]
    words = re.split(r"[^a-z0-9]+", lower)
    if lower in role.synonyms:
        return 3
    if any(synonym in lower if len(synonym) > 2 else synonym in words for synonym in role.synonyms):
        return 2
    described = variable.description.lower()
    return int(any(len(synonym) > 3 and synonym in described for synonym in role.synonyms))


class AmbiguousRoles(InputRefused):
    """Error for a required role of a drive with no or several candidate variables; the message names the role."""


def ambiguity_message(
    file: str,
    variables: Mapping[str, Variable],
    roles: tuple[Role, ...],
    chosen: Mapping[str, str],
    unsure: list[Role],
    rotor: bool,
) -> str:
    """Return the error message for roles without a clear variable, with the TOML that resolves them.

    `chosen` has the variable by resolved role; with a `rotor`, twin simulates the shaft.
    """
    lines = [f"{file}: undecided which of its variables is {' and which is '.join(r.port.name for r in unsure)}."]
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
    """The user's mapping of a drive's FMU: command, sign, gear ratio, and the variable of each role.

    Attributes:
        sign: -1 if the FMU turns in the opposite direction.
        gear_ratio: turns of its shaft per turn of the motor shaft theta_m.
        inputs, outputs: role -> the FMU's variable; "-name" if only that variable has the opposite sign, "name[rpm]" if
            its FMU declares no unit.
        rotor: whether twin simulates the shaft.
    """

    command: Command = "velocity"
    sign: Literal[1, -1] = 1
    gear_ratio: float = 1.0
    inputs: Mapping[str, str] = field(default_factory=dict)
    outputs: Mapping[str, str] = field(default_factory=dict)
    rotor: bool = False


@dataclass(frozen=True)
class Binding:
    """A role of the contract and the FMU variable that fills it: contract value = gain * FMU value + offset.

    Attributes:
        name: user's name of the variable, with its part if the drive has parts.
        turned: whether only this variable has the opposite sign.
    """

    role: Role
    variable: Variable
    name: str
    gain: float
    offset: float
    turned: bool = False

    @property
    def port(self) -> Port:
        """Port of the contract that the variable fills, as wide as the variable."""
        return replace(self.role.port, size=self.variable.size)

    @property
    def mapped_name(self) -> str:
        """Name of the variable as a mapping spells it: "-name" if it has the opposite sign."""
        return f"-{self.name}" if self.turned else self.name

    def __str__(self) -> str:
        arrow = "<-" if self.role.causality == "input" else "->"
        unit = f" [{self.variable.unit}]" if self.variable.unit else " [unit not stated]"
        return f"{self.port.name} {arrow} {self.mapped_name}{unit}"


def split_unit(text: str) -> tuple[str, str]:
    """Split an entry of a mapping such as `speed_cmd[rpm]` into variable name and unit; the unit is "" if missing."""
    found = _IN_UNIT.fullmatch(text)
    return (found["name"], found["unit"]) if found else (text, "")


def with_units(
    file: str, variables: Mapping[str, Variable], mappings: Sequence[Mapping[str, Any]]
) -> tuple[dict[str, Variable], list[dict[str, Any]]]:
    """Add the units stated in mappings to FMU variables without a unit; return variables, and mappings without units.

    A complete variable name such as `x[2]` is not split. A mapping has a name, or several, by role.
    """
    known = dict(variables)

    def bare(text: str) -> str:
        sign = "-" * (text.startswith("-") and text not in known)
        plain = text[len(sign) :].strip()
        name, spelled = split_unit(plain)
        alike = [n for n in known if n == name or n.startswith(f"{name}[")]
        if not spelled or plain in known or not alike:
            return text
        # a unit that the contract does not use may be a unit of a log
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
    """The FMU variable chosen for each role of a drive.

    Attributes:
        turned: roles whose variable alone has the opposite sign.
        unsure: required roles with no or several candidates.
    """

    chosen: dict[str, str]
    turned: set[str]
    unsure: list[Role]


def bindings(file: str, variables: Mapping[str, Variable], wiring: Wiring) -> tuple[Binding, ...]:
    """Map every role of the drive contract to the drive's FMU variable that fills it, inputs first.

    `variables` are by the user's names; `file` names the drive in error messages.

    Raises:
        InputRefused: unknown role or variable, wrong causality or unit, or a required role with no or several
            candidates.
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
    """Map the optional roles of a robot part to the FMU variables that fill them, in order.

    For `file` and `variables`, see `bindings`; `table` is the table of the experiment with the mapping.
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
        # a gear does not change voltage or current, but the shaft's direction does
        electrical = float(wiring.sign) if role in COMMAND_ROLES.values() else 1.0
        alone = role.port.name in turned
        mechanical = {1: 1.0 / ratio, -1: ratio, 0: electrical}[role.mechanical] * (-1.0 if alone else 1.0)
        found.append(Binding(role, variables[name], name, factor * mechanical, offset * mechanical, alone))
    return tuple(found)


def choose_variables(file: str, variables: Mapping[str, Variable], wiring: Wiring, roles: Sequence[Role]) -> RoleChoice:
    """Choose an FMU variable for each role: the user's, else the only one that fits."""
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
    """Return a mapped variable's name after checking that the variable can fill the role."""
    if name not in variables:
        offered = [n for n, v in variables.items() if v.causality == role.causality]
        there = f"its {role.causality}s are {', '.join(offered)}" if offered else f"it has no {role.causality}"
        raise InputRefused(f"{file}: has no variable '{name}' for {role.port.name}; {there}")
    variable = variables[name]
    # some tools declare their outputs as local; these cannot be written, but they can be read
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
    """A possible wire between two parts of a drive, from output to input, "part.variable" each."""

    source: str
    target: str
    sure: bool = True


def part_name(name: str) -> str:
    """Return the part's name of a variable called "part.variable"."""
    return name.partition(".")[0]


def wire_error(variables: Mapping[str, Variable], source: str, target: str) -> str:
    """Return why a wire from `source` to `target` is impossible; "" if it is possible."""
    for end, causalities in ((source, ("output", "local")), (target, ("input",))):
        if end not in variables:
            return f"{end} does not exist"
        if variables[end].causality not in causalities or variables[end].kind < 0:
            return f"{end} has causality {variables[end].causality} and type {variables[end].type}"
    a, b = variables[source].conversion, variables[target].conversion
    if a and b and a.dimension != b.dimension:
        return f"units {variables[source].unit} and {variables[target].unit} have different dimensions"
    return ""


def propose_wires(variables: Mapping[str, Variable]) -> list[WireProposal]:
    """Propose wires between the parts of a drive, from equal names, or from a single output of the same dimension.

    The inputs left for the robot must include a load and a command: so inputs named like these are never wired by
    dimension alone, and if no input is left, no wire by dimension is sure. Variables are named "part.variable".
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
    """Whether an input is probably fed by the robot or left open, judged by its name."""
    return any(word in _variable_name(name) for word in FED_INPUT_WORDS) or _variable_name(name) in SUPPLY_WORDS


def _sources(variables: Mapping[str, Variable], target: str, measured: bool = False) -> Sequence[str]:
    """Return the outputs of other parts that can feed an input; `measured` requires a unit at both ends."""
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
