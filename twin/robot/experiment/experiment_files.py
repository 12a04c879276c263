"""Lookup of experiment, sweep, body and drive files by path or name."""

import os
import shlex
from pathlib import Path
from typing import Any

from twin.kernel.errors import InputRefused, nearest
from twin.robot.experiment.source import Source, merge_tables, read_source
from twin.robot.paths import PROJECT_FOLDER, locate_file

SWEEP_FOLDER = "experiments/sweeps"
BODY_FOLDERS = ("bodies", "experiments/bodies")
MAPPING_FILE = "mapping.toml"


def known_experiments() -> dict[str, Path]:
    """Return the files of the experiments shipped with twin, by name."""
    return {path.stem: path for path in sorted(PROJECT_FOLDER.glob("experiments/*.toml"))}


def drive_names(shelf: Path) -> list[str]:
    """Return the sorted names of the drives in a folder such as fmus/."""
    return sorted(f.name for f in shelf.glob("*") if (f / MAPPING_FILE).is_file() or any(f.glob("*.fmu")))


def experiment_file(experiment: str | Path) -> Path:
    """Find the file of an experiment, given by path or name.

    Args:
        experiment: a path relative to the current folder or the repository; or a name: NAME.toml in the current folder,
            in experiments/ here or above, or among the experiments shipped with twin.

    Raises:
        InputRefused: the name is unknown. A path to a missing file is returned, to be refused when it is read.
    """
    path = Path(experiment)
    found = _experiment_file(path, "experiments")
    if found:
        return found
    if os.path.isdir(path):
        return path
    raise InputRefused(f"{path}: no such experiment; {nearest(path.name, known_experiments())}")


def sweep_file(sweep: Path) -> Path:
    """Find the file of a sweep by path or name, like `experiment_file`, names in experiments/sweeps/."""
    found = _experiment_file(sweep, SWEEP_FOLDER)
    if found:
        return found
    if _experiment_file(sweep, "experiments"):
        raise InputRefused(no_sweep_message(sweep))
    known = [path.stem for path in sorted(PROJECT_FOLDER.glob(f"{SWEEP_FOLDER}/*.toml"))]
    raise InputRefused(f"{sweep}: no such sweep file; {nearest(sweep.name, known)}")


def no_sweep_message(experiment: Path) -> str:
    """Return the error message for an experiment given in place of a sweep file: the command to type."""
    command = shlex.join(["twin", "run", str(experiment), "--sweep", "robot.k_s_Nm_per_rad=0.5:3:6"])
    return (
        f"{experiment}: an experiment, not a sweep file; type {command}, with the key to vary, its first value, its "
        "last value and the number of values"
    )


def _experiment_file(path: Path, shelf: str) -> Path | None:
    """Return the file for a path, or for a name in a subfolder such as experiments/; None if the name is unknown."""
    # not Path.is_file, which raises for a too long name
    if os.path.isfile(path):
        return path
    if path.suffix == ".toml" or len(path.parts) > 1:
        return PROJECT_FOLDER / path if os.path.isfile(PROJECT_FOLDER / path) else path
    candidates = (Path(f"{path}.toml"), locate_file(f"{shelf}/{path}.toml", Path.cwd()))
    return next((candidate for candidate in candidates if os.path.isfile(candidate)), None)


def fill_from_body(source: Source, folder: Path) -> None:
    """Complete the [contact] table of an experiment in place from the body file that it names.

    Its own values stay. A remark states the height of the surface unless file or option set it together with the body.
    Without the key `body` nothing is done. Bodies are looked up from `folder`, like `extends` and fmus/.
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
    own = source.origins.get("contact.height_mm")
    source.origins = {**body.origins, **source.origins}
    if "height_mm" in source.values["contact"] and (own is None or own != source.origins.get("contact.body")):
        owner, origin = ("the experiment", own) if own else (path.name, source.origins["contact.height_mm"])
        height = source.values["contact"]["height_mm"]
        source.remarks.append(f"surface at z = {height} mm, height_mm of {owner} ({origin})")


def _body_file(name: Any, folder: Path) -> Path:
    if not isinstance(name, str):
        raise InputRefused(f"[contact] body = {name!r}: expected the name of a body in quotes")
    if name.endswith(".toml"):
        return locate_file(name, folder)
    shelves = [locate_file(shelf, folder) for shelf in BODY_FOLDERS]
    known = sorted({path.stem for shelf in shelves for path in shelf.glob("*.toml")})
    for shelf in shelves:
        # not Path.is_file, which raises for a too long name
        if os.path.isfile(shelf / f"{name}.toml"):
            return shelf / f"{name}.toml"
    raise InputRefused(f'[contact] body = "{name}": no such body; {nearest(name, known)}')
