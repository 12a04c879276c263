"""Completions of a shell at TAB; imports only the reading of TOML files."""

import os
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

from twin.kernel.errors import InputRefused


def experiment_files(incomplete: str) -> list[str]:
    """List experiment files for shell completion: of this folder and experiments/, else the names shipped with twin."""
    files = [*Path().glob("*.toml"), *Path("experiments").glob("*.toml")]
    return _starting_with(incomplete, map(str, files)) or experiment_names(incomplete)


def experiment_names(incomplete: str) -> list[str]:
    """List the experiments shipped with twin for shell completion, without folder and suffix."""
    from twin.robot.experiment.experiment_files import known_experiments

    return _starting_with(incomplete, known_experiments())


def drive_names(incomplete: str) -> list[str]:
    from twin.robot.experiment import experiment_files
    from twin.robot.paths import locate_file

    return _starting_with(incomplete, experiment_files.drive_names(locate_file("fmus", Path.cwd())))


def role_names(incomplete: str) -> list[str]:
    """List the robot's parts that may be third-party for shell completion."""
    from twin.robot.experiment.source import RETAINED_KEYS

    return _starting_with(incomplete, RETAINED_KEYS)


def body_names(incomplete: str) -> list[str]:
    from twin.robot.experiment.experiment_files import BODY_FOLDERS
    from twin.robot.paths import locate_file

    bodies = {body.stem for folder in BODY_FOLDERS for body in locate_file(folder, Path.cwd()).glob("*.toml")}
    return _starting_with(incomplete, bodies)


def setting_keys(incomplete: str) -> list[str]:
    """List keys for shell completion of --set: those set by the experiments on the command line."""
    from twin.robot.experiment.source import read_source

    keys: set[str] = set()
    # the parser rejects the whole line while an option lacks its value; shells pass the line itself
    for word in os.environ.get("COMP_WORDS", "").split():
        try:
            keys |= read_source(Path(word)).origins.keys() if word.endswith(".toml") else set()
        # errors in an unfinished line are ignored
        except InputRefused:
            continue
    return _starting_with(incomplete, (f"{key}=" for key in keys))


def _starting_with(incomplete: str, words: Iterable[str]) -> list[str]:
    return sorted(word for word in words if word.startswith(incomplete))


COMPLETION_FUNCTIONS: Mapping[str, Callable[[str], list[str]]] = {
    "experiment": experiment_files,
    "experiment name": experiment_names,
    "drive": drive_names,
    "body": body_names,
    "setting": setting_keys,
    "role": role_names,
}
"""Name in an option's `complete` -> completion function."""
