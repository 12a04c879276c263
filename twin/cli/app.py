"""The command `twin`: its subcommands, generated from studies and listed without importing them, and its errors.

Shell completion runs at every TAB: nothing of it imports more than TOML files need.
"""

import inspect
import os
import re
import typing
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import cached_property
from importlib import import_module
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import typer
from typer.core import TyperArgument, TyperCommand, TyperGroup

from twin import __version__
from twin.cli.withdrawn import refuse_withdrawn
from twin.kernel.errors import InputRefused
from twin.robot.places import located
from twin.studies.command import SHARED, Argument, Isolation, Option


def experiment_files(incomplete: str) -> list[str]:
    """Experiments of this folder and of experiments/; by name, those that come with twin."""
    files = [*Path().glob("*.toml"), *Path("experiments").glob("*.toml")]
    return _starting_with(incomplete, map(str, files)) or experiment_names(incomplete)


def experiment_names(incomplete: str) -> list[str]:
    """Experiments that come with twin, without folder and suffix."""
    from twin.robot.experiment.drive_files import known_experiments

    return _starting_with(incomplete, known_experiments())


def drive_names(incomplete: str) -> list[str]:
    """Drives of fmus/."""
    shelf = located("fmus", Path.cwd())
    fmus = [*shelf.glob("*/*.fmu"), *shelf.glob("*/mapping.toml")]
    return _starting_with(incomplete, {fmu.parent.name for fmu in fmus})


def role_names(incomplete: str) -> list[str]:
    """Parts of the robot that may be third-party."""
    from twin.robot.experiment.source import RETAINED

    return _starting_with(incomplete, RETAINED)


def body_names(incomplete: str) -> list[str]:
    """Bodies of bodies/ and experiments/bodies/."""
    from twin.robot.experiment.drive_files import FOLDERS

    bodies = {body.stem for folder in FOLDERS for body in located(folder, Path.cwd()).glob("*.toml")}
    return _starting_with(incomplete, bodies)


def setting_keys(incomplete: str) -> list[str]:
    """Keys that the experiments on the line, or what they extend, already set."""
    from twin.robot.experiment.source import read_source

    keys: set[str] = set()
    # the parser gives up on the whole line while an option lacks its value; the line itself is what shells hand over
    for word in f"{os.environ.get('COMP_WORDS', '')} {os.environ.get('_TYPER_COMPLETE_ARGS', '')}".split():
        try:
            keys |= read_source(Path(word)).origins.keys() if word.endswith(".toml") else set()
        # a line that is still being typed holds no mistake yet
        except InputRefused:
            continue
    return _starting_with(incomplete, (f"{key}=" for key in keys))


def _starting_with(incomplete: str, words: Iterable[str]) -> list[str]:
    return sorted(word for word in words if word.startswith(incomplete))


FOLDERS = {"twin.studies": Path(__file__).parents[1] / "studies", "twin.cli": Path(__file__).parent}
"""Packages whose files hold commands, and the `study.py` of their folders."""
DECLARED = re.compile(r'^@study\((?:"([^"]*)")?.*?^def (\w+)\(.*?"""(.*?)"""', re.DOTALL | re.MULTILINE)
COMPLETIONS = {
    "experiment": experiment_files,
    "experiment name": experiment_names,
    "drive": drive_names,
    "body": body_names,
    "setting": setting_keys,
    "role": role_names,
}
WHOLE = 1000
"""Most letters of a command's first sentence; Typer would cut it to what is left of a line."""


class CommandText(NamedTuple):
    """A command as the text of its file has it: module, function, and the function's docstring."""

    module: str
    function: str
    help: str


def declared() -> dict[str, CommandText]:
    """All commands by their words, such as `drive check`; nothing is imported."""
    found = {}
    for package, folder in FOLDERS.items():
        for file in sorted([*folder.glob("*/study.py"), *folder.glob("*.py")]):
            module = ".".join([package, *file.relative_to(folder).with_suffix("").parts])
            for words, function, settings in DECLARED.findall(file.read_text("utf-8")):
                found[words or function] = CommandText(module, function, settings)
    return found


class Group(NamedTuple):
    """Commands of two words that begin with the same one: their help, and which is meant where none is named."""

    help: str
    default: str = ""


class Commands(TyperGroup):
    """Commands that are imported when they are asked for: to import all takes longer than most of them.

    Their help is plain text: drawn by rich it would take as long again as all else that it needs. They are listed with
    their whole first sentences, also where none is named.

    Args:
        first: the word that all begin with, of a group.
        default: the command that is meant where none is named.
        attributes: Typer's.

    Attributes:
        ORDER: names that are listed first; others follow by the alphabet, or in a group as they are declared.
        GROUPS: what is said of groups, by name.
    """

    ORDER: tuple[str, ...] = ()
    GROUPS: Mapping[str, Group] = {}

    def __init__(self, first: str = "", default: str = "", **attributes: Any):
        super().__init__(**attributes | {"commands": _Imported(self)})
        self._first, self._default = f"{first} " if first else "", default

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        if not args and not ctx.resilient_parsing:
            print(ctx.get_help())
            ctx.exit(InputRefused.exit_code)
        own = not args or args[0] in self.commands or args[0] == "--help" or args[0].startswith("--show-completion")
        return super().parse_args(ctx, args if own or not self._default else [self._default, *args])

    def list_commands(self, ctx: Any) -> list[str]:
        names = [words.removeprefix(self._first).split()[0] for words in self.declared]
        return list(dict.fromkeys([*self.ORDER, *(names if self._first else sorted(names))]))

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        rows = [(name, self.listed(name).get_short_help_str(WHOLE)) for name in self.list_commands(ctx)]
        with formatter.section("Commands"):
            formatter.write_dl(rows)

    def listed(self, name: str) -> Any:
        """The command `name` as far as a list needs it."""
        one = self.GROUPS.get(name) or self.declared[self._first + name]
        return TyperCommand(name, help=one.help)

    def made(self, name: str) -> Any:
        """The command `name`.

        Raises:
            KeyError: there is none.
        """
        if group := self.GROUPS.get(name):
            return Commands(name, group.default, name=name, help=group.help, rich_markup_mode=None)
        holder = typer.Typer(add_completion=False, rich_markup_mode=None)
        # with a callback it is a group, even of one command
        holder.callback()(lambda: None)
        holder.command(name)(asking(self.declared[self._first + name]))
        made: Any = typer.main.get_command(holder)
        for parameter in made.commands[name].params:
            if isinstance(parameter, TyperArgument):
                # the help describes it; a Python type such as list[Path] says nothing to its reader
                parameter.display_type_rich = lambda ctx: None  # type: ignore[method-assign]
        return made.commands[name]

    @cached_property
    def declared(self) -> dict[str, CommandText]:
        """Those of this group, by all of their words."""
        return {words: one for words, one in declared().items() if words.startswith(self._first)}


class _Imported(Mapping[str, Any]):
    """The commands of a group by name, each made when it is asked for."""

    def __init__(self, group: Commands):
        self._group = group
        self._made: dict[str, Any] = {}

    def __getitem__(self, name: str) -> Any:
        if name not in self._made:
            self._made[name] = self._group.made(name)
        return self._made[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._group.list_commands(None))

    def __len__(self) -> int:
        return len(self._group.list_commands(None))


def asking(one: CommandText) -> Callable[..., None]:
    """What Typer makes a command of: a function with the options of a study, which asks it."""
    function = getattr(import_module(one.module), one.function)
    own, marked = inspect.signature(function).parameters, vars(function)["study"]
    options = {key: (found.annotation, found.default) for key, found in own.items() if key not in ("say", "reporter")}
    options |= {key: SHARED[key] for key in marked.shared() if key not in own}

    def command(**given: Any) -> None:
        from twin.cli.ask import ask

        ask(function, {key: () if value is None and key in lists else value for key, value in given.items()})

    parameters = [_parameter(key, *option) for key, option in options.items()]
    lists = {key for key, (annotation, _) in options.items() if _is_list(annotation)}
    command.__doc__, _, _ = inspect.cleandoc(function.__doc__ or "").partition("\n\nRaises:")
    command.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    # Typer takes them from here
    command.__annotations__ = {found.name: found.annotation for found in parameters}
    return command


def _is_list(annotation: Any) -> bool:
    return typing.get_origin(typing.get_args(annotation)[0]) is Sequence


def _parameter(name: str, annotation: Any, default: Any) -> inspect.Parameter:
    """An argument of a study as Typer reads it."""
    if typing.get_origin(annotation) is not Annotated:
        raise TypeError(f"{name}: expected Annotated[TYPE, Option(...)]")
    kind, option = typing.get_args(annotation)[:2]
    if _is_list(annotation):
        kind = list[typing.get_args(kind)[0]]  # type: ignore[misc]
        kind, default = (kind | None, None) if default == () else (kind, default)
    # without a name of its own Typer adds one that says no
    settings = typer_option(option, f"--{name.replace('_', '-')}" if kind is bool else "")
    return inspect.Parameter(
        name, inspect.Parameter.KEYWORD_ONLY, annotation=Annotated[kind, settings], default=default
    )


def typer_option(option: Option, flags: str = "") -> Any:
    """`option` as Typer has it; `flags` where it has none of its own and Typer's would not do."""
    settings: dict[str, Any] = {"help": option.help, "metavar": option.metavar, "min": option.least, "max": option.most}
    settings["autocompletion"] = COMPLETIONS.get(option.complete)
    if isinstance(option, Argument):
        return typer.Argument(**settings)
    return typer.Option(*(option.flags or flags).split(), **settings)


class TwinCommands(Commands):
    """All of them, in the order of the help."""

    ORDER = (
        "run",
        "branch",
        "compare",
        "check",
        "faults",
        "falsify",
        "safety",
        "runs",
        "report",
        "explore",
        "replay",
        "shadow",
        "converge",
        "accuracy",
        "identify",
        "export",
        "build",
        "cosim",
        "analyse",
        "tune",
        "init",
        "schema",
        "doctor",
        "sweep",
        "drive",
        "component",
        "log",
    )
    GROUPS: Mapping[str, Group] = {
        "sweep": Group(
            "Run one experiment many times: twin sweep SWEEP, or twin sweep run SWEEP.\n\n"
            "Options: twin sweep run --help.\n\n"
            "Example: twin sweep experiments/sweeps/stiffness_and_gain.toml --dry-run",
            default="run",
        ),
        "drive": Group("Look at drive FMUs, qualify, compare and bring them in."),
        "component": Group("Look at and check third-party parts of the robot."),
        "log": Group("Bring in the log of a robot: which column is which signal."),
    }


app = typer.Typer(name="twin", cls=TwinCommands, pretty_exceptions_enable=False, rich_markup_mode=None)


def _print_version(wanted: bool) -> None:
    if wanted:
        print(f"twin {__version__}")
        raise typer.Exit()


@app.callback()
def twin(
    version: Annotated[
        bool, typer.Option("--version", is_eager=True, callback=_print_version, help="Print the version and exit.")
    ] = False,
) -> None:
    """Digital twin of a delta-like massage robot with motor drives as FMUs.

    Start with: twin run experiments/fig4_force_position.toml
    """


def carried_out(words: list[str]) -> Any:
    """Exit code of the command line `words`.

    Raises:
        InputRefused: a mistake in it, in one sentence.
    """
    # not needed to know what commands there are
    from twin.studies.left_behind import clear

    clear()
    refuse_withdrawn(words)
    try:
        return app(as_spelt_now(words), prog_name="twin", standalone_mode=False)
    except typer.TyperException as mistake:
        raise InputRefused(_sentence(mistake)) from None


def as_spelt_now(words: list[str]) -> list[str]:
    """A command line with --isolate and --no-isolate, as some commands called them, in today's spelling; and with
    --realtime as --realtime=1, because Typer knows no options whose value may be left out."""
    spelt, values = {"--no-isolate": "--isolate=none", "--realtime": "--realtime=1"}, typing.get_args(Isolation)
    return [
        "--isolate=run" if word == "--isolate" and following not in values else spelt.get(word, word)
        for word, following in pairwise([*words, ""])
    ]


def _sentence(mistake: typer.TyperException) -> str:
    """A mistake in the command line: where, what, and what is meant or where help is; "" if the help was shown."""
    text = mistake.format_message().strip()
    context = getattr(mistake, "ctx", None)
    if not text or context is None:
        return text
    text = f"{context.command_path}: {text[0].lower()}{text[1:].rstrip('.')}".replace(". Did you", "; did you")
    return text if text.endswith("?") else f"{text}; see {context.command_path} --help"
