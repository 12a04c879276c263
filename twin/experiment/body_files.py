"""From [contact] body = "back" to a complete [contact]: the body's file fills in what the experiment does not say."""

import os
from pathlib import Path
from typing import Any

from twin.errors import InputRefused, nearest
from twin.experiment.source import COMMAND_LINE, Source, laid_over, read_source
from twin.places import located

FOLDERS = ("bodies", "experiments/bodies")


def fill_from_body(source: Source, folder: Path) -> None:
    """Complete the [contact] of `source` from the body file that it names, values and origins, in place.

    What [contact] says itself stays. Without `body` nothing is done.

    Args:
        folder: the experiment's, from which bodies are looked up like `extends` and fmus/.

    Raises:
        InputRefused: no such body, or its file is not a [contact] table.
    """
    contact = source.values.get("contact")
    if not isinstance(contact, dict) or "body" not in contact:
        return
    path = _file(contact["body"], folder)
    body = read_source(path)
    filling = body.values.get("contact")
    if body.values.keys() != {"contact"} or not isinstance(filling, dict) or "body" in filling:
        raise InputRefused(f"{path}: expected one table [contact], without 'body'")
    source.values["contact"] = laid_over(filling, contact)
    source.origins = {**body.origins, **source.origins}


def replace_body(source: Source, name: str) -> None:
    """Make body `name` what the robot presses on; of the [contact] before only the height stays."""
    source.forget("contact", keep=("height_mm",))
    source.values["contact"] = {"body": name, **source.values.get("contact", {})}
    source.origins["contact.body"] = COMMAND_LINE


def _file(name: Any, folder: Path) -> Path:
    if not isinstance(name, str):
        raise InputRefused(f"[contact] body = {name!r}: expected the name of a body in quotes")
    if name.endswith(".toml"):
        return located(name, folder)
    shelves = [located(shelf, folder) for shelf in FOLDERS]
    known = sorted({path.stem for shelf in shelves for path in shelf.glob("*.toml")})
    for shelf in shelves:
        # not Path.is_file, which raises for a name that is too long
        if os.path.isfile(shelf / f"{name}.toml"):
            return shelf / f"{name}.toml"
    raise InputRefused(f'[contact] body = "{name}": no such body; {nearest(name, known)}')
