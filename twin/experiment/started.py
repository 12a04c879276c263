"""A new experiment file and its schema, written."""

import difflib
import os
from pathlib import Path

from twin.errors import InputRefused
from twin.experiment.json_schema import SCHEMA_FILE, schema_text
from twin.experiment.source import CHECKOUT
from twin.experiment.template import commented_experiment
from twin.files import made_folder, write_text


def start_experiment(file: Path, start: str) -> list[Path]:
    """Write an experiment to `file` that does what the repository's experiment `start` does.

    Returns:
        The files that were written: `file`, and beside it the JSON Schema if none was there.

    Raises:
        InputRefused: `file` exists, or there is no experiment `start`.
        NotWritten: the disk refuses.
    """
    known = {path.stem: path for path in sorted(CHECKOUT.glob("experiments/*.toml"))}
    if not known:
        raise InputRefused(
            f"{CHECKOUT}: no experiments/ there to start from; install from the repository: pip install -e ."
        )
    if start not in known:
        close = difflib.get_close_matches(start, known, 1)
        hint = f"did you mean '{close[0]}'?" if close else f"known are {', '.join(known)}"
        raise InputRefused(f"--from {start}: no such experiment; {hint}")
    if file.suffix != ".toml":
        raise InputRefused(f"{file}: expected a name that ends with .toml")
    schema = file.parent / SCHEMA_FILE
    text = commented_experiment(file.name, known[start])
    made_folder(file.parent)
    if os.path.lexists(file):
        raise InputRefused(f"{file}: exists, and is never overwritten; choose another name")
    write_text(file, text)
    if os.path.lexists(schema):
        return [file]
    write_text(schema, schema_text())
    return [file, schema]
