"""Progress of a run, sweep, check or compilation, on one line of a terminal that is erased at the end."""

import os
import shlex
import shutil
import sys
import threading
import time
from pathlib import Path
from typing import Any

from twin.kernel.atomic_write import json_text
from twin.kernel.compiled.store import object_files
from twin.kernel.errors import escape_controls, terminal_text
from twin.kernel.process.job import duration_text, relative_path
from twin.kernel.recording.folder import LATEST_LINK

MIN_BAR_COLUMNS = 60
"""A bar needs a terminal wider than this (columns)."""
MIN_SHOWN_TIME = 1.0
"""Minimum remaining time (s) that is shown."""
MIN_SHARE = 0.01
"""Minimum share done for an estimate of the remaining time; the first part also compiles code."""
COMPILE_NOTICE_DELAY = 3.0
"""Time (s) after which a compilation is announced."""
PRINT_INTERVAL = 60.0
"""Interval (s) between lines of progress without a terminal."""
MAX_BAR_TEXT = 48
"""Maximum length of a text that fits next to a bar (characters)."""
TYPICAL_PIECES = 18
"""Approximate number of compiled functions that a run of Fig. 4 needs, for an empty cache."""
WATCH_INTERVAL = 0.25
"""Interval (s) between checks of the cache of compiled code."""


def compiling_text(done: int, about: int, seconds: float) -> str:
    """Format the progress of a compilation: `compiling, once: 12 of about 13, 9 s`."""
    of = f" of about {about}" if about else ""
    return f"compiling, once: {done}{of}, {seconds:.0f} s"


class PlainProgress:
    """Progress display without a terminal or a line to rewrite: a line per minute of long waits. Base of the others."""

    _printed = False
    _name, _duration = "", 0.0
    _began: float | None = None
    _share = _first = 0.0

    def __init__(self) -> None:
        self._next = time.monotonic() + PRINT_INTERVAL

    def say(self, what: str) -> None:
        """Show the current activity, such as `3 of 8 checks`; its duration is unknown."""
        if time.monotonic() > self._next:
            self._next = time.monotonic() + PRINT_INTERVAL
            print(f"{self._name} {what}".strip(), file=sys.stderr, flush=True)

    def step(self, what: str, share: float | None) -> None:
        """Show the current activity and the share done, 0 .. 1; None if unknown."""
        if share is None:
            self.say(what)
            return
        _, left = self._pace(share)
        self.say(f"{what}  {share:.0%}" + (f"  about {duration_text(left)} left" if left > MIN_SHOWN_TIME else ""))

    def compile(self, done: int, about: int, seconds: float) -> None:
        """Show that code is being compiled: `seconds` so far, `done` of about `about` functions, 0 if unknown."""
        if (about or seconds > COMPILE_NOTICE_DELAY) and not self._printed:
            self._printed = True
            print("compiling, once: some 10 s, more on a busy machine", file=sys.stderr, flush=True)

    def begin(self, name: str, duration: float) -> None:
        """Show that a run is being loaded, with its `name` and the `duration` (s) that it will simulate."""
        self._name, self._duration, self._began = escape_controls(name), duration, None

    def move(self, share: float) -> None:
        """Show the share of the run that has been simulated, 0 .. 1."""
        clock, speed, left = self._progress_texts(share)
        self.say(
            "  ".join(filter(None, (clock, speed, f"{duration_text(left)} left" if left > PRINT_INTERVAL else "")))
        )

    def clear(self) -> None:
        """Erase the progress line for other output; the next call shows it again."""

    def _progress_texts(self, share: float) -> tuple[str, str, float]:
        """Format a run's progress: simulated time, `12.3 / 20.0 s`, speed, `412 x real time`, remaining time (s)."""
        speed, left = self._pace(share)
        total = f"{self._duration:.1f}"
        clock = f"{share * self._duration:{len(total)}.1f} / {total} s"
        return clock, f"{speed * self._duration:.3g} x real time" if speed else "", left

    def _pace(self, share: float) -> tuple[float, float]:
        """Estimate (share done per second, remaining wall time (s)) of the run; 0 while unknown."""
        now = time.monotonic()
        if self._began is None or share < self._share:
            self._began, self._first = now, share
        self._share = share
        taken, gone = now - self._began, share - self._first
        return gone / taken if taken > 0.1 else 0.0, taken * (1.0 - share) / gone if gone >= MIN_SHARE else 0.0


class PlainLine(PlainProgress):
    """Progress display on a line of text that is rewritten with carriage returns; `rich` would need escape codes."""

    def say(self, what: str) -> None:
        self._write(f"{self._name}  {what}".strip())

    def compile(self, done: int, about: int, seconds: float) -> None:
        self.say(compiling_text(done, about, seconds))

    def begin(self, name: str, duration: float) -> None:
        super().begin(name, duration)
        self.say("loading")

    def clear(self) -> None:
        self._write("", "\r")

    def _write(self, text: str, end: str = "") -> None:
        # the last column stays free: some terminals would wrap the line
        width = shutil.get_terminal_size().columns - 1
        print("\r" + text[:width].ljust(width), end=end, file=sys.stderr, flush=True)


class Bar(PlainProgress):
    """Progress bar (by `rich`) of a run with simulated time, speed and remaining wall time."""

    def __init__(self) -> None:
        from rich import progress as rich_progress
        from rich.console import Console
        from rich.table import Column

        super().__init__()
        self._long: PlainLine | None = None
        # leaves room for the ^C that a terminal echoes, which would otherwise wrap and keep the line from being erased
        console = Console(stderr=True, width=Console(stderr=True).width - 3)
        self._roomy = console.width > MIN_BAR_COLUMNS
        name = Column(no_wrap=True, overflow="ellipsis", ratio=None if self._roomy else 1)
        text = rich_progress.TextColumn
        # a name must not be parsed as markup
        columns: list[Any] = [text("{task.description}", table_column=name, markup=False)]
        if self._roomy:
            columns.append(rich_progress.BarColumn(bar_width=None, table_column=Column(ratio=1, min_width=8)))
        columns += [text("{task.fields[clock]}", table_column=Column(no_wrap=True))]
        if self._roomy:
            columns += [
                text("{task.fields[speed]}", table_column=Column(no_wrap=True)),
                rich_progress.TimeRemainingColumn(table_column=Column(no_wrap=True)),
            ]
        # results are printed directly on standard output, with the bar cleared
        self._line = rich_progress.Progress(
            *columns, console=console, transient=True, expand=True, redirect_stdout=False, redirect_stderr=False
        )
        self._task = self._line.add_task("", total=None, clock="", speed="")

    def compile(self, done: int, about: int, seconds: float) -> None:
        self._count_to(about or None)
        self._show(clock=compiling_text(done, about, seconds), completed=done)

    def say(self, what: str) -> None:
        if self._long is None and len(what) <= MAX_BAR_TEXT:
            self._show(clock=what)
            return
        # a text about several activities leaves no room for a bar
        self._line.stop()
        self._long = self._long or PlainLine()
        self._long.say(escape_controls(what))

    def step(self, what: str, share: float | None) -> None:
        if share is None:
            self.say(what)
            return
        self._count_to(1.0)
        self._show(description=escape_controls(what), completed=share, clock=f"{share:4.0%}")

    def begin(self, name: str, duration: float) -> None:
        super().begin(name, duration)
        self._count_to(None)
        self._show(description=self._name, clock="loading", speed="")

    def move(self, share: float) -> None:
        self._count_to(1.0)
        clock, speed, _ = self._progress_texts(share)
        self._line.update(self._task, completed=share, clock=clock, speed=speed)

    def clear(self) -> None:
        self._line.stop()
        if self._long is not None:
            self._long.clear()
            self._long = None

    def _show(self, **fields: Any) -> None:
        self._line.update(self._task, **fields)
        self._line.start()

    def _count_to(self, total: float | None) -> None:
        """Restart the estimate of the remaining time if another quantity is counted; None if the total is unknown."""
        if self._line.tasks[0].total != total:
            self._line.reset(self._task)
            # `reset` would take None for "unchanged" and keep showing an estimate
            self._line.tasks[0].total = total


def progress() -> PlainProgress:
    """Create the progress display that suits standard error: a bar, a plain line under NO_COLOR, or printed lines.

    Standard output is left to results, so that it can be piped while progress is shown.
    """
    if not sys.stderr.isatty() or os.environ.get("TERM") == "dumb":
        return PlainProgress()
    return PlainLine() if os.environ.get("NO_COLOR") else Bar()


class CompileWatch:
    """Watcher of the cache of compiled code, which shows new entries on the progress display.

    It counts entries by other commands too: they need not be compiled again here.
    """

    def __init__(self, progress: PlainProgress):
        self._progress = progress
        self._before = len(object_files())
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._look, daemon=True)

    def start(self) -> None:
        self._thread.start()

    def end(self) -> None:
        """Stop watching the cache of compiled code and free the progress line; may be called repeatedly."""
        self._over.set()
        if self._thread.is_alive():
            self._thread.join()

    def _look(self) -> None:
        began = time.monotonic()
        while not self._over.wait(WATCH_INTERVAL):
            new = len(object_files()) - self._before
            if new:
                # the number still missing is unknown if the cache was not empty or the run needs more
                about = TYPICAL_PIECES if not self._before and new < TYPICAL_PIECES else 0
                self._progress.compile(new, about, time.monotonic() - began)


class TerminalDisplay:
    """Display of a command: progress on standard error if that is a terminal, results of runs on standard output.

    The results are JSON if `as_json`. A run that loads immediately announces its compilation without a terminal too.
    `folder` is the folder of the current run; None before the first.
    """

    def __init__(self, as_json: bool = False, loading: bool = True):
        self.folder: Path | None = None
        self._loading = loading
        self._name = ""
        self._as_json = as_json
        self._progress = progress()
        self._watch = CompileWatch(self._progress)
        self._done: list[Path] = []

    def __enter__(self) -> "TerminalDisplay":
        if self._loading:
            self._progress.say("loading")
            self._watch.start()
        return self

    def __exit__(self, *failure: object) -> None:
        self.clear()
        if self._done and not self._as_json:
            print(f"  next       {shlex.join([program(), 'report', *map(str, self._done)])}")

    def watch(self) -> None:
        """Show compilations of code on the terminal from now on."""
        if sys.stderr.isatty():
            self._watch.start()

    def say(self, what: str, share: float | None = None) -> None:
        """Show the current activity and the share done on the terminal; fits `Say`."""
        # compilation is over once a step has been completed
        if share:
            self._watch.end()
        self._progress.step(what, share)

    def on_note(self, note: dict[str, Any]) -> None:
        """Show a note of a job's process: progress or a text on standard error, a finished run on standard output.

        The notes are documented at `recorded_runs`, `served_runs` and `answer_study`.
        """
        if "say" in note:
            self.say(note["say"], note["share"])
        elif "run" in note:
            # imported here: commands for systems without the robot do not need it
            from twin.cli.run_text import run_facts, run_text

            facts = {"experiment": self._name, **note["run"]}
            facts["recording"] = relative_path(Path(facts["recording"]))
            self.clear()
            print(json_text(run_facts(facts)) if self._as_json else run_text(facts), flush=True)
            self._done.append(_shortest(facts["recording"].parent))
        elif "line" in note:
            self.clear()
            # on standard error: --json reserves standard output for the result
            print(terminal_text(note["line"]), file=sys.stderr, flush=True)
        else:
            self._name, self.folder = note["experiment"], Path(note["folder"])
            self._progress.begin(self._name, note["duration"])

    def clear(self) -> None:
        self._watch.end()
        self._progress.clear()

    def show(self, done: int, total: int) -> None:
        """Move the bar to `done` of `total` ticks; unchanged before the first step, as more may be compiled."""
        if not done:
            return
        self._watch.end()
        self._progress.move(done / total)


def program() -> str:
    """Return the shell command that starts this program: `twin`, or its path, as in `make run`."""
    called = sys.argv[0]
    if os.path.basename(called) != "twin" or os.sep not in called:
        return "twin"
    for folder in os.get_exec_path():
        found = os.path.join(folder, "twin")
        if os.access(found, os.X_OK):
            return "twin" if os.path.samefile(found, called) else called
    return called


def _shortest(folder: Path) -> Path:
    """Shorten the folder of an experiment's latest run to results/EXPERIMENT; return any other folder unchanged."""
    latest = folder.parent / LATEST_LINK
    return folder.parent if latest.is_symlink() and latest.resolve() == folder.resolve() else folder
