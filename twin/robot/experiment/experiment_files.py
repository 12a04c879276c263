"""Experiment, sweep and body files by path or name."""

import os
from pathlib import Path
from typing import Any

from twin.kernel.errors import InputRefused, nearest
from twin.robot.experiment.source import Source, merge_tables, read_source
from twin.robot.paths import PROJECT_FOLDER, locate_file

SWEEP_FOLDER = "experiments/sweeps"
BODY_FOLDERS = ("bodies", "experiments/bodies")


def known_experiments() -> dict[str, Path]:
    """The files of the experiments that come with twin, by name."""
    return {path.stem: path for path in sorted(PROJECT_FOLDER.glob("experiments/*.toml"))}


def experiment_file(experiment: str | Path) -> Path:
    """The file of an experiment.

    Args:
        experiment: a path as seen from the current folder, or from the repository if it is not there; or a name:
            NAME.toml here, in experiments/ here or above, or of those that come with twin.

    Raises:
        InputRefused: nothing has that name. Else a path that leads nowhere is returned, to be refused when it is read.
    """
    path = Path(experiment)
    found = _experiment_file(path, "experiments")
    if found:
        return found
    if os.path.isdir(path):
        return path
    raise InputRefused(f"{path}: no such experiment; {nearest(path.name, known_experiments())}")


def sweep_file(sweep: Path) -> Path:
    """The file of a sweep: a path or a name, looked up as `experiment_file` does, names in experiments/sweeps/.

    Raises:
        InputRefused: nothing has that name. Else a path that leads nowhere is returned, to be refused when it is read.
    """
    found = _experiment_file(sweep, SWEEP_FOLDER)
    if found:
        return found
    known = [path.stem for path in sorted(PROJECT_FOLDER.glob(f"{SWEEP_FOLDER}/*.toml"))]
    raise InputRefused(f"{sweep}: no such sweep file; {nearest(sweep.name, known)}")


def _experiment_file(path: Path, shelf: str) -> Path | None:
    """The file meant by `path`; of a name that of `shelf`, None if there is none."""
    # not Path.is_file, which raises where a name is too long
    if os.path.isfile(path):
        return path
    if path.suffix == ".toml" or len(path.parts) > 1:
        return PROJECT_FOLDER / path if os.path.isfile(PROJECT_FOLDER / path) else path
    candidates = (Path(f"{path}.toml"), locate_file(f"{shelf}/{path}.toml", Path.cwd()))
    return next((candidate for candidate in candidates if os.path.isfile(candidate)), None)


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
    path = _body_file(contact["body"], folder)
    body = read_source(path)
    filling = body.values.get("contact")
    if body.values.keys() != {"contact"} or not isinstance(filling, dict) or "body" in filling:
        raise InputRefused(f"{path}: expected one table [contact], without 'body'")
    source.values["contact"] = merge_tables(filling, contact)
    source.origins = {**body.origins, **source.origins}


def _body_file(name: Any, folder: Path) -> Path:
    if not isinstance(name, str):
        raise InputRefused(f"[contact] body = {name!r}: expected the name of a body in quotes")
    if name.endswith(".toml"):
        return locate_file(name, folder)
    shelves = [locate_file(shelf, folder) for shelf in BODY_FOLDERS]
    known = sorted({path.stem for shelf in shelves for path in shelf.glob("*.toml")})
    for shelf in shelves:
        # not Path.is_file, which raises for a name that is too long
        if os.path.isfile(shelf / f"{name}.toml"):
            return shelf / f"{name}.toml"
    raise InputRefused(f'[contact] body = "{name}": no such body; {nearest(name, known)}')
