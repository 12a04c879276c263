"""Recordings that were made elsewhere, brought to the sweep's folder."""

import shutil
from collections.abc import Mapping
from pathlib import Path

from twin.errors import InputRefused, NotWritten
from twin.studies.sweep.rows import DiskFailed
from twin.writing import made_folder, write_bytes


def keep_recording(folder: Path, files: Mapping[str, bytes]) -> None:
    """Make `folder` that of a run with `files`; without files nothing is done.

    Raises:
        DiskFailed: they cannot be written; nothing of them is left.
    """
    if not files:
        return
    try:
        # what an interrupted sweep left of the same run
        shutil.rmtree(folder, ignore_errors=True)
        made_folder(folder)
        for name, content in files.items():
            write_bytes(folder / name, content)
    except (InputRefused, NotWritten) as problem:
        shutil.rmtree(folder, ignore_errors=True)
        raise DiskFailed(f"{problem}; finished runs are kept. Make room, then give the same command to go on") from None
