"""What a job says to whoever started it, from a process of its own or from the same one."""

from collections.abc import Callable
from typing import Any, Protocol

Listen = Callable[[dict[str, Any]], None]
Show = Callable[[int, int], None]


class Reporter(Protocol):
    """How a job speaks.

    A job is a function `job(reporter, **arguments)`; its notes and its result are what JSON can hold.
    """

    def note(self, **facts: Any) -> None:
        """Tell the one who listens to this job whatever the two have agreed on."""

    def loading(self) -> None:
        """From now on components are made; a failure is one of the input."""

    def progress(self, done: int, total: int) -> None:
        """`done` of `total` ticks are over. Fits `twin.runs.execute(progress=...)`."""

    def helper(self, name: str, pid: int) -> None:
        """The component `name` lives in the process `pid`."""


class DirectReporter:
    """For a job in the same process: nobody watches, so only notes and progress have a hearer."""

    def __init__(self, listen: Listen, show: Show = lambda done, total: None):
        self._listen, self.progress = listen, show

    def note(self, **facts: Any) -> None:
        self._listen(facts)

    def loading(self) -> None:
        """Nothing to say: errors are raised."""

    def helper(self, name: str, pid: int) -> None:
        """Nothing to say: its memory is not limited."""


_of_process: list[Reporter] = []


def let_speak(reporter: Reporter) -> None:
    """From now on `reporter` is that of this process."""
    _of_process[:] = [reporter]


def own_reporter() -> Reporter:
    """That of this process, for what no job hands on; where nobody listens, one that nobody hears."""
    return _of_process[0] if _of_process else DirectReporter(lambda note: None)
