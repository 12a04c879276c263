"""An exception that no code foresaw ends a command with 70, never with the 1 that means "outside" to a script."""

import functools
import inspect
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, get_args, get_origin

import pytest

from tests.command_line import twin, twin_process
from twin.cli import ask
from twin.cli.catalogue import command_texts
from twin.studies.command import Argument


class Unforeseen(Exception):
    """What no code catches."""


def _raising(function: Callable[..., Any]) -> Callable[..., Any]:
    """`function` with its arguments and its mark, raising."""

    @functools.wraps(function)
    def one(*args: Any, **kwargs: Any) -> Any:
        raise Unforeseen("nobody foresaw this")

    @functools.wraps(function)
    def several(*args: Any, **kwargs: Any) -> Iterator[Any]:
        raise Unforeseen("nobody foresaw this")
        yield

    raising = several if inspect.isgeneratorfunction(function) else one
    vars(raising)["study"] = replace(vars(function)["study"], before=())
    return raising


def _arguments(function: Callable[..., Any]) -> Iterator[str]:
    """A word for each argument that has to be there."""
    for name, found in inspect.signature(function).parameters.items():
        if found.default is inspect.Parameter.empty and get_origin(found.annotation) is Annotated:
            kind, option = get_args(found.annotation)[:2]
            word = "1" if kind in (int, float) else "x"
            flag = (option.flags.split() or [f"--{name.replace('_', '-')}"])[0]
            yield from [word] if isinstance(option, Argument) else [flag, word]


@pytest.mark.parametrize("words", sorted(command_texts()))
def test_an_exception_in_a_command_ends_it_with_70(words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    one = command_texts()[words]
    module = __import__(one.module, fromlist=[one.function])
    raising = _raising(getattr(module, one.function))
    monkeypatch.setattr(module, one.function, raising)
    done = twin(*words.split(), *_arguments(raising), cwd=tmp_path)
    assert done.returncode == 70, done.stderr
    assert "Unforeseen: nobody foresaw this" in done.stderr and "internal error of twin" in done.stderr.splitlines()[-1]


def blunder(reporter: object, **arguments: object) -> None:
    """A job that raises what nobody foresaw."""
    raise Unforeseen("in another process")


def test_an_exception_in_a_worker_process_ends_the_command_with_70(
    root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(ask, "RECORD_JOB", f"{__name__}:blunder")
    monkeypatch.setattr("twin.studies.command.ANSWER_JOB", f"{__name__}:blunder")
    for words in (["cosim", "x.fmu"], ["drive", "check", "ideal_velocity"]):
        done = twin(*words, cwd=root, isolated=True)
        assert done.returncode == 70, done.stderr
        assert "Unforeseen: in another process" in done.stderr


def test_an_installation_that_cannot_be_imported_is_70(tmp_path: Path):
    (tmp_path / "sitecustomize.py").write_text("import sys\nsys.modules['twin.cli.line'] = None\n")
    done = twin_process("schema", cwd=tmp_path, env={"PYTHONPATH": str(tmp_path), "PATH": "/usr/bin:/bin"})
    assert done.returncode == 70 and "internal error of twin" in done.stderr, done.stderr
