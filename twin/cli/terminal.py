"""Progress of a run, a sweep, a check or a compilation on one line of a terminal, removed at the end."""

import os
import shlex
import shutil
import sys
import threading
import time
from pathlib import Path
from typing import Any

from twin.kernel.atomic_write import json_text
from twin.kernel.compiled.store import object_count
from twin.kernel.errors import escape_controls, terminal_text
from twin.kernel.process.job import duration_text, relative_path
from twin.kernel.recording.folder import LATEST_LINK

MIN_BAR_COLUMNS = 60
"""A line of so many columns has no room for a bar."""
MIN_SHOWN_TIME = 1.0
"""s. What is over sooner needs no estimate."""
MIN_SHARE = 0.01
"""Smallest share done at which the remaining time is estimated; the first part also compiles code."""
COMPILE_NOTICE_DELAY = 3.0
"""s. Who waits longer for code that is compiled wants to know."""
PRINT_INTERVAL = 60.0
"""How often (s) progress is printed without a terminal."""
MAX_BAR_TEXT = 48
"""Letters for which there is room beside a bar."""
TYPICAL_PIECES = 18
"""How many pieces of machine code a run of Fig. 4 needs, about; where none is there yet."""
WATCH_INTERVAL = 0.25
"""Seconds between two looks at what has been compiled."""


def compiling_text(done: int, about: int, seconds: float) -> str:
    """`compiling, once: 12 of about 13, 9 s`; pieces of machine code."""
    of = f" of about {about}" if about else ""
    return f"compiling, once: {done}{of}, {seconds:.0f} s"


class PlainProgress:
    """Where there is no terminal, or one that cannot go back on its line: only a long wait is printed, in a line of its
    own, and a line each minute. Others show one thing after the other."""

    _printed = False
    _name, _duration = "", 0.0
    _began: float | None = None
    _share = _first = 0.0

    def __init__(self) -> None:
        self._next = time.monotonic() + PRINT_INTERVAL

    def say(self, what: str) -> None:
        """From now on `what` is going on, `3 of 8 checks` or of unknown length."""
        if time.monotonic() > self._next:
            self._next = time.monotonic() + PRINT_INTERVAL
            print(f"{self._name} {what}".strip(), file=sys.stderr, flush=True)

    def step(self, what: str, share: float | None) -> None:
        """`what` is going on, and `share` of all is over, 0 .. 1; None: unknown."""
        if share is None:
            self.say(what)
            return
        _, left = self._pace(share)
        self.say(f"{what}  {share:.0%}" + (f"  about {duration_text(left)} left" if left > MIN_SHOWN_TIME else ""))

    def compile(self, done: int, about: int, seconds: float) -> None:
        """For `seconds` code has been compiled: `done` pieces of about so many, 0 if unknown."""
        if (about or seconds > COMPILE_NOTICE_DELAY) and not self._printed:
            self._printed = True
            print("compiling, once: some 10 s, more on a busy machine", file=sys.stderr, flush=True)

    def begin(self, name: str, duration: float) -> None:
        """The run `name` is made ready; it will simulate `duration` (s)."""
        self._name, self._duration, self._began = escape_controls(name), duration, None

    def move(self, share: float) -> None:
        """So much of it has been simulated, 0 .. 1."""
        clock, speed, left = self._progress_texts(share)
        self.say(
            "  ".join(filter(None, (clock, speed, f"{duration_text(left)} left" if left > PRINT_INTERVAL else "")))
        )

    def clear(self) -> None:
        """Leave the line to others; whatever comes next takes it back."""

    def _progress_texts(self, share: float) -> tuple[str, str, float]:
        """`12.3 / 20.0 s`, as wide at the beginning as at the end; `412 x real time`; the time (s) that is left."""
        speed, left = self._pace(share)
        total = f"{self._duration:.1f}"
        clock = f"{share * self._duration:{len(total)}.1f} / {total} s"
        return clock, f"{speed * self._duration:.3g} x real time" if speed else "", left

    def _pace(self, share: float) -> tuple[float, float]:
        """(how much of all goes by in a second, wall time (s) that is left); 0 as long as it is unknown."""
        now = time.monotonic()
        if self._began is None or share < self._share:
            self._began, self._first = now, share
        self._share = share
        taken, gone = now - self._began, share - self._first
        return gone / taken if taken > 0.1 else 0.0, taken * (1.0 - share) / gone if gone >= MIN_SHARE else 0.0


class PlainLine(PlainProgress):
    """A line of text that is written over itself; `rich` would move the cursor by escape codes."""

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
        # the last column is left free: some terminals would go on to the next line
        width = shutil.get_terminal_size().columns - 1
        print("\r" + text[:width].ljust(width), end=end, file=sys.stderr, flush=True)


class Bar(PlainProgress):
    """A bar with simulated time, speed and remaining wall time, of `rich`."""

    def __init__(self) -> None:
        from rich import progress as rich_progress
        from rich.console import Console
        from rich.table import Column

        super().__init__()
        self._long: PlainLine | None = None
        # leaves room for the ^C that a terminal echoes: on the next line it would keep this one from being erased
        console = Console(stderr=True, width=Console(stderr=True).width - 3)
        self._roomy = console.width > MIN_BAR_COLUMNS
        name = Column(no_wrap=True, overflow="ellipsis", ratio=None if self._roomy else 1)
        text = rich_progress.TextColumn
        # a name is no markup
        columns: list[Any] = [text("{task.description}", table_column=name, markup=False)]
        if self._roomy:
            columns.append(rich_progress.BarColumn(bar_width=None, table_column=Column(ratio=1, min_width=8)))
        columns += [text("{task.fields[clock]}", table_column=Column(no_wrap=True))]
        if self._roomy:
            columns += [
                text("{task.fields[speed]}", table_column=Column(no_wrap=True)),
                rich_progress.TimeRemainingColumn(table_column=Column(no_wrap=True)),
            ]
        # results are printed on standard output by themselves, with the bar cleared
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
        # a line that tells of several things has no room for a bar that counts nothing
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
        """What is left is estimated anew where something else is counted; None: unknown."""
        if self._line.tasks[0].total != total:
            self._line.reset(self._task)
            # `reset` would take None for "as it was", and go on to promise an end
            self._line.tasks[0].total = total


def progress() -> PlainProgress:
    """What suits the terminal on standard error: a bar, a plain line without escape codes under NO_COLOR, or nothing.

    Standard output belongs to results, so that it can be piped while progress is still seen.
    """
    if not sys.stderr.isatty() or os.environ.get("TERM") == "dumb":
        return PlainProgress()
    return PlainLine() if os.environ.get("NO_COLOR") else Bar()


class CompileWatch:
    """Looks at the kept compiled code from time to time and tells `progress` when there is more, from `start` to `end`.

    What other commands compile at the same time is counted too: it will not have to be compiled here.
    """

    def __init__(self, progress: PlainProgress):
        self._progress = progress
        self._before = object_count()
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._look, daemon=True)

    def start(self) -> None:
        """Look from now on."""
        self._thread.start()

    def end(self) -> None:
        """Look no more; the line belongs to others from now on. To be called as often as one likes."""
        self._over.set()
        if self._thread.is_alive():
            self._thread.join()

    def _look(self) -> None:
        began = time.monotonic()
        while not self._over.wait(WATCH_INTERVAL):
            new = object_count() - self._before
            if new:
                # how many are lacking of those that were there in part, or of a run that needs more, is unknown
                about = TYPICAL_PIECES if not self._before and new < TYPICAL_PIECES else 0
                self._progress.compile(new, about, time.monotonic() - began)


class TerminalDisplay:
    """Progress on standard error if that is a terminal; what each run has to say, plain, on standard output.

    Args:
        as_json: what runs have to say is JSON.
        loading: a run is loaded at once; what is compiled meanwhile is printed without a terminal, too.

    Attributes:
        folder: of the run that is on, None before the first.
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
        """Tell who sits at the terminal what is compiled from now on."""
        if sys.stderr.isatty():
            self._watch.start()

    def say(self, what: str, share: float | None = None) -> None:
        """As of `Say`."""
        # from the first step that is over on there is a share to show
        if share:
            self._watch.end()
        self._progress.step(what, share)

    def on_note(self, note: dict[str, Any]) -> None:
        """Take a note of a job, see `recorded_runs`, `recorded` and `answered`."""
        if "say" in note:
            self.say(note["say"], note["share"])
        elif "run" in note:
            # of the robot, which commands of systems do without
            from twin.cli.run_text import run_facts, run_text

            facts = {"experiment": self._name, **note["run"]}
            facts["recording"] = relative_path(Path(facts["recording"]))
            self.clear()
            print(json_text(run_facts(facts)) if self._as_json else run_text(facts), flush=True)
            self._done.append(_shortest(facts["recording"].parent))
        elif "serving" in note:
            self.clear()
            # not on standard output, which --json keeps for the result
            print(f"serving {note['serving']}; the run begins when a viewer subscribes", file=sys.stderr, flush=True)
        elif "refused" in note:
            self.clear()
            print(terminal_text(f"refused: {note['refused']}"), file=sys.stderr, flush=True)
        else:
            self._name, self.folder = note["experiment"], Path(note["folder"])
            self._progress.begin(self._name, note["duration"])

    def clear(self) -> None:
        """Leave the terminal to other output."""
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
    latest = folder.parent / LATEST_LINK
    return folder.parent if latest.is_symlink() and latest.resolve() == folder.resolve() else folder
