"""A new experiment file and its schema, written."""

import os
from pathlib import Path

from twin.errors import InputRefused, nearest
from twin.experiment.declared import Declared
from twin.experiment.json_schema import SCHEMA_FILE, schema_text
from twin.experiment.named import known_experiments
from twin.experiment.template import commented_experiment
from twin.writing import made_folder, write_text


def start_experiment(declared: Declared, file: Path, start: str) -> list[Path]:
    """Write an experiment to `file` that does what the experiment `start` of those that come with twin does.

    Returns:
        The files that were written: `file`, and beside it the JSON Schema if none was there.

    Raises:
        InputRefused: `file` exists, or there is no experiment `start`.
        NotWritten: the disk refuses.
    """
    known = known_experiments()
    if start not in known:
        raise InputRefused(f"--from {start}: no such experiment; {nearest(start, known_experiments())}")
    if file.suffix != ".toml":
        raise InputRefused(f"{file}: expected a name that ends with .toml")
    schema = file.parent / SCHEMA_FILE
    text = commented_experiment(declared, file.name, known[start])
    made_folder(file.parent)
    if os.path.lexists(file):
        raise InputRefused(f"{file}: exists, and is never overwritten; choose another name")
    write_text(file, text)
    if os.path.lexists(schema):
        return [file]
    write_text(schema, schema_text(declared))
    return [file, schema]
