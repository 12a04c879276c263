"""Options that earlier versions had: each is refused with what to type in its place."""

from typing import Any

import click

from twin.kernel.errors import InputRefused

_COMPLETION_REMEDY = (
    'for bash put eval "$(_TWIN_COMPLETE=bash_source twin)" into ~/.bashrc, for zsh the same with zsh_source into '
    "~/.zshrc, for fish type _TWIN_COMPLETE=fish_source twin > ~/.config/fish/completions/twin.fish"
)
WITHDRAWN_OPTIONS = {
    ("", "--install-completion"): _COMPLETION_REMEDY,
    ("", "--show-completion"): _COMPLETION_REMEDY,
    ("branch", "--drive"): "type twin run EXPERIMENT --drive FMU, a run with it from the start",
    ("cosim", "--remote"): "leave it out; all FMUs of a system run on this machine",
    ("cosim", "--tolerance"): "type --tick-ms MS, a step that is short enough",
}
"""(Command, option) -> what to type in its place; no command: of `twin` itself."""


def withdrawn_options(command: str) -> list[click.Parameter]:
    """Hidden options that refuse to be used, of `command`."""
    return [_refusing_option(option, instead) for (of, option), instead in WITHDRAWN_OPTIONS.items() if of == command]


def _refusing_option(option: str, instead: str) -> click.Option:
    def refuse(context: click.Context, _: click.Parameter, given: Any) -> None:
        if given is None or context.resilient_parsing:
            return
        raise InputRefused(f"{context.command_path}: {option} is no longer an option; {instead}")

    # with a value or without one, before anything else that may be amiss
    return click.Option(
        [option], is_flag=False, flag_value="", hidden=True, expose_value=False, is_eager=True, callback=refuse
    )
