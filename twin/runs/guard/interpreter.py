"""A Python of our own: it finds this package and nothing that happens to lie in the folder where it is started."""

import os
import sys
import sysconfig
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import twin

SAFE_PATH, OURS = "PYTHONSAFEPATH", "twin"
"""Environment variable that has the effect of -P, and the value by which it is known that we set it."""


def module_command(module: str, *arguments: str) -> list[str]:
    """The command that runs `module` of this package, with `environment`."""
    # -P: the folder where a user happens to be is no place to import from
    return [sys.executable, "-P", "-m", module, *arguments]


def environment() -> dict[str, str]:
    """This process's environment, by which another Python finds the package that this one uses.

    What a drive starts there, scripts of its own perhaps, searches folders as Python does by itself.
    """
    home = str(Path(twin.__file__).parents[1])
    inherited = os.environ.get("PYTHONPATH", "").split(os.pathsep)
    # an empty entry is the current folder; site-packages are found anyway, and not before the standard library
    paths = [path for path in (home, *inherited) if path and path != sysconfig.get_path("purelib")]
    told = {key: value for key, value in os.environ.items() if (key, value) != (SAFE_PATH, OURS)}
    return {**told, "PYTHONPATH": os.pathsep.join(paths)}


@contextmanager
def others_safe() -> Iterator[None]:
    """Meanwhile no Python that other packages start imports from the current folder either."""
    before = os.environ.setdefault(SAFE_PATH, OURS)
    try:
        yield
    finally:
        if before == OURS:
            os.environ.pop(SAFE_PATH, None)
