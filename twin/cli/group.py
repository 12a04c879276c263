"""Groups of commands, with help as plain text: drawn by rich it would take as long again as all else that it needs."""

from typing import Any

from typer.core import TyperGroup

from twin.errors import InputRefused

WHOLE = 1000
"""Most letters of a command's first sentence; Typer would cut it to what is left of a line."""


class Group(TyperGroup):
    """Commands that are listed with their whole first sentences, also to whoever names none."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        if not args and not ctx.resilient_parsing:
            print(ctx.get_help())
            ctx.exit(InputRefused.exit_code)
        return super().parse_args(ctx, args)

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        rows = [(name, self.listed(name).get_short_help_str(WHOLE)) for name in self.list_commands(ctx)]
        with formatter.section("Commands"):
            formatter.write_dl(rows)

    def listed(self, name: str) -> Any:
        """The command `name` as far as a list needs it."""
        return self.commands[name]
