"""A case: one thing that is done in both trees."""

from dataclasses import dataclass, field
from typing import Any

FIG4 = "fig4_force_position"
FIG4_SHORT = "duration_s=8"
"""Its force control begins at 5.6 s."""


@dataclass(frozen=True)
class Case:
    """One thing to do in both trees.

    Attributes:
        name: by which it is chosen and reported.
        quick: whether it is done with QUICK=1, too.
        files: that lie in its folder, text by name; TREE stands for the tree, there and in commands.
        load: what `twin.load` is called with, to run it; or
        commands: command lines without their first word `twin`, done one after the other in its folder; one that
            begins with `python` is run by the interpreter.
        page: words of `twin explore` after that, and what a page asks of it, one request after the other.
        environment: variables that they find.
    """

    name: str
    quick: bool = False
    files: dict[str, str] = field(default_factory=dict)
    load: tuple[str, tuple[str, ...], str | None, str | None] | None = None
    commands: tuple[str, ...] = ()
    page: tuple[str, tuple[dict[str, Any], ...]] | None = None
    environment: dict[str, str] = field(default_factory=dict)
