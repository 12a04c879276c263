"""Where the files of a report go."""

from pathlib import Path

from twin.errors import InputRefused


def made_folder(folder: Path) -> Path:
    """`folder`, which is there from now on.

    Raises:
        InputRefused: it cannot be created.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as problem:
        raise InputRefused(f"{folder}: cannot be created: {problem.strerror}") from None
    return folder
