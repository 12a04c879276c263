"""Commands made of studies: their options, and how they are asked."""

import inspect
import typing
from collections.abc import Callable, Sequence
from functools import partial
from importlib import import_module
from typing import Annotated, Any

from twin.cli.ask import ask
from twin.cli.options import JOB_ISOLATION, AsJson, Columns, Formats, Isolate, JobIsolation, typer_option
from twin.cli.study_files import FOLDER, study_file
from twin.errors import ComponentFailed
from twin.studies.command import Study


def study_command(name: str) -> Callable[..., None]:
    """What Typer makes the command `name` of: a function with the options of the study, which asks it."""
    file = study_file(name)
    assert file is not None
    inside = ".".join(file.relative_to(FOLDER).with_suffix("").parts)
    module = f"twin.studies.{inside}"
    function = getattr(import_module(module), name)
    marked: Study = function.study

    def command(**given: Any) -> None:
        shown = {key: given.pop(key) for key in ("as_json", "isolate", "formats", "columns") if key in extras}
        asked = {key: () if value is None and key in lists else value for key, value in given.items()}
        for look in marked.before:
            look(asked)
        try:
            ask(f"{module}:{name}", asked, **{"isolate": JobIsolation.NONE, **shown})
        except ComponentFailed as failure:
            more = marked.on_failure(asked) if marked.on_failure else ""
            raise ComponentFailed("\n".join(filter(None, [str(failure), more]))) from None

    own = list(inspect.signature(function, eval_str=True).parameters.values())
    parameters = [_parameter(one) for one in own if one.name != "say"]
    lists = {one.name for one in own if _is_list(one.annotation)}
    extras = _extras(marked)
    command.__name__, command.__doc__ = name, _help(function)
    signature = inspect.Signature([*parameters, *extras.values()])
    command.__signature__ = signature  # type: ignore[attr-defined]
    # Typer takes them from here
    command.__annotations__ = {key: one.annotation for key, one in signature.parameters.items()}
    return command


def _extras(marked: Study) -> dict[str, inspect.Parameter]:
    """Options that a study has without saying so."""
    extra = partial(inspect.Parameter, kind=inspect.Parameter.KEYWORD_ONLY)
    found = [extra("as_json", annotation=AsJson, default=False)]
    if marked.draws:
        found[:0] = [
            extra("formats", annotation=Formats, default=None),
            extra("columns", annotation=Columns, default=2),
        ]
    if marked.isolated:
        found.append(extra("isolate", annotation=Isolate, default=JOB_ISOLATION))
    return {one.name: one for one in found}


def _is_list(annotation: Any) -> bool:
    kind = typing.get_args(annotation)[0] if typing.get_origin(annotation) is Annotated else annotation
    return typing.get_origin(kind) is Sequence


def _parameter(own: inspect.Parameter) -> inspect.Parameter:
    """An argument of a study as Typer reads it."""
    if typing.get_origin(own.annotation) is not Annotated:
        raise TypeError(f"{own.name}: expected Annotated[TYPE, Option(...)]")
    kind, option = typing.get_args(own.annotation)[:2]
    default = None if own.default == () else own.default
    if _is_list(own.annotation):
        kind = list[typing.get_args(kind)[0]] | None  # type: ignore[misc]
    # without a name of its own Typer adds one that says no
    flags = f"--{own.name.replace('_', '-')}" if kind is bool else ""
    said = typer_option(option, flags)
    return own.replace(annotation=Annotated[kind, said], default=default, kind=inspect.Parameter.KEYWORD_ONLY)


def _help(function: Callable[..., Any]) -> str:
    """The docstring as far as it is for people who type the command."""
    text, _, _ = inspect.cleandoc(function.__doc__ or "").partition("\n\nRaises:")
    return text
