"""Commands that are imported when they are asked for: to import all takes longer than most of them."""

from collections.abc import Iterator, Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

import typer
from typer.core import TyperCommand

from twin.cli.group import Group


class Modules(Mapping[str, Any]):
    """The commands `names`, each of the module of this name beside this one.

    The module has a function of the command's name, and `Command` if that is of a class of its own; or the group `app`,
    whose callback has the group's name.
    """

    def __init__(self, names: tuple[str, ...]):
        self._names = names
        self._made: dict[str, Any] = {}

    def __getitem__(self, name: str) -> Any:
        if name not in self._names:
            raise KeyError(name)
        if name not in self._made:
            self._made[name] = _command(name)
        return self._made[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)


class LazyGroup(Group):
    """A group of `NAMES`, which are told of without being imported."""

    NAMES: tuple[str, ...] = ()

    def __init__(self, **attributes: Any):
        super().__init__(**attributes | {"commands": Modules(self.NAMES)})

    def list_commands(self, ctx: Any) -> list[str]:
        return list(self.NAMES)

    def listed(self, name: str) -> Any:
        source = Path(__file__).with_name(f"{name}.py").read_text("utf-8")
        _, _, command = source.partition(f"\ndef {name}(")
        _, _, text = command.partition(') -> None:\n    """')
        said, _, _ = text.partition('"""')
        return TyperCommand(name, help=said) if said else super().listed(name)


def _command(name: str) -> Any:
    """As Typer makes it of the module."""
    module = import_module(f"twin.cli.{name}")
    holder = typer.Typer(add_completion=False, rich_markup_mode=None)
    # with a callback it is a group, even of one command
    holder.callback()(lambda: None)
    if hasattr(module, "app"):
        holder.add_typer(module.app, name=name)
    else:
        holder.command(name, cls=getattr(module, "Command", None))(getattr(module, name))
    made: Any = typer.main.get_command(holder)
    return made.commands[name]
