"""Command lines that start a run, or repeat a stored run."""

import shlex
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from twin.robot.experiment.differences import flatten
from twin.robot.experiment.source import COMMAND_LINE, toml_value

OPTION_KEYS = {"drive.fmu": "--drive", "contact.body": "--body"}
"""Keys with a command-line option of their own."""


def options(values: Mapping[str, Any], origins: Mapping[str, str]) -> list[str]:
    """Return the command-line options that set recorded values: `--drive`, `pmsm_foc.fmu`, `--set`, `seed=3`."""
    words: list[str] = []
    stated, whole = dict(flatten(values)), set()
    for key, option in OPTION_KEYS.items():
        if origins.get(key) == COMMAND_LINE and key in stated:
            words += [option, str(stated[key])]
            whole.add(key)
    for key, value in stated.items():
        if origins.get(key) == COMMAND_LINE and key not in whole and not key.startswith("fault."):
            words += ["--set", f"{key}={toml_value(value)}"]
    if any(origin == COMMAND_LINE for key, origin in origins.items() if key.startswith("fault.")):
        words += ["--set", f"fault={toml_value(values.get('fault', ()))}"]
    return words


def run_words(
    experiment: str | Path, settings: Iterable[str] = (), drive: str | None = None, body: str | None = None
) -> tuple[str, ...]:
    """Return the arguments of `twin run` that run an experiment as it was loaded."""
    given = [("--drive", drive), ("--body", body), *(("--set", text) for text in settings)]
    return (str(experiment), *(word for option, value in given if value is not None for word in (option, value)))


def repeating_words(summary: Mapping[str, Any], name: str, words: Sequence[str]) -> list[str]:
    """Return the arguments of `twin run` that repeat a stored run, from its summary (untrusted input) and recording.

    A recording names files without their folders; only the summary beside it has the paths as typed. A summary without
    typed words is replaced by the recorded `name` and the recorded option `words`.
    """
    typed = summary.get("typed")
    if not isinstance(typed, list) or not typed or not all(isinstance(word, str) for word in typed):
        return [name, *words]
    # users copy the command into a shell, so a forged summary must not add other options
    plain = not typed[0].startswith("-") and {"--drive", "--body", "--set"}.issuperset(typed[1::2])
    return typed if plain and len(typed) % 2 else [name, *words]


def run_command(words: Iterable[str]) -> str:
    """Return the shell command `twin run` with the given arguments, quoted where necessary."""
    return shlex.join(["twin", "run", *words])
