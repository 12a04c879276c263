"""Removed options of earlier versions, refused with their replacement."""

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
"""(command, option) -> replacement to type; the empty command is `twin` itself."""


def withdrawn_options(command: str) -> list[click.Parameter]:
    """Return hidden options for options that a command no longer has; each refuses to be used."""
    return [_refusing_option(option, instead) for (of, option), instead in WITHDRAWN_OPTIONS.items() if of == command]


def _refusing_option(option: str, instead: str) -> click.Option:
    def refuse(context: click.Context, _: click.Parameter, given: Any) -> None:
        if given is None or context.resilient_parsing:
            return
        raise InputRefused(f"{context.command_path}: {option} is no longer an option; {instead}")

    # eager, with or without a value: refused before any other error is reported
    return click.Option(
        [option], is_flag=False, flag_value="", hidden=True, expose_value=False, is_eager=True, callback=refuse
    )
