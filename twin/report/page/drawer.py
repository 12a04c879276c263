"""A picture is drawn while the page around it is made: by a process that was started ahead, if one waits, else here."""

import pickle
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path

from twin.kernel.process.ahead import taken
from twin.kernel.process.job import function_called
from twin.kernel.process.process import GuardedProcess
from twin.report.page import DRAWN

POLL, PATIENCE = 0.05, 60.0
"""How often (s) it is looked whether that process still lives, and for how long it is waited for."""

LARGEST = 200_000_000
"""Bytes that are handed over; to write and read more would take time and room, and a minute of drawing is ahead."""


@contextmanager
def drawing(draw: str, shown: object, size: int = 0) -> Iterator[Callable[[], bytes]]:
    """What waits for a picture that is being drawn, and returns its content (PNG).

    Args:
        draw: "module:function", which is called as `draw(shown, path)`.
        shown: what can be pickled.
        size: of that (bytes), about.
    """
    waiting = taken(DRAWN) if size <= LARGEST else None
    with tempfile.TemporaryDirectory() as folder, waiting or nullcontext() as process:
        path, handed_over = Path(folder) / "picture.png", Path(folder) / "shown"
        if process:
            try:
                with handed_over.open("wb") as file:
                    # arrays go straight to the file
                    pickle.dump(shown, file, protocol=5)
                process.start({"draw": draw, "shown": handed_over, "path": path})
            except OSError:
                process = None

        def content() -> bytes:
            if process is None or not _is_finished(process):
                function_called(draw)(shown, path)
            return path.read_bytes()

        yield content


def _is_finished(process: GuardedProcess) -> bool:
    """Whether it has done what it was asked for, which is waited for; whatever is in its way, there is another."""
    while not process.gone and process.age < PATIENCE:
        for report in process.reports(POLL):
            return "finished" in report
    return False
