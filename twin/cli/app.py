"""The command `twin` and its subcommands, generated from studies that are imported on use."""

import inspect
import os
import types
import typing
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from importlib import import_module
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any

import click

from twin import __version__
from twin.cli.catalogue import COMMAND_GROUPS, HELP_SECTIONS, CommandText, command_texts
from twin.cli.completions import COMPLETION_FUNCTIONS
from twin.cli.withdrawn import withdrawn_options
from twin.kernel.errors import InputRefused
from twin.studies.command import SHARED_OPTIONS, Argument, Isolation, Option

COMPLETE_VARIABLE = "_TWIN_COMPLETE"
"""Environment variable of the completion protocol between shell and program."""
MAX_HELP_LENGTH = 1000
"""Maximum length of a command's first sentence in a list (characters)."""
CONTEXT_SETTINGS = {"show_default": True}
PAIR_OPTIONS = ("--lengths-mm", "--masses-g")
"""Options that take any number of `name=value` words after them."""
_ABOUT_TEXT = """Digital twin of a delta-like massage robot with motor drives as FMUs.

Start with: twin run experiments/fig4_force_position.toml
"""


class StudyCommand(click.Command):
    """A command of the terminal whose study is imported on use, as importing all studies would take long."""

    def __init__(self, words: str, text: CommandText):
        super().__init__(words.split()[-1], help=text.help, context_settings=CONTEXT_SETTINGS)
        self._words, self._text = words, text

    @cached_property
    def function(self) -> Callable[..., Any]:
        found: Callable[..., Any] = getattr(import_module(self._text.module), self._text.function)
        return found

    def make_context(self, *args: Any, **extra: Any) -> click.Context:
        self.params = self.params or [*parameters(self.function), *withdrawn_options(self._words)]
        return super().make_context(*args, **extra)

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        try:
            return super().parse_args(ctx, current_spelling(args))
        except click.UsageError as mistake:
            mistake.ctx = mistake.ctx or ctx
            raise

    def invoke(self, ctx: click.Context) -> None:
        from twin.cli.ask import ask

        ask(self.function, ctx.params)


def parameters(function: Callable[..., Any]) -> list[click.Parameter]:
    """Return a study's command-line arguments and options, including the shared ones."""
    own = inspect.signature(function).parameters
    options = {key: (found.annotation, found.default) for key, found in own.items() if key not in ("say", "reporter")}
    options |= {key: SHARED_OPTIONS[key] for key in vars(function)["study"].shared_options() if key not in own}
    return [_parameter(key, *option) for key, option in options.items()]


def _parameter(name: str, annotation: Any, default: Any) -> click.Parameter:
    """Convert an argument of a study function to a parameter of click, the command-line library."""
    if typing.get_origin(annotation) is not Annotated:
        raise TypeError(f"{name}: expected Annotated[TYPE, Option(...)]")
    kind, option = typing.get_args(annotation)[:2]
    if typing.get_origin(kind) in (types.UnionType, typing.Union):
        kind, _ = typing.get_args(kind)
    several = typing.get_origin(kind) is Sequence
    if several:
        (kind,) = typing.get_args(kind)
    settings: dict[str, Any] = {"help": option.help, "metavar": option.metavar, "type": _value_type(kind, option)}
    settings["required"] = default is inspect.Parameter.empty
    if not settings["required"] and default is not None:
        settings["default"] = default
    if complete := COMPLETION_FUNCTIONS.get(option.complete):
        settings["shell_complete"] = lambda ctx, param, incomplete: complete(incomplete)
    if not isinstance(option, Argument):
        flags = (option.flags or f"--{name.replace('_', '-')}").split()
        # with is_flag=False click would refuse an option whose value is optional
        flag: dict[str, Any] = {"is_flag": True} if kind is bool else {}
        return click.Option([name, *flags], multiple=several, **flag, **settings)
    if settings.get("default", ()) != ():
        settings["help"] += f"  [default: {default}]"
    return click.Argument([name], nargs=-1 if several else 1, **settings)


def _value_type(kind: Any, option: Option) -> Any:
    if typing.get_origin(kind) is typing.Literal:
        return click.Choice(typing.get_args(kind))
    if kind is Path:
        return click.Path(path_type=Path, readable=False)
    bounds: dict[str, Any] = {"min": option.least, "max": option.most}
    if bounds == {"min": None, "max": None}:
        return {int: _Integer(), float: _Number()}.get(kind, kind)
    return _IntegerRange(**bounds) if kind is int else _NumberRange(**bounds)


class _PlainNumber(click.ParamType):
    """A click parameter type for numbers; click's own accept NaN, `1_000` and digits of all scripts."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        # exact units take a while to load, and help needs none
        from twin.kernel.units import parse_float

        number = parse_float(value) if isinstance(value, str) else value
        if number is None or number != number:
            self.fail(f"{value!r} is not a valid {self.name}.", param, ctx)
        return super().convert(value, param, ctx)


class _Integer(_PlainNumber, click.types.IntParamType):
    name = "integer"


class _Number(_PlainNumber, click.types.FloatParamType):
    name = "number"


class _IntegerRange(_PlainNumber, click.IntRange):
    name = "integer"


class _NumberRange(_PlainNumber, click.FloatRange):
    name = "number"


class CommandList(click.Group):
    """A group of commands whose help lists them by `sections`, each with its complete first sentence.

    The group of all commands is called ""; a command line that names no command gets `default`.
    """

    def __init__(
        self,
        name: str,
        commands: dict[str, click.Command],
        text: str,
        sections: Mapping[str, Sequence[str]],
        default: str = "",
    ):
        super().__init__(name or None, commands, help=text, params=withdrawn_options(name))
        self._sections, self._default = sections, default

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        if not args and not ctx.resilient_parsing:
            print(ctx.get_help())
            ctx.exit(InputRefused.exit_code)
        own = not args or args[0] in self.commands or args[0] == "--help"
        return super().parse_args(ctx, args if own or not self._default else [self._default, *args])

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(self.commands)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        width = max(map(len, self.commands))
        for heading, names in self._sections.items():
            with formatter.section(heading):
                formatter.write_dl(
                    [(name.ljust(width), self.commands[name].get_short_help_str(MAX_HELP_LENGTH)) for name in names]
                )


def twin_command() -> CommandList:
    """Build the command-line program `twin` with all declared commands; commands without a section come last."""
    commands: dict[str, click.Command] = {}
    groups: dict[str, dict[str, click.Command]] = {}
    for words, text in command_texts().items():
        first, *rest = words.split()
        (groups.setdefault(first, {}) if rest else commands)[words.split()[-1]] = StudyCommand(words, text)
    for first, group in groups.items():
        found = COMMAND_GROUPS[first]
        commands[first] = CommandList(first, group, found.help, {"Commands": [*group]}, found.default)
    sections = {heading: [name for name in names if name in commands] for heading, names in HELP_SECTIONS.items()}
    sections["Others"] = sorted(commands.keys() - {name for names in sections.values() for name in names})
    ordered = {name: commands[name] for names in sections.values() for name in names}
    twin = CommandList("", ordered, _ABOUT_TEXT, {heading: names for heading, names in sections.items() if names})
    show = click.version_option(__version__, message="twin %(version)s", help="Print the version and exit.")
    return show(twin)


def run_command_line(words: list[str]) -> int:
    """Run the command line `words` and return its exit code; InputRefused if it is invalid."""
    twin = twin_command()
    if wanted := os.environ.get(COMPLETE_VARIABLE):
        from click.shell_completion import shell_complete

        return shell_complete(twin, {}, "twin", COMPLETE_VARIABLE, wanted)
    # imported here: listing the commands does not need it
    from twin.studies.stale_files import remove_stale_folders

    remove_stale_folders()
    try:
        with twin.make_context("twin", words) as context:
            twin.invoke(context)
    except click.exceptions.Exit as end:
        return end.exit_code
    except click.UsageError as mistake:
        raise InputRefused(_usage_message(mistake)) from None
    return 0


def current_spelling(words: list[str]) -> list[str]:
    """Translate spellings of command-line options that click does not know.

    These are --isolate without a value, --no-isolate, --realtime, whose next word click would read as its value, and
    `PAIR_OPTIONS` with several words, where click accepts a single word.
    """
    spelt, values = {"--no-isolate": "--isolate=none", "--realtime": "--realtime=1"}, typing.get_args(Isolation)
    found: list[str] = []
    option = ""
    for word, following in pairwise([*words, ""]):
        if word.startswith("-") or "=" not in word:
            option = word if word in PAIR_OPTIONS else ""
        elif option:
            found[-1:] = [] if found[-1] == option else found[-1:]
            found.append(f"{option}={word}")
            continue
        found.append("--isolate=run" if word == "--isolate" and following not in values else spelt.get(word, word))
    return found


def _usage_message(mistake: click.UsageError) -> str:
    """Return the error message for an invalid command line: command, error, and a suggestion or the help to read."""
    text, context = mistake.format_message().strip(), mistake.ctx
    if context is None:
        return text
    text = text.replace(". Did you mean", "; did you mean").replace(". (Did you mean one of:", "; did you mean one of")
    text = f"{context.command_path}: {text[0].lower()}{text[1:].replace('?)', '?').rstrip('.')}"
    return text if text.endswith("?") else f"{text}; see {context.command_path} --help"
