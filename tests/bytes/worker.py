"""Does cases in one tree, one after the other: a case as a line of JSON comes in, what came of it goes out.

Runs are made in this process, which is warm then; command lines in copies of it (fork), as fresh processes would, but
without their half second of imports. A case that ends this process is noticed by who started it.
"""

import contextlib
import importlib
import json
import os
import pkgutil
import runpy
import shlex
import shutil
import subprocess
import sys
import tempfile
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tests.bytes.outputs import ERROR, described
from tests.bytes.page import page_answers


def main() -> None:
    """Answer cases until there are no more; arguments: the tree, and where recordings are kept or ""."""
    tree, kept = Path(sys.argv[1]), sys.argv[2]
    # what FMUs and interpreters print does not come between the answers
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    _import_all(tree)
    for line in sys.stdin:
        case = json.loads(line)
        folder = Path(tempfile.mkdtemp(prefix="case-", dir=tree.parent))
        for name, text in case["files"].items():
            (folder / name).write_text(text.replace("TREE", str(tree)), encoding="utf-8")
        os.chdir(folder)
        # for the processes that it starts
        os.environ.update(case["environment"])

        def placed(text: str, here: str = str(folder)) -> str:
            return text.replace(str(tree), "TREE").replace(here, "HERE")

        if case["load"]:
            found = _run(case["load"], folder, placed)
        else:
            found = _command_lines(case["commands"], tree, placed)
            if case["page"]:
                words, asks = case["page"]
                found |= {name: placed(text) for name, text in page_answers(words, asks, _as_twin).items()}
            found |= described(folder, placed)
        print(json.dumps(found), file=answers, flush=True)
        os.chdir(tree)
        for name in case["environment"]:
            del os.environ[name]
        if kept:
            place = Path(kept) / case["name"].replace(" ", "_").replace("/", "_")
            shutil.rmtree(place, ignore_errors=True)
            shutil.copytree(folder, place, symlinks=True)
        shutil.rmtree(folder, ignore_errors=True)


def _import_all(tree: Path) -> None:
    """Import every module of the tree's `twin`, whatever they are called, so that no copy has to.

    Raises:
        RuntimeError: another tree's would be tried.
    """
    import twin

    if tree not in Path(twin.__file__).parents:
        raise RuntimeError(f"{twin.__file__} is not in {tree}")
    for found in pkgutil.walk_packages(twin.__path__, "twin."):
        if not found.name.endswith("__main__"):
            # what only an extra has is not there either when it is needed
            with contextlib.suppress(ImportError):
                importlib.import_module(found.name)
    import matplotlib.pyplot  # noqa: F401
    import scipy.signal  # noqa: F401


def _run(load: list[Any], folder: Path, placed: Callable[[str], str]) -> dict[str, Any]:
    """What `twin.run` records of `twin.load(*load)`, topic by topic; or why it did not."""
    import twin

    found: dict[str, Any] = {}
    try:
        twin.run(twin.load(*load), folder / "run")
    except Exception as mistake:
        found["raised"] = placed(f"{type(mistake).__name__}: {mistake}")
    return found | described(folder / "run", placed)


def _command_lines(lines: list[str], tree: Path, placed: Callable[[str], str]) -> dict[str, Any]:
    """Text and exit code of each command line."""
    found: dict[str, Any] = {}
    for number, line in enumerate(lines, 1):
        words = [word.replace("TREE", str(tree)) for word in shlex.split(line)]
        if words[:1] == ["python"]:
            subprocess.run([sys.executable, *words[1:]], check=True)
            continue
        code, out, err = _forked(words)
        name = f"{number}: twin {line}"
        found[f"{name} [exit code]"] = str(code)
        found[f"{name} [output]"] = placed(out)
        found[f"{name}{ERROR}"] = placed(err)
    return found


def _forked(words: list[str]) -> tuple[int, str, str]:
    """Exit code, output and error of `python -m twin WORDS`."""
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err:
        child = os.fork()
        if not child:
            _as_twin(words, out.fileno(), err.fileno())
        code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        said = []
        for file in (out, err):
            file.seek(0)
            said.append(file.read().decode("utf-8", "replace"))
    return code, said[0], said[1]


def _as_twin(words: list[str], out: int, err: int) -> None:
    """End this process as `python -m twin WORDS` would, with its output in the files `out` and `err`."""
    code: Any = 0
    try:
        os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
        os.dup2(out, 1)
        os.dup2(err, 2)
        sys.stdin = open(0, closefd=False)  # noqa: SIM115
        sys.stdout = open(1, "w", encoding="utf-8", closefd=False)  # noqa: SIM115
        sys.stderr = open(2, "w", encoding="utf-8", closefd=False)  # noqa: SIM115
        sys.argv = ["twin", *words]
        runpy.run_module("twin", run_name="__main__", alter_sys=True)
    except SystemExit as end:
        code = end.code
        if isinstance(code, str):
            print(code, file=sys.stderr)
            code = 1
    except BaseException:
        traceback.print_exc()
        code = 1
    with contextlib.suppress(Exception):
        sys.stdout.flush()
        sys.stderr.flush()
    os._exit(code or 0)
