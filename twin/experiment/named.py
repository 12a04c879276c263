"""Experiments that come with twin, and the file that is meant by a name or a path."""

import os
from pathlib import Path

from twin.errors import InputRefused, nearest
from twin.places import HOME, located


def known_experiments() -> dict[str, Path]:
    """The files of the experiments that come with twin, by name."""
    return {path.stem: path for path in sorted(HOME.glob("experiments/*.toml"))}


def experiment_file(experiment: str | Path) -> Path:
    """The file of an experiment.

    Args:
        experiment: a path as seen from the current folder, or from the repository if it is not there; or a name:
            NAME.toml here, in experiments/ here or above, or of those that come with twin.

    Raises:
        InputRefused: nothing has that name. Else a path that leads nowhere is returned, for whoever reads it to refuse.
    """
    path = Path(experiment)
    # not Path.is_file, which raises where a name is too long
    if os.path.isfile(path):
        return path
    if path.suffix == ".toml" or len(path.parts) > 1:
        return HOME / path if os.path.isfile(HOME / path) else path
    candidates = (Path(f"{path}.toml"), located(f"experiments/{path}.toml", Path.cwd()))
    for candidate in candidates:
        if os.path.isfile(candidate):
            return candidate
    if os.path.isdir(path):
        return path
    raise InputRefused(f"{path}: no such experiment; {nearest(path.name, known_experiments())}")
