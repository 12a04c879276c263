"""The command line as a user types it: in this process, which saves the seconds that starting one takes; or not."""

import contextlib
import importlib
import io
import json
import os
import pickle
import subprocess
import sys
import threading
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple
from unittest import mock

from twin.kernel.process.job import load_function
from twin.kernel.process.reporter import DirectReporter, Listen, Show

GUARDED = (
    "twin.kernel.process.guard.run_guarded",
    "twin.cli.ask.run_guarded",
    "twin.studies.check.job.run_guarded",
    "twin.studies.qualify.qualification.run_guarded",
)
"""Where the commands find the function that runs a job in a process of its own."""

COMPILING = "compiling, once: "
"""What a command begins a line with while it compiles."""

_ONE_JOB = threading.RLock()

# before anything takes the place of that function: they keep what they find under its name
for name in {place.rpartition(".")[0] for place in GUARDED}:
    importlib.import_module(name)


class Done(NamedTuple):
    """What a command came to; the names are those of `subprocess.CompletedProcess`."""

    returncode: int
    stdout: str
    stderr: str


def twin(*arguments: object, cwd: Path, env: Mapping[str, str] | None = None, isolated: bool = False) -> Done:
    """`twin ARGUMENTS` in the folder `cwd`, with `twin.cli.main` called from here.

    What it starts itself, such as the workers of a sweep, it starts. Output that is not its own is not seen, and
    nothing before `main` happens.

    Args:
        env: its environment; None: ours.
        isolated: with the guarded processes that commands run FMUs in; otherwise their jobs run here, too, and a drive
            that crashes takes the tests with it.
    """
    from twin.cli import main

    said, told = io.StringIO(), io.StringIO()
    with contextlib.ExitStack() as stack:
        stack.enter_context(contextlib.chdir(cwd))
        stack.enter_context(mock.patch.object(sys, "argv", ["twin", *map(str, arguments)]))
        stack.enter_context(mock.patch.object(sys, "stdin", io.StringIO()))
        # a command sees to it that Ctrl-C in a finaliser comes again: in the middle of somebody else's test
        for hook in ("unraisablehook", "excepthook"):
            stack.enter_context(mock.patch.object(sys, hook, getattr(sys, hook)))
        stack.enter_context(mock.patch.dict(os.environ, dict(os.environ if env is None else env), clear=True))
        stack.enter_context(contextlib.redirect_stdout(said))
        stack.enter_context(contextlib.redirect_stderr(told))
        if not isolated:
            for place in GUARDED:
                stack.enter_context(mock.patch(place, _unguarded))
            # nobody would ask the process that is started before it is known what for
            stack.enter_context(mock.patch("twin.kernel.process.process.start_ahead"))
        code = _exit_code(main)
    return Done(code, said.getvalue(), told.getvalue())


def twin_process(*arguments: object, cwd: Path, **settings: Any) -> "subprocess.CompletedProcess[str]":
    """`twin ARGUMENTS` in the folder `cwd`, as a process; `settings` are those of `subprocess.run`."""
    return process_run([sys.executable, "-m", "twin", *map(str, arguments)], cwd=cwd, timeout=300, **settings)


def process_run(command: list[str], **settings: Any) -> "subprocess.CompletedProcess[str]":
    """`command` as `subprocess.run` has it, without the line that says that code is being compiled: whether it is
    said depends on which tests ran before."""
    done = subprocess.run(command, capture_output=True, text=True, **settings)
    done.stderr = "".join(line for line in done.stderr.splitlines(True) if not line.startswith(COMPILING))
    return done


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


def _unguarded(
    job: str,
    arguments: dict[str, Any],
    limits: object = None,
    listen: Listen = lambda note: None,
    show: Show = lambda done, total: None,
) -> Any:
    """As `twin.kernel.process.guard.run_guarded`, through JSON likewise, in this process."""
    reporter = DirectReporter(lambda note: listen(_through_json(note)), show)
    # two jobs are two processes otherwise, and need not stand each other in one
    with _ONE_JOB:
        return _through_json(load_function(job)(reporter, **pickle.loads(pickle.dumps(arguments))))


def _through_json(content: Any) -> Any:
    return json.loads(json.dumps(content))
