"""Experiments that come with twin, and the file that is meant by a name or a path."""

import os
from pathlib import Path

from twin.errors import InputRefused, nearest
from twin.places import HOME, located

SWEEPS = "experiments/sweeps"


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
    found = _file(path, "experiments")
    if found:
        return found
    if os.path.isdir(path):
        return path
    raise InputRefused(f"{path}: no such experiment; {nearest(path.name, known_experiments())}")


def sweep_file(sweep: Path) -> Path:
    """The file of a sweep: a path or a name, looked up as `experiment_file` does, names in experiments/sweeps/.

    Raises:
        InputRefused: nothing has that name. Else a path that leads nowhere is returned, for whoever reads it to refuse.
    """
    found = _file(sweep, SWEEPS)
    if found:
        return found
    known = [path.stem for path in sorted(HOME.glob(f"{SWEEPS}/*.toml"))]
    raise InputRefused(f"{sweep}: no such sweep file; {nearest(sweep.name, known)}")


def _file(path: Path, shelf: str) -> Path | None:
    """The file meant by `path`; of a name that of `shelf`, None if there is none."""
    # not Path.is_file, which raises where a name is too long
    if os.path.isfile(path):
        return path
    if path.suffix == ".toml" or len(path.parts) > 1:
        return HOME / path if os.path.isfile(HOME / path) else path
    candidates = (Path(f"{path}.toml"), located(f"{shelf}/{path}.toml", Path.cwd()))
    return next((candidate for candidate in candidates if os.path.isfile(candidate)), None)
