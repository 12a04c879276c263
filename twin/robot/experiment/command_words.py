"""The command line of a run, and of one that repeats a stored run."""

import shlex
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from twin.robot.experiment.differences import flatten
from twin.robot.experiment.source import COMMAND_LINE, toml_value

OPTION_KEYS = {"drive.fmu": "--drive", "contact.body": "--body"}
"""Keys with an option of their own."""


def options(values: Mapping[str, Any], origins: Mapping[str, str]) -> list[str]:
    """The words that have set what was set on the command line: `--drive`, `pmsm_foc.fmu`, `--set`, `seed=3`.

    Args:
        values: of the experiment, as they are recorded.
        origins: by dotted key.
    """
    words: list[str] = []
    stated, whole = dict(flatten(values)), set()
    for key, option in OPTION_KEYS.items():
        if origins.get(key) == COMMAND_LINE and key in stated:
            words += [option, str(stated[key])]
            whole.add(key)
    for key, value in stated.items():
        if origins.get(key) == COMMAND_LINE and key not in whole and not key.startswith("fault."):
            words += ["--set", f"{key}={_toml(value)}"]
    if any(origin == COMMAND_LINE for key, origin in origins.items() if key.startswith("fault.")):
        words += ["--set", f"fault={_toml(values.get('fault', ()))}"]
    return words


def run_words(
    experiment: str | Path, settings: Iterable[str] = (), drive: str | None = None, body: str | None = None
) -> tuple[str, ...]:
    """Return the words behind `twin run` that run `experiment`; arguments as of `load_experiment`."""
    given = [("--drive", drive), ("--body", body), *(("--set", text) for text in settings)]
    return (str(experiment), *(word for option, value in given if value is not None for word in (option, value)))


def repeating_words(summary: Mapping[str, Any], name: str, words: Sequence[str]) -> list[str]:
    """Return the words behind `twin run` that repeat a stored run.

    A recording names files without their folders, so only the summary beside it has paths as they were typed.

    Args:
        summary: read beside the recording; it may come from anybody.
        name: of the experiment, and `words`: its `options`, as recorded; used where the summary has no such words.
    """
    typed = summary.get("typed")
    if not isinstance(typed, list) or not typed or not all(isinstance(word, str) for word in typed):
        return [name, *words]
    # a summary that was forged adds no other option to a command that is copied into a shell
    plain = not typed[0].startswith("-") and {"--drive", "--body", "--set"}.issuperset(typed[1::2])
    return typed if plain and len(typed) % 2 else [name, *words]


def run_command(words: Iterable[str]) -> str:
    """Return the command `twin run` with `words`, for a shell."""
    return shlex.join(["twin", "run", *words])


def _toml(value: object) -> str:
    """A value as --set takes it."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key} = {_toml(item)}" for key, item in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_toml(item) for item in value) + "]"
    return toml_value(value)
