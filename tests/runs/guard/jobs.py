"""Jobs for the tests of the guard; each is run in a process of its own."""

import os
import time
from pathlib import Path
from typing import Any

from twin.runs.guard.voice import Voice
from twin.studies.identify.errors import NotIdentifiable


def echo(voice: Voice, **arguments: Any) -> dict[str, Any]:
    """Gives back what it got, after a note about each."""
    for name in arguments:
        voice.note(name=name)
    return arguments


def refuse(voice: Voice) -> None:
    """Raises what a user has to be told."""
    raise NotIdentifiable("drive.fmu: is a teapot")


def typed(voice: Voice, **arguments: Any) -> list[str]:
    """The types of what it got."""
    return [type(value).__name__ for value in arguments.values()]


def blunder(voice: Voice) -> None:
    """Raises what no user should ever see."""
    raise ZeroDivisionError("a mistake of ours")


def vanish(voice: Voice) -> None:
    """Ends its process as if all were well."""
    print("so long", flush=True)
    os._exit(0)


def linger(voice: Voice, farewell: str, stubborn: bool = False) -> None:
    """Sleeps for longer than anybody waits; interrupted, writes the file `farewell`, and sleeps on if `stubborn`."""
    try:
        voice.note(begun=True)
        time.sleep(1000)
    except KeyboardInterrupt:
        Path(farewell).touch()
        if stubborn:
            time.sleep(1000)
        raise


def variable(voice: Voice, name: str) -> str | None:
    """What its environment says."""
    return os.environ.get(name)
