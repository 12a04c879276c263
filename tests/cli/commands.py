"""Every command of twin, found in the application itself."""

import inspect
from collections.abc import Iterator
from typing import Any

from twin.cli.app import twin_command

EXAMPLE = "Example: "


def commands(group: Any = None, path: tuple[str, ...] = ()) -> Iterator[tuple[str, Any]]:
    """(words, command) of every command that is no group."""
    group = group or twin_command()
    for name, command in group.commands.items():
        if hasattr(command, "commands"):
            yield from commands(command, (*path, name))
        else:
            yield " ".join((*path, name)), command


def paragraphs(command: Any) -> list[str]:
    """The command's help as it is written."""
    return inspect.cleandoc(command.help or "").split("\n\n")


COMMANDS = dict(commands())
EXAMPLES = {words: paragraphs(command)[-1] for words, command in COMMANDS.items()}
