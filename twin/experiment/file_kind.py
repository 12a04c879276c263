"""TOML files that are no experiments, told apart by what stands in them."""

import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from twin.errors import InputRefused


def refuse_other_files(values: Mapping[str, Any], path: Path) -> None:
    """Raise if the file at `path` is meant for something else than to be run: a robot, a body, a sweep, a mapping.

    Args:
        values: what it and the files that it extends say.
        path: of the file.

    Raises:
        InputRefused: the sentence says what it is, and what takes it.
    """
    tables, name = values.keys(), shlex.quote(str(path))
    told = ""
    if tables <= {"robot", "controller", "plant"} and "robot" in tables:
        told = f"a robot, not an experiment; one extends it: extends = {str(path)!r}; twin init writes a whole one"
    elif tables == {"contact"}:
        told = f"a body, not an experiment; press on it with: twin run pressing --body {name}"
    elif {"experiment", "vary"} & tables and "title" not in tables:
        told = f"a sweep, not an experiment; run it with: twin sweep {name}"
    elif tables & {"fmu", "fmus"}:
        told = f"the mapping of a drive, not an experiment; use it with: twin run fig4_force_position --drive {name}"
    if told:
        raise InputRefused(f"{path}: {told}")
