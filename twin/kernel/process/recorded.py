"""What a run that did not end well has left in its folder."""

import contextlib
from pathlib import Path


def recorded_until_then(folder: Path | None) -> str:
    """A sentence about the recording in `folder` (None: there is no folder yet)."""
    # the supervisor loads no numerics unless something goes wrong
    from twin.kernel.recording.folder import RECORDING
    from twin.kernel.recording.reader import last_time
    from twin.kernel.recording.writer import PARTIAL

    if folder is not None and (folder / RECORDING).exists():
        return f"The recording is complete: {seen_from_here(folder / RECORDING)}."
    if folder is None or not (partial := folder / f"{RECORDING}{PARTIAL}").exists():
        return "Nothing was recorded."
    return f"Recorded until then: {seen_from_here(partial)} ({last_time(partial) or 0.0:.3f} s)."


def left_behind(folder: Path) -> str:
    """What Ctrl-C has left in the `folder` of a run; it goes if that is nothing."""
    from twin.kernel.recording.folder import RECORDING
    from twin.kernel.recording.writer import PARTIAL

    whole, partial = folder / RECORDING, folder / f"{RECORDING}{PARTIAL}"
    if partial.exists():
        return f"interrupted; recorded until then: {seen_from_here(partial)}"
    if whole.exists():
        return f"interrupted; the recording is complete: {seen_from_here(whole)}"
    # whatever else is in it stays
    with contextlib.suppress(OSError):
        folder.rmdir()
    return "interrupted before the first step; nothing is recorded"


def seen_from_here(path: Path) -> Path:
    """`path` relative to the current folder, if it lies below."""
    return path.relative_to(Path.cwd()) if path.is_relative_to(Path.cwd()) else path
