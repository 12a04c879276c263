"""Commands that are imported when they are asked for: to import all takes longer than most of them."""

import re
from collections.abc import Iterator, Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

import typer
from typer.core import TyperCommand

from twin.cli.group import Group
from twin.cli.study_files import study_file, study_names

DOCSTRING = re.compile(r'\) -> \w+:\n    """(.*?)"""', re.DOTALL)


class Modules(Mapping[str, Any]):
    """Commands by name: `names` in this order, then all other studies. What is no study is a module beside this one.

    The module has a function of the command's name, and `Command` if that is of a class of its own; or the group `app`,
    whose callback has the group's name.
    """

    def __init__(self, names: tuple[str, ...]):
        self._names = names
        self._made: dict[str, Any] = {}

    def __getitem__(self, name: str) -> Any:
        if name not in self._names and not study_file(name):
            raise KeyError(name)
        if name not in self._made:
            self._made[name] = _command(name)
        return self._made[name]

    def __iter__(self) -> Iterator[str]:
        yield from dict.fromkeys([*self._names, *study_names()])

    def __len__(self) -> int:
        return len(list(iter(self)))


class LazyGroup(Group):
    """A group of `NAMES` and of studies, which are listed without being imported."""

    NAMES: tuple[str, ...] = ()

    def __init__(self, **attributes: Any):
        super().__init__(**attributes | {"commands": Modules(self.NAMES)})

    def list_commands(self, ctx: Any) -> list[str]:
        return list(self.commands)

    def listed(self, name: str) -> Any:
        source = (study_file(name) or Path(__file__).with_name(f"{name}.py")).read_text("utf-8")
        _, _, command = source.partition(f"\ndef {name}(")
        said = DOCSTRING.search(command)
        return TyperCommand(name, help=said[1]) if said else super().listed(name)


def _command(name: str) -> Any:
    """As Typer makes it of the module."""
    holder = typer.Typer(add_completion=False, rich_markup_mode=None)
    # with a callback it is a group, even of one command
    holder.callback()(lambda: None)
    if study_file(name):
        from twin.cli.studies import study_command

        holder.command(name)(study_command(name))
        return typer.main.get_command(holder).commands[name]  # type: ignore[attr-defined]
    module = import_module(f"twin.cli.{name}")
    if hasattr(module, "app"):
        holder.add_typer(module.app, name=name)
    else:
        holder.command(name, cls=getattr(module, "Command", None))(getattr(module, name))
    made: Any = typer.main.get_command(holder)
    return made.commands[name]
