"""A supplier's FMU brought in through the page: what it offers, read without its binary, and the mapping it gets."""

import shutil
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import tomlkit

from twin.kernel.errors import InputRefused
from twin.kernel.fmi.description import FmuDescription, described
from twin.kernel.writing import made_folder, write_text, written
from twin.report.explore import EXPLORED_FOLDER
from twin.robot.drive.contract import COMMANDS, Command, contract
from twin.robot.drive.mapping import Wiring, candidates, choice
from twin.robot.experiment.drive_files import MAPPING
from twin.robot.experiment.schema import VelocityLoop
from twin.studies.qualify.proposal import understood

LOOPED = ("torque", "current", "voltage")
"""Commands behind which our velocity loop stands."""


def inspected(fmu: Path) -> dict[str, Any]:
    """What the FMU is, and who may play which role; nothing of it is loaded.

    Raises:
        InputRefused: it is no FMU, or none for this machine.
    """
    description = described(fmu)
    command, _, sure = understood(fmu.name, description.variables)
    return {
        "file": fmu.name,
        "tool": description.model.generationTool or "",
        "fmi": description.model.fmiVersion,
        "sha256": description.sha256,
        "command": command,
        "sure": sure,
        "commands": {name: _roles(description, name) for name in COMMANDS},
        "loop": {
            setting.key(name): setting.more["examples"][0]
            for name, setting in VelocityLoop.settings.items()
            if "examples" in setting.more
        },
        "looped": LOOPED,
    }


def _roles(description: FmuDescription, command: Command) -> list[dict[str, Any]]:
    """The roles of a drive with this command: who plays each, who else could, and whether that is in doubt."""
    variables, roles = description.variables, contract(command)
    chosen: Mapping[str, str] = {}
    unsure: list[str] = []
    with suppress(InputRefused):
        found = choice(description.path.name, variables, Wiring(command), roles)
        chosen, unsure = found.chosen, [role.port.name for role in found.unsure]
    return [
        {
            "role": role.port.name,
            "side": f"{role.causality}s",
            "unit": role.port.unit,
            "meaning": role.port.meaning,
            "required": role.required,
            "chosen": chosen.get(role.port.name, ""),
            "unsure": role.port.name in unsure,
            "choices": [[name, variables[name].unit or ""] for name in candidates(variables, role)],
        }
        for role in roles
    ]


def mapping_text(fmu: Path, how: Any) -> str:
    """The mapping.toml of what the page has chosen, beside the FMU.

    Args:
        fmu: the file.
        how: {"command": one of `COMMANDS`, "roles": {role: variable}, "loop": {key: number}}; it may say anything.

    Raises:
        InputRefused: it says something else; whether variables fit their roles is left to the drive's own checks.
    """
    command = how.get("command") if isinstance(how, dict) else None
    if command not in COMMANDS:
        raise InputRefused(f"command: expected one of {', '.join(COMMANDS)}")
    description, roles = described(fmu), how.get("roles")
    if not isinstance(roles, dict) or not all(name in description.variables for name in roles.values()):
        raise InputRefused(f"{fmu.name}: expected its own variables for the roles")
    document = tomlkit.document()
    document.add(tomlkit.comment("Brought in through twin explore"))
    document.add("fmu", tomlkit.item(fmu.name))
    document.add("sha256", tomlkit.item(description.sha256))
    document.add("command", tomlkit.item(command))
    for side in ("inputs", "outputs"):
        sides = {role.port.name for role in contract(command) if f"{role.causality}s" == side}
        document.add(side, tomlkit.item({role: name for role, name in roles.items() if role in sides}))
    if command in LOOPED:
        loop = how.get("loop")
        if not isinstance(loop, dict) or not all(isinstance(v, int | float) for v in loop.values()):
            raise InputRefused("velocity_loop: expected numbers")
        known = {setting.key(name) for name, setting in VelocityLoop.settings.items()}
        document.add("velocity_loop", tomlkit.item({key: float(v) for key, v in loop.items() if key in known}))
    return tomlkit.dumps(document)


def settled(fmu: Path, how: Any) -> tuple[str, Path]:
    """(the name that pages have for it, its mapping): a copy of the FMU with its mapping, below `EXPLORED_FOLDER`.

    Raises:
        InputRefused: see `mapping_text`.
        NotWritten: the disk refuses.
    """
    text = mapping_text(fmu, how)
    folder = made_folder(EXPLORED_FOLDER / f"{fmu.stem}-{described(fmu).sha256[:8]}")
    with written(folder / fmu.name) as beside:
        shutil.copyfile(fmu, beside)
    write_text(folder / MAPPING, text)
    return f"{fmu.stem} (brought in)", folder / MAPPING
