"""What `twin run` shows while it runs and says when it is done."""

import os
import shlex
import sys
from pathlib import Path
from typing import Any

from twin.cli.compiling import CompileWatch
from twin.cli.progress import progress
from twin.errors import plain
from twin.recording.folder import LATEST
from twin.report.run_text import run_facts, run_text
from twin.runs.guard.recorded import seen_from_here
from twin.writing import json_text


class Display:
    """Progress on standard error if that is a terminal; what each run has to say, plain, on standard output.

    Attributes:
        folder: of the run that is on, None before the first.
    """

    def __init__(self, as_json: bool):
        self.folder: Path | None = None
        self._name = ""
        self._as_json = as_json
        self._progress = progress()
        self._watch = CompileWatch(self._progress)
        self._done: list[Path] = []

    def __enter__(self) -> "Display":
        self._progress.say("loading")
        self._watch.start()
        return self

    def __exit__(self, *failure: object) -> None:
        self.clear()
        if self._done and not self._as_json:
            print(f"  next       {shlex.join([program(), 'report', *map(str, self._done)])}")

    def hear(self, note: dict[str, Any]) -> None:
        """Take a note of `recorded_runs`."""
        if "run" in note:
            facts = {"experiment": self._name, **note["run"]}
            facts["recording"] = seen_from_here(Path(facts["recording"]))
            self.clear()
            print(json_text(run_facts(facts)) if self._as_json else run_text(facts), flush=True)
            self._done.append(_shortest(facts["recording"].parent))
        elif "serving" in note:
            self.clear()
            # not on standard output, which --json keeps for the result
            print(f"serving {note['serving']}; the run begins when a viewer subscribes", file=sys.stderr, flush=True)
        elif "refused" in note:
            self.clear()
            print(plain(f"refused: {note['refused']}"), file=sys.stderr, flush=True)
        else:
            self._name, self.folder = note["experiment"], Path(note["folder"])
            self._progress.begin(self._name, note["duration"])

    def clear(self) -> None:
        """Leave the terminal to whoever has something to say."""
        self._watch.end()
        self._progress.clear()

    def show(self, done: int, total: int) -> None:
        """Move the bar; before the first step more may have to be compiled."""
        if not done:
            return
        self._watch.end()
        self._progress.move(done / total)


def program() -> str:
    """What a shell finds this program by: `twin`, or the path by which it was called, of `make run` say."""
    called = sys.argv[0]
    if os.path.basename(called) != "twin" or os.sep not in called:
        return "twin"
    for folder in os.get_exec_path():
        found = os.path.join(folder, "twin")
        if os.access(found, os.X_OK):
            return "twin" if os.path.samefile(found, called) else called
    return called


def _shortest(folder: Path) -> Path:
    """results/EXPERIMENT instead of the folder of its latest run."""
    latest = folder.parent / LATEST
    return folder.parent if latest.is_symlink() and latest.resolve() == folder.resolve() else folder
