"""How far a run, a sweep or a check is, on one line of a terminal that is gone when it is over."""

import os
import shutil
import sys
import time
from typing import Any

from twin.errors import visible
from twin.runs.guard.limits import duration_text

NARROW = 60
"""A line of so many columns has no room for a bar."""
SOON = 1.0
"""s. What is over sooner needs no estimate."""
PATIENCE = 3.0
"""s. Who waits longer for code that is compiled wants to know."""
MINUTE = 60.0
"""How often (s) whoever has no terminal is told how far it is."""


def compiling(done: int, about: int, seconds: float) -> str:
    """`compiling, once: 12 of about 13, 9 s`; pieces of machine code."""
    of = f" of about {about}" if about else ""
    return f"compiling, once: {done}{of}, {seconds:.0f} s"


class Progress:
    """Where there is no terminal, or one that cannot go back on its line: only a long wait is told, in a line of its
    own, and a line each minute. Others show one thing after the other."""

    _told = False
    _name, _duration = "", 0.0
    _began: float | None = None
    _share = _first = 0.0

    def __init__(self) -> None:
        self._next = time.monotonic() + MINUTE

    def say(self, what: str) -> None:
        """From now on `what` is going on, `3 of 8 checks` or nobody knows for how long."""
        if time.monotonic() > self._next:
            self._next = time.monotonic() + MINUTE
            print(f"{self._name} {what}".strip(), file=sys.stderr, flush=True)

    def step(self, what: str, share: float | None) -> None:
        """`what` is going on, and `share` of all is over, 0 .. 1; None: nobody knows how much."""
        if share is None:
            self.say(what)
            return
        _, left = self._pace(share)
        self.say(f"{what}  {share:.0%}" + (f"  about {duration_text(left)} left" if left > SOON else ""))

    def compile(self, done: int, about: int, seconds: float) -> None:
        """For `seconds` code has been compiled: `done` pieces of about so many, 0 if nobody knows."""
        if (about or seconds > PATIENCE) and not self._told:
            self._told = True
            print("compiling, once: some 10 s, more on a busy machine", file=sys.stderr, flush=True)

    def begin(self, name: str, duration: float) -> None:
        """The run `name` is made ready; it will simulate `duration` (s)."""
        self._name, self._duration, self._began = visible(name), duration, None

    def move(self, share: float) -> None:
        """So much of it has been simulated, 0 .. 1."""
        clock, speed, left = self._simulated(share)
        self.say("  ".join(filter(None, (clock, speed, f"{duration_text(left)} left" if left > MINUTE else ""))))

    def clear(self) -> None:
        """Leave the line to others; whatever comes next takes it back."""

    def _simulated(self, share: float) -> tuple[str, str, float]:
        """`12.3 / 20.0 s`, as wide at the beginning as at the end; `412 x real time`; the time (s) that is left."""
        speed, left = self._pace(share)
        total = f"{self._duration:.1f}"
        clock = f"{share * self._duration:{len(total)}.1f} / {total} s"
        return clock, f"{speed * self._duration:.3g} x real time" if speed else "", left

    def _pace(self, share: float) -> tuple[float, float]:
        """(how much of all goes by in a second, wall time (s) that is left); 0 as long as nobody can know."""
        now = time.monotonic()
        if self._began is None or share < self._share:
            self._began, self._first = now, share
        self._share = share
        taken, gone = now - self._began, share - self._first
        return gone / taken if taken > 0.1 else 0.0, taken * (1.0 - share) / gone if gone > 0.0 else 0.0


class PlainLine(Progress):
    """A line of text that is written over itself; `rich` would move the cursor by escape codes."""

    def say(self, what: str) -> None:
        self._write(f"{self._name}  {what}".strip())

    def compile(self, done: int, about: int, seconds: float) -> None:
        self.say(compiling(done, about, seconds))

    def begin(self, name: str, duration: float) -> None:
        super().begin(name, duration)
        self.say("loading")

    def clear(self) -> None:
        self._write("", "\r")

    def _write(self, text: str, end: str = "") -> None:
        # the last column is left free: some terminals would go on to the next line
        width = shutil.get_terminal_size().columns - 1
        print("\r" + text[:width].ljust(width), end=end, file=sys.stderr, flush=True)


class Bar(Progress):
    """A bar with simulated time, speed and remaining wall time, of `rich`."""

    def __init__(self) -> None:
        from rich import progress as rich_progress
        from rich.console import Console
        from rich.table import Column

        super().__init__()
        # leaves room for the ^C that a terminal echoes: on the next line it would keep this one from being erased
        console = Console(stderr=True, width=Console(stderr=True).width - 3)
        self._roomy = console.width > NARROW
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
        self._show(clock=compiling(done, about, seconds), completed=done)

    def say(self, what: str) -> None:
        self._show(clock=what)

    def step(self, what: str, share: float | None) -> None:
        if share is None:
            self.say(what)
            return
        self._count_to(1.0)
        self._show(description=visible(what), completed=share, clock=f"{share:4.0%}")

    def begin(self, name: str, duration: float) -> None:
        super().begin(name, duration)
        self._count_to(None)
        self._show(description=self._name, clock="loading", speed="")

    def move(self, share: float) -> None:
        self._count_to(1.0)
        clock, speed, _ = self._simulated(share)
        self._line.update(self._task, completed=share, clock=clock, speed=speed)

    def clear(self) -> None:
        self._line.stop()

    def _show(self, **fields: Any) -> None:
        self._line.update(self._task, **fields)
        self._line.start()

    def _count_to(self, total: float | None) -> None:
        """What is left is estimated anew where something else is counted; None: nobody knows how much."""
        if self._line.tasks[0].total != total:
            self._line.reset(self._task)
            # `reset` would take None for "as it was", and go on to promise an end
            self._line.tasks[0].total = total


def progress() -> Progress:
    """What suits the terminal on standard error: a bar, a plain line without escape codes under NO_COLOR, or nothing.

    Standard output belongs to results, so that it can be piped while progress is still seen.
    """
    if not sys.stderr.isatty() or os.environ.get("TERM") == "dumb":
        return Progress()
    return PlainLine() if os.environ.get("NO_COLOR") else Bar()
