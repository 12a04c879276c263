"""What was typed behind the name of an experiment, out of what a recording says of it."""

from collections.abc import Mapping
from typing import Any

from twin.experiment.recorded import flat
from twin.experiment.source import COMMAND_LINE, toml_value

WHOLE = {"drive.fmu": "--drive", "contact.body": "--body"}
"""Keys with an option of their own."""


def options(values: Mapping[str, Any], origins: Mapping[str, str]) -> list[str]:
    """The words that have set what was set on the command line: `--drive`, `pmsm_foc.fmu`, `--set`, `seed=3`.

    Args:
        values: of the experiment, as they are recorded.
        origins: by dotted key.
    """
    words: list[str] = []
    said, whole = dict(flat(values)), set()
    for key, option in WHOLE.items():
        if origins.get(key) == COMMAND_LINE and key in said:
            words += [option, str(said[key])]
            whole.add(key)
    for key, value in said.items():
        if origins.get(key) == COMMAND_LINE and key not in whole and not key.startswith("fault."):
            words += ["--set", f"{key}={_toml(value)}"]
    if any(origin == COMMAND_LINE for key, origin in origins.items() if key.startswith("fault.")):
        words += ["--set", f"fault={_toml(values.get('fault', ()))}"]
    return words


def _toml(value: object) -> str:
    """A value as --set takes it."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key} = {_toml(item)}" for key, item in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_toml(item) for item in value) + "]"
    return toml_value(value)
