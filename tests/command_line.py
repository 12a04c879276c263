"""The command line as a user types it, in this process: what it does without the seconds that starting one takes."""

import contextlib
import io
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple
from unittest import mock


class Done(NamedTuple):
    """What a command came to; the names are those of `subprocess.CompletedProcess`."""

    returncode: int
    stdout: str
    stderr: str


def twin(*arguments: object, cwd: Path, env: dict[str, str] | None = None) -> Done:
    """`twin ARGUMENTS` in the folder `cwd`.

    What is not `twin`'s own output, such as what an FMU prints, is not seen here; nor is what happens before `main`.
    """
    from twin.cli import main

    said, told = io.StringIO(), io.StringIO()
    command = ["twin", *map(str, arguments)]
    with (
        contextlib.chdir(cwd),
        mock.patch.object(sys, "argv", command),
        mock.patch.dict(os.environ, env if env is not None else dict(os.environ), clear=True),
        contextlib.redirect_stdout(said),
        contextlib.redirect_stderr(told),
    ):
        code = _exit_code(main)
    return Done(code, said.getvalue(), told.getvalue())


def _exit_code(main: Callable[[], None]) -> int:
    """What the process would end with."""
    try:
        main()
    except SystemExit as end:
        if isinstance(end.code, str):
            print(end.code, file=sys.stderr)
            return 1
        return end.code or 0
    return 0
