"""Which variable of a foreign drive plays which role, and how its values become the contract's.

What the user maps is taken as said, if it can be right; what is left is proposed from names, units, causality and
descriptions, and only if there is one answer. Otherwise the error is the TOML to paste.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal, NamedTuple

from twin.cosim.port import Port
from twin.drive.candidates import measures, plays, proposals, score
from twin.drive.contract import COMMANDS, Command, Role, contract
from twin.drive.description import Variable
from twin.drive.doubt import RolesUnclear, to_paste
from twin.drive.units import Conversion
from twin.errors import InputRefused
from twin.units import weight_hint


@dataclass(frozen=True)
class Wiring:
    """What the user says of a drive.

    Attributes:
        command: what it is commanded with.
        sign: -1 if the FMU turns the other way.
        gear_ratio: turns of its shaft per turn of the motor shaft theta_m.
        inputs, outputs: role -> the FMU's variable; "-name" if that one alone counts the other way.
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
    def said(self) -> str:
        """The variable as a mapping names it."""
        return f"-{self.name}" if self.turned else self.name

    def __str__(self) -> str:
        arrow = "<-" if self.role.causality == "input" else "->"
        unit = f" [{self.variable.unit}]" if self.variable.unit else " [unit not stated]"
        return f"{self.port.name} {arrow} {self.said}{unit}"


class Choice(NamedTuple):
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
    roles = contract(wiring.command, wiring.rotor)
    _refuse_unknown_roles(file, wiring, roles, "drive")
    chosen, turned, unsure = choice(file, variables, wiring, roles)
    if unsure:
        raise RolesUnclear(to_paste(file, variables, roles, chosen, unsure, wiring.rotor))
    found = _all_bound(variables, wiring, roles, chosen, turned)
    _refuse_odd_widths(file, found)
    return found


def filled(
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
    chosen, turned, _ = choice(file, variables, wiring, roles)
    return _all_bound(variables, wiring, roles, chosen, turned)


def _all_bound(
    variables: Mapping[str, Variable],
    wiring: Wiring,
    roles: Sequence[Role],
    chosen: Mapping[str, str],
    turned: Collection[str],
) -> tuple[Binding, ...]:
    return tuple(
        _bound(role, variables[chosen[role.port.name]], chosen[role.port.name], wiring, role.port.name in turned)
        for role in roles
        if role.port.name in chosen
    )


def choice(file: str, variables: Mapping[str, Variable], wiring: Wiring, roles: Sequence[Role]) -> Choice:
    """What the user says, and of the other `roles` those that have one answer.

    Raises:
        InputRefused: unknown variable, wrong causality or unit, or one for two roles.
    """
    chosen: dict[str, str] = {}
    turned: set[str] = set()
    for role in roles:
        said = (wiring.inputs if role.causality == "input" else wiring.outputs).get(role.port.name)
        if said is not None:
            if said.startswith("-") and said not in variables:
                turned.add(role.port.name)
                said = said.removeprefix("-").strip()
            chosen[role.port.name] = _checked(file, variables, role, said)
        elif role.port.name in variables and plays(variables[role.port.name], role):
            chosen[role.port.name] = role.port.name
    _refuse_two_roles(file, chosen)
    unsure: list[Role] = []
    for role in roles:
        if role.port.name not in chosen:
            best = proposals(variables, role, set(chosen.values()))
            if len(best) == 1 and (role.required or score(best[0], variables[best[0]], role) >= 2):
                chosen[role.port.name] = best[0]
            elif role.required:
                unsure.append(role)
    return Choice(chosen, turned, unsure)


def _refuse_two_roles(file: str, chosen: Mapping[str, str]) -> None:
    for name in set(chosen.values()):
        roles = [role for role, variable in chosen.items() if variable == name]
        if len(roles) > 1:
            raise InputRefused(f"{file}: '{name}' is given to {' and '.join(roles)}; one variable plays one role")


def _bound(role: Role, variable: Variable, name: str, wiring: Wiring, turned: bool) -> Binding:
    _, factor, offset = variable.conversion or Conversion(role.dimension)
    ratio = wiring.sign * wiring.gear_ratio
    # no gear changes a voltage or a current, but the shaft turns with its sign
    electrical = float(wiring.sign) if role in COMMANDS.values() else 1.0
    mechanical = {1: 1.0 / ratio, -1: ratio, 0: electrical}[role.mechanical] * (-1.0 if turned else 1.0)
    return Binding(role, variable, name, factor * mechanical, offset * mechanical, turned)


def _refuse_odd_widths(file: str, found: tuple[Binding, ...]) -> None:
    widths = {b.port.name: b.port.size for b in found if b.role.required}
    if len(set(widths.values())) > 1 or not set(widths.values()) <= {1, 3}:
        told = ", ".join(f"{name} has {size}" for name, size in widths.items())
        raise InputRefused(f"{file}: {told} values; expected 1 each for one joint, or 3 each for all three")


def _refuse_unknown_roles(file: str, wiring: Wiring, roles: Sequence[Role], owner: str) -> None:
    commanded = f' for command = "{wiring.command}"' if owner == "drive" else ""
    for table, given, causality in (("inputs", wiring.inputs, "input"), ("outputs", wiring.outputs, "output")):
        known = [role.port.name for role in roles if role.causality == causality]
        for name in given:
            if name not in known:
                raise InputRefused(
                    f"{file}: [{owner}.{table}] has no role '{name}'{commanded}; the roles are {', '.join(known)}"
                )


def _checked(file: str, variables: Mapping[str, Variable], role: Role, name: str) -> str:
    """`name`, if the variable the user gave to `role` can play it."""
    if name not in variables:
        offered = [n for n, v in variables.items() if v.causality == role.causality]
        there = f"its {role.causality}s are {', '.join(offered)}" if offered else f"it has no {role.causality}"
        raise InputRefused(f"{file}: has no variable '{name}' for {role.port.name}; {there}")
    variable = variables[name]
    # some tools leave their outputs marked as local; nobody can write to them, but they can be read
    allowed = ("input",) if role.causality == "input" else ("output", "local")
    if variable.causality not in allowed:
        raise InputRefused(
            f"{file}: '{name}' has causality {variable.causality}; {role.port.name} needs {role.causality}"
        )
    if variable.kind < 0:
        raise InputRefused(f"{file}: '{name}' has type {variable.type}; {role.port.name} needs a number")
    if not measures(variable, role):
        raise InputRefused(
            f"{file}: {role.causality} '{name}' has unit '{variable.unit}'; "
            f"{role.port.name} needs one like {role.port.unit}"
            f"{weight_hint(variable.conversion.dimension, role.dimension) if variable.conversion else ''}"
        )
    return name
