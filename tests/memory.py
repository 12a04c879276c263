"""The most memory that this process has held within a stretch of a test: its own mark is that of all tests before."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

_STATUS, _FORGET = Path("/proc/self/status"), Path("/proc/self/clear_refs")
_FORGET_PEAK = "5"
"""proc(5): sets the peak to what is held now."""


@contextmanager
def growth() -> Iterator[Callable[[], int]]:
    """Gives a function: by how many bytes more than at the beginning were held at the same time since then, at most."""
    _FORGET.write_text(_FORGET_PEAK)
    before = _kilobytes("VmRSS")
    yield lambda: 1024 * (_kilobytes("VmHWM") - before)


def _kilobytes(name: str) -> int:
    line = next(line for line in _STATUS.read_text().splitlines() if line.startswith(name))
    return int(line.split()[1])
