"""The command line in this process: as a user types it, without the second that a process takes to start."""

import io
import os
import sys
import traceback
from contextlib import chdir, redirect_stderr, redirect_stdout
from pathlib import Path
from typing import NamedTuple
from unittest.mock import patch

from twin.cli import main


class Done(NamedTuple):
    """What a command left behind; `code` is None if it ended with a traceback, which `err` ends with then."""

    code: int | None
    out: str
    err: str


def run(*arguments: object, cwd: Path) -> Done:
    """What `twin ARGUMENTS...` does in the folder `cwd`.

    Commands that load FMUs or step them are given --isolate none by whoever wants all of it to happen here.
    """
    out, err, code = io.StringIO(), io.StringIO(), None
    typed = patch.object(sys, "argv", ["twin", *map(str, arguments)])
    with typed, patch.dict(os.environ), chdir(cwd), redirect_stdout(out), redirect_stderr(err):
        try:
            main()
        except SystemExit as end:
            code = end.code if isinstance(end.code, int) else 0
        except BaseException:
            traceback.print_exc()
    return Done(code, out.getvalue(), err.getvalue())
