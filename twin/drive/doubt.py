"""What to say where it is unclear which variable plays which role: the TOML that ends the doubt."""

from collections.abc import Mapping

from twin.drive.candidates import candidates, likely_command, measures, proposals
from twin.drive.contract import COMMANDS, TAU_MOTOR, THETA_M, Command, Role
from twin.drive.variable import Variable
from twin.errors import InputRefused


class RolesUnclear(InputRefused):
    """A required role has no or several answers; the sentence says which."""


def _other_command(variables: Mapping[str, Variable], unsure: list[Role], taken: set[str]) -> Command | None:
    """What the drive seems to be commanded with, if nothing in it takes a speed."""
    likely = likely_command(variables, taken) if COMMANDS["velocity"] in unsure else "velocity"
    return likely if likely != "velocity" else None


def to_paste(
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
    other = _other_command(variables, unsure, set(chosen.values()))
    if other:
        loop = "" if other == "position" else ", which needs a velocity loop of ours in front of it"
        lines.append(f"It seems to be commanded with a {other}{loop}.")
        roles = (COMMANDS[other], *(role for role in roles if role is not COMMANDS["velocity"]))
        unsure = [*unsure, COMMANDS[other]]
    still = not any(v.causality in ("output", "local") and measures(v, THETA_M) for v in variables.values() if v.unit)
    if still and not rotor and proposals(variables, TAU_MOTOR, set()):
        lines.append("It gives a torque and no angle: if its shaft is to be ours, add [drive.rotor] J_kg_m2 = 1e-4.")
    lines.append("Complete this in the experiment, or without 'drive.' in the mapping.toml beside the FMU:")
    if other:
        lines += ["[drive]", f'command = "{other}"']
    if other and other != "position":
        lines.append("[drive.velocity_loop]")
        unit = COMMANDS[other].port.unit
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
