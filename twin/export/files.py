"""A file that appears whole or not at all."""

import os
from collections.abc import Callable
from pathlib import Path

from twin.errors import InputRefused


def write_whole(path: Path, write: Callable[[Path], None], force: bool = False) -> None:
    """Let `write` fill a file under a temporary name beside `path`, then give it its name.

    Args:
        path: of the finished file. write: is called with the temporary one. force: replace what is there.

    Raises:
        InputRefused: there is a file of that name (unless `force`), or it cannot be written.
    """
    if path.exists() and not force:
        raise InputRefused(f"{path}: already there; replace it with --force or name another with --out")
    partial = path.with_name(path.name + ".partial")
    try:
        write(partial)
        os.replace(partial, path)
    except OSError as problem:
        partial.unlink(missing_ok=True)
        raise InputRefused(f"{path}: cannot be written: {problem.strerror or problem}") from None
